"""The service without its shell: says a site's map and models, and keeps them true."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.model import ModelError
from eigenscan.geometry.gridmap import GridMap, to_message
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.schemas.channels import DEFAULT_SITE, HEALTH, MAP, MODEL, MODEL_SET, POSE, SCAN, Channel
from eigenscan.schemas.envelope import Condition, Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import ModelSet

if TYPE_CHECKING:
    from eigenscan.mapbuilder.keeping.custodian import Custodian
    from eigenscan.mapbuilder.keeping.store import Store


class MapbuilderCore:
    """Builds the models of a map, or takes those that were built before, and says them once.

    All its channels are latched: whoever comes later gets them without asking twice. The set is said last,
    so that whoever has a set has heard of all its models. With a store it says the models that come into use
    there, and may hear scans and poses to keep them true. Health, its own too, is when it looks.
    """

    hears: tuple[Channel, ...] = ()
    says: tuple[Channel, ...] = (MAP, MODEL, MODEL_SET)

    def __init__(
        self,
        settings: MapbuilderSettings,
        source: GridMap | SiteModel,
        store: Store | None = None,
        site: str = DEFAULT_SITE,
    ) -> None:
        """`site` is the first chunk of the keys that it speaks on."""
        self._address = {"site": site}
        self._settings, self._source, self._store = settings, source, store
        self._site: SiteModel | None = None
        self._version = ""
        self._said: dict[str, str] = {}
        self._counts: Counter[str] = Counter()
        self._unreadable = ""
        self._custodian: Custodian | None = None
        self._keeps = store is not None and settings.changes != "off" and store.is_writable
        if store is not None:
            self.hears = (HEALTH, SCAN, POSE) if self._keeps else (HEALTH,)

    def start(self) -> Iterator[Envelope]:
        """The map at once, then the models. Raises ModelError where the map has no free position."""
        if isinstance(self._source, GridMap):
            yield self._map(self._source, self._settings.frame_id)
            from eigenscan.mapbuilder.site import build_site  # half of its start is for who builds only

            site = build_site(self._source, self._settings.plan)
        else:
            site = self._source
            yield self._map(site.grid, site.frame_id)
        yield from self._announce(site)
        if self._keeps and self._store is not None:
            from eigenscan.mapbuilder.keeping.custodian import Custodian

            self._custodian = Custodian(self._store, site, self._settings)

    def handle(self, heard: Envelope) -> Iterator[Envelope]:
        """Says what has come into use since; of a scan or a pose, what the robots' visits made of it."""
        if self._custodian is not None and heard.channel is not HEALTH:
            self._custodian.hear(heard)
        if self._store is not None and heard.channel is HEALTH:
            yield from self._follow(self._store)

    def finish(self) -> Iterable[Envelope]:
        """Nothing is held back; what was seen is put on disk."""
        if self._custodian is not None:
            self._custodian.save()
        return ()

    def condition(self) -> Condition:
        """OK once all models are said, and what is proposed; degraded where the store cannot be used."""
        if self._site is None:
            return Condition(Health.STATUS_WAITING, "building models")
        custodian = self._custodian
        counters = dict(self._counts) | (custodian.counters if custodian else {})
        counters |= {
            "regions": len(self._site.regions),
            "positions": sum(len(model.index) for model in self._site.regions),
        }
        problem = self._unreadable or (custodian.problem if custodian else "")
        if problem:
            return Condition(Health.STATUS_DEGRADED, problem, counters)
        detail = f"{counters['regions']} regions, version {self._version[:12]}"
        note = custodian.note if custodian else ""
        return Condition(Health.STATUS_OK, f"{detail}; {note}" if note else detail, counters)

    def _follow(self, store: Store) -> Iterator[Envelope]:
        """The models in use in the store, where they are others than those that were said."""
        try:
            site = store.renewed()
        except ModelError as error:
            self._counts["models_unreadable"] += 1
            self._unreadable = str(error)
            return
        if site is not None:
            self._unreadable = ""
            yield self._map(site.grid, site.frame_id)
            yield from self._announce(site)
            if self._custodian is not None:
                self._custodian.take_over(site)

    def _map(self, grid: GridMap, frame_id: str) -> Envelope:
        return Envelope(MAP, self._address, to_message(grid, frame_id))

    def _announce(self, site: SiteModel) -> Iterator[Envelope]:
        """The models that nobody has been told of, then the set."""
        *models, whole = announce_models(site, self._address["site"])
        for model, said in zip(site.regions, models, strict=True):
            if self._said.get(model.region) != model.version:
                self._said[model.region] = model.version
                yield said
        self._site, self._version = site, whole.open(ModelSet).version
        yield whole


def announce_models(site: SiteModel, site_name: str) -> Iterator[Envelope]:
    """The models of a site as they are said: each region's, then the set that they make."""
    for model in site.regions:
        yield Envelope(MODEL, {"site": site_name, "region": model.region}, model.to_message())
    yield Envelope(MODEL_SET, {"site": site_name}, site.to_message())
