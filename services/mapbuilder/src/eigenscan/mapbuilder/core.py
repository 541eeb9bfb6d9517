"""The service without its shell: says a site's map and models, and keeps them for late joiners."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from eigenscan.eigenspace.folder import SiteModel
from eigenscan.geometry.gridmap import GridMap, to_message
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.schemas.channels import MAP, MODEL, MODEL_SET, Channel
from eigenscan.schemas.envelope import Condition, Envelope
from eigenscan.schemas.health_pb2 import Health


class MapbuilderCore:
    """Builds the models of a map, or takes those that were built before, and says them once.

    All its channels are latched: whoever comes later gets them without asking twice. The set is said last,
    so that whoever has a set has heard of all its models.
    """

    hears: tuple[Channel, ...] = ()
    says: tuple[Channel, ...] = (MAP, MODEL, MODEL_SET)

    def __init__(self, settings: MapbuilderSettings, source: GridMap | SiteModel) -> None:
        self._settings, self._source = settings, source
        self._site: SiteModel | None = source if isinstance(source, SiteModel) else None
        self._said = False

    def start(self) -> Iterator[Envelope]:
        """The map at once, then the models. Raises ModelError where the map has no free position."""
        address = {"site": self._settings.site}
        if isinstance(self._source, GridMap):
            yield Envelope(MAP, address, to_message(self._source, self._settings.frame_id))
            from eigenscan.mapbuilder.site import build_site  # half of its start is for who builds only

            self._site = site = build_site(self._source, self._settings.plan)
        else:
            site = self._source
            yield Envelope(MAP, address, to_message(site.grid, site.frame_id))
        yield from announce_models(site, self._settings.site)
        self._said = True

    def handle(self, _heard: Envelope) -> Iterable[Envelope]:
        """Nothing is heard."""
        return ()

    def finish(self) -> Iterable[Envelope]:
        """Nothing is held back."""
        return ()

    def condition(self) -> Condition:
        """OK once all models are said."""
        if self._site is None or not self._said:
            return Condition(Health.STATUS_WAITING, "building models")
        counters = {
            "regions": len(self._site.regions),
            "positions": sum(len(model.index) for model in self._site.regions),
        }
        version = self._site.to_message().version[:12]
        return Condition(Health.STATUS_OK, f"{counters['regions']} regions, version {version}", counters)


def announce_models(site: SiteModel, site_name: str) -> Iterator[Envelope]:
    """The models of a site as they are said: each region's, then the set that they make."""
    for model in site.regions:
        yield Envelope(MODEL, {"site": site_name, "region": model.region}, model.to_message())
    yield Envelope(MODEL_SET, {"site": site_name}, site.to_message())
