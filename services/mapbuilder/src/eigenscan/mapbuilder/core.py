"""The core: publishes a site's map and models."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from eigenscan.eigenspace.folder import SiteModel
from eigenscan.geometry.gridmap import GridMap, to_message
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.spaces import KINDS, OF_ONE_ROBOT, Spaces, SpaceStore
from eigenscan.schemas.channels import DEFAULT_SITE, LIDAR_KIND, MAP, MODEL, MODEL_SET, SPACE, Channel
from eigenscan.schemas.envelope import Condition, Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import LidarKind, ModelSet


class MapbuilderCore:
    """Builds the models of a map, or takes finished ones, and publishes them once.

    All its channels are latched, so late subscribers get them with one query. The set comes last, so a
    subscriber that has it has received all its models.
    """

    inputs: tuple[Channel, ...] = (LIDAR_KIND,)
    outputs: tuple[Channel, ...] = (MAP, MODEL, MODEL_SET, SPACE)

    def __init__(
        self,
        settings: MapbuilderSettings,
        source: GridMap | SiteModel,
        site: str = DEFAULT_SITE,
        store: SpaceStore | None = None,
    ) -> None:
        """`site` is the first chunk of the keys that it speaks on; `store` keeps spaces for other lidars."""
        self._spaces = Spaces(site, settings, store)
        self._settings, self._source, self._address = settings, source, {"site": site}
        self._site: SiteModel | None = None
        self._version = ""
        self._published: dict[str, str] = {}

    def start(self) -> Iterator[Envelope]:
        """Publishes the map at once, then the models. Raises ModelError if the map has no free position."""
        if isinstance(self._source, GridMap):
            yield self._map(self._source, self._settings.frame_id)
            from eigenscan.mapbuilder.site import build_site  # half of the start time, needed only to build

            yield from self._announce(build_site(self._source, self._settings.plan))
        else:
            yield from self.renew(self._source)

    def renew(self, site: SiteModel) -> Iterator[Envelope]:
        """Publishes models that came into use: the map, and of the models those that it has not published."""
        yield self._map(site.grid, site.frame_id)
        yield from self._announce(site)

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        """The eigenspaces for a kind of lidar that a projector lacks."""
        if received.channel == LIDAR_KIND and self._site is not None:
            return self._spaces.receive(self._site, received.open(LidarKind), received.address["robot"])
        return ()

    def finish(self) -> Iterable[Envelope]:
        """Nothing is held back."""
        return ()

    def condition(self) -> Condition:
        """OK once all models are published."""
        if self._site is None:
            return Condition(Health.STATUS_WAITING, "building models")
        counters = {
            "regions": len(self._site.regions),
            "positions": sum(len(model.index) for model in self._site.regions),
        }
        counters |= self._spaces.counts
        detail = f"{counters['regions']} regions, version {self._version[:12]}"
        if refused := counters.get("lidar_kind_beyond_limit", 0):
            most = f"{KINDS}, or {OF_ONE_ROBOT} of a robot"
            detail += f"; {refused} requests for more kinds of lidars than {most}"
        return Condition(Health.STATUS_OK, detail, counters)

    def _map(self, grid: GridMap, frame_id: str) -> Envelope:
        return Envelope(MAP, self._address, to_message(grid, frame_id))

    def _announce(self, site: SiteModel) -> Iterator[Envelope]:
        """The models that are not published yet, then the set."""
        *models, whole = announce_models(site, self._address["site"])
        for model, published in zip(site.regions, models, strict=True):
            if self._published.get(model.region) != model.version:
                self._published[model.region] = model.version
                yield published
        self._site, self._version = site, whole.open(ModelSet).version
        yield whole
        yield from self._spaces.renew(site)


def announce_models(site: SiteModel, site_name: str) -> Iterator[Envelope]:
    """The models of a site as they are published: each region's, then the set that they make."""
    for model in site.regions:
        yield Envelope(MODEL, {"site": site_name, "region": model.region}, model.to_message())
    yield Envelope(MODEL_SET, {"site": site_name}, site.to_message())
