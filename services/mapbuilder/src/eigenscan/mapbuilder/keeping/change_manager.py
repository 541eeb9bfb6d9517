"""The mapbuilder over a model folder: it publishes the folder's models and keeps the robots' evidence.

Only this part uses the disk; the evidence and its changes are computed without it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.model import ModelError
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.keeping.source import Source
from eigenscan.mapbuilder.keeping.store import Store
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.schemas.channels import DEFAULT_SITE, POSE, SCAN, Channel
from eigenscan.schemas.envelope import Condition, Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tick import TICK

if TYPE_CHECKING:
    from eigenscan.mapbuilder.keeping.change import Change
    from eigenscan.mapbuilder.keeping.change_detector import ChangeDetector

SAVE_EVERY = 200
"""Views between two saves of a running visit, which a killed process loses."""


class ChangeManager:
    """Publishes the models of a folder and keeps them true; in a read-only folder it only publishes.

    With a `source`, it first builds the folder from that map, if necessary. After an operator has selected
    another version, it only proposes.
    """

    outputs: tuple[Channel, ...] = MapbuilderCore.outputs

    def __init__(
        self,
        store: Store,
        settings: MapbuilderSettings,
        site: str = DEFAULT_SITE,
        source: Source | None = None,
    ) -> None:
        """`site`: the first chunk of its keys.

        Raises ModelError if the folder cannot be read and there is no source.
        """
        self._store, self._settings, self._site_name, self._source = store, settings, site, source
        self._core: MapbuilderCore | None = None
        if source is None:
            self._open()
        self._publish = settings.changes == "publish"
        self._keeps = settings.changes != "off" and store.is_writable
        own = MapbuilderCore.inputs
        self.inputs: tuple[Channel, ...] = (TICK, *own, SCAN, POSE) if self._keeps else (TICK, *own)
        self._counts: Counter[str] = Counter()
        self._proposed = self._accepted = ""
        self._saved = 0
        self._problem = self._unreadable = ""
        self._note = ""
        self._detector: ChangeDetector | None = None

    def start(self) -> Iterator[Envelope]:
        """Publishes the map and the models in use. Raises ModelError if they cannot be read or built."""
        core = self._core or self._make(self._source)
        yield from core.start()
        if self._keeps:
            self._detector = self._adopt(self._site)

    def handle(self, received: Envelope) -> Iterator[Envelope]:
        """Publishes models that have come into use; handles scans and poses as evidence."""
        if received.channel is TICK:
            yield from self._follow()
        elif received.channel in MapbuilderCore.inputs:
            if self._core is not None:
                yield from self._core.handle(received)
        elif self._detector is not None:
            self._receive(self._detector, received)

    def finish(self) -> tuple[Envelope, ...]:
        """Publishes nothing; writes the evidence to disk."""
        if self._detector is not None:
            self._save(self._detector)
        return ()

    def condition(self) -> Condition:
        """OK once all models are published, with the proposal; DEGRADED if the store cannot be used."""
        if self._core is None:
            return Condition(Health.STATUS_WAITING, "building models")
        own = self._core.condition()
        if own.status == Health.STATUS_WAITING:
            return own
        seen: Counter[str] = self._detector.counts if self._detector else Counter()
        reported = replace(own, counters={**(self._counts + seen + self._store.counts), **own.counters})
        problem = self._unreadable or self._problem or (self._detector.problem if self._detector else "")
        if problem:
            return replace(reported, status=Health.STATUS_DEGRADED, detail=problem)
        return replace(reported, detail=f"{reported.detail}; {self._note}") if self._note else reported

    def _open(self) -> MapbuilderCore:
        """Reads the models in use. Raises ModelError."""
        found = self._store.renewed()
        assert found is not None  # the first time it is new
        self._site, self._core = found, MapbuilderCore(self._settings, found, self._site_name, self._store)
        return self._core

    def _make(self, source: Source | None) -> MapbuilderCore:
        """Builds the folder from its map if necessary, or if it cannot be read."""
        assert source is not None  # without one it was opened at once
        if not source.is_due(self._store.folder):
            try:
                return self._open()
            except ModelError:  # damaged, or of another format than this release's
                self._counts["models_unreadable"] += 1
        source.build(self._store.folder)
        return self._open()

    def _follow(self) -> Iterator[Envelope]:
        """Publishes the store's models in use if they have changed."""
        try:
            site = self._store.renewed()
        except ModelError as error:
            self._counts["models_unreadable"] += 1
            self._unreadable = str(error)
            return
        if site is not None:
            self._unreadable = ""
            assert self._core is not None  # it has started
            yield from self._core.renew(site)
            if self._detector is not None:
                self._take_over(self._detector, site)

    def _take_over(self, detector: ChangeDetector, site: SiteModel) -> None:
        """Another version is in use."""
        if site.to_message().version != self._accepted:
            self._publish = False
        self._proposed = self._note = ""
        self._try(self._store.withdraw)
        if detector.fits(site.grid) and site.frame_id == self._site.frame_id:
            self._site = site
            detector.trust(site.grid)
        else:
            self._counts += detector.counts
            self._detector = self._adopt(site)

    def _receive(self, detector: ChangeDetector, received: Envelope) -> None:
        """Takes a scan or a pose; at the end of a visit a change may follow."""
        change = detector.receive(received)
        if change is not None:
            self._counts["visits"] += 1
            self._problem = ""
            self._try(lambda: self._decide(change))
        if change is not None or detector.counts["looks_counted"] - self._saved >= SAVE_EVERY:
            self._save(detector)

    def _save(self, detector: ChangeDetector) -> None:
        """Puts the evidence on disk."""
        self._saved = detector.counts["looks_counted"]
        self._try(lambda: self._store.save(detector.evidence, self._site.grid))

    def _adopt(self, site: SiteModel) -> ChangeDetector:
        from eigenscan.mapbuilder.keeping.change_detector import (
            ChangeDetector,  # half of the start time, needed only to keep a map
        )

        self._site, self._saved = site, 0
        evidence = self._store.load(site.grid, self._settings.visit * 60.0)
        return ChangeDetector(site.grid, evidence, self._settings.visits, site.frame_id)

    def _decide(self, change: Change) -> None:
        if not change:
            self._proposed = self._note = ""
            self._store.withdraw()
        elif change.grid.version != self._proposed:
            self._propose(change)
            if self._publish:
                self._store.accept()
                self._counts["changes_published"] += 1
            self._proposed = change.grid.version

    def _propose(self, change: Change) -> None:
        from eigenscan.mapbuilder.keeping.proposal import Proposal  # builds and draws: imported when needed

        proposal = Proposal.of(self._site, change, self._settings)
        self._store.propose(proposal.site, proposal.about, proposal.picture)
        self._counts["changes_proposed"] += 1
        version = proposal.site.to_message().version
        if self._publish:
            self._accepted = version
        else:
            accept = f"eigenscan models accept {self._store.folder}"
            self._note = f"{proposal.words}: proposed as {version[:12]}, {accept}"

    def _try(self, work: Callable[[], None]) -> None:
        """A full disk must not end the service: the evidence is still there at the end of the next visit."""
        try:
            work()
        except (ModelError, OSError) as error:
            self._problem = f"map is not kept: {error}"
            self._counts["keeping_failed"] += 1
