"""What becomes of a change: proposed to the operator, or put in use; and the evidence, safe on disk."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.model import ModelError
from eigenscan.mapbuilder.keeping.change import Change
from eigenscan.mapbuilder.keeping.keeper import Keeper
from eigenscan.mapbuilder.keeping.store import Store
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.schemas.envelope import Envelope

SAVE_EVERY = 200
"""Looks between two savings of a running visit: what a killed process loses."""


class Custodian:
    """Keeps the models of a folder true. Once another version is put in use by hand, it only proposes."""

    def __init__(self, store: Store, site: SiteModel, settings: MapbuilderSettings) -> None:
        self._store, self._settings = store, settings
        self._publish = settings.changes == "publish"
        self._counts: Counter[str] = Counter()
        self._proposed = self._accepted = ""
        self._saved = 0
        self._problem = ""
        self._note = ""
        self._site = site
        self._keeper = self._adopt(site)

    @property
    def counters(self) -> dict[str, int]:
        """Looks by what became of them, visits, changes."""
        return dict(self._counts + self._keeper.counts)

    @property
    def problem(self) -> str:
        """Why the evidence or a proposal could not be written."""
        return self._problem

    @property
    def note(self) -> str:
        """What is proposed, and by which command it comes into use; empty where nothing is."""
        return self._note

    def take_over(self, site: SiteModel) -> None:
        """Another version is in use."""
        if site.to_message().version != self._accepted:
            self._publish = False
        self._proposed = self._note = ""
        self._try(self._store.withdraw)
        if self._keeper.fits(site.grid) and site.frame_id == self._site.frame_id:
            self._site = site
            self._keeper.trust(site.grid)
        else:
            self._counts += self._keeper.counts
            self._keeper = self._adopt(site)

    def hear(self, heard: Envelope) -> None:
        """Takes a scan or a pose; at the end of a visit a change may follow."""
        change = self._keeper.hear(heard)
        if change is not None:
            self._counts["visits"] += 1
            self._problem = ""
            self._try(lambda: self._decide(change))
        if change is not None or self._keeper.counts["looks_counted"] - self._saved >= SAVE_EVERY:
            self.save()

    def save(self) -> None:
        """Puts the evidence on disk."""
        self._saved = self._keeper.counts["looks_counted"]
        self._try(lambda: self._store.save(self._keeper.evidence, self._site.grid))

    def _adopt(self, site: SiteModel) -> Keeper:
        self._site, self._saved = site, 0
        evidence = self._store.load(site.grid, self._settings.visit * 60.0)
        return Keeper(site.grid, evidence, self._settings.visits, site.frame_id)

    def _decide(self, change: Change) -> None:
        if not change:
            self._proposed = self._note = ""
            self._store.withdraw()
        elif change.grid.version != self._proposed:
            self._propose(change)
            if self._publish:
                self._store.accept()
                self._counts["changes_published"] += 1

    def _propose(self, change: Change) -> None:
        # what builds and draws is loaded when it is needed
        from eigenscan.mapbuilder.keeping.picture import draw_change
        from eigenscan.mapbuilder.keeping.rebuild import rebuild

        fresh = rebuild(self._site, change.grid, self._settings.plan)
        version, words = fresh.to_message().version, self._words(change)
        picture = draw_change(self._site.grid, change, f"red is new, blue is gone: {words}")
        self._store.propose(fresh, self._about(change, fresh), picture)
        self._proposed = change.grid.version
        self._counts["changes_proposed"] += 1
        if self._publish:
            self._accepted = version
        else:
            self._note = f"{words}: proposed as {version[:12]}, eigenscan models accept {self._store.folder}"

    def _words(self, change: Change) -> str:
        places = change.places()
        new = sum(place.is_new for place in places)
        return f"{new} new, {len(places) - new} gone on {self._settings.visits} visits in a row"

    def _about(self, change: Change, fresh: SiteModel) -> dict[str, Any]:
        before = {model.region: model.version for model in self._site.regions}
        return {
            "since": self._site.to_message().version,
            "visits": self._settings.visits,
            "regions": [m.region for m in fresh.regions if before[m.region] != m.version],
            "places": [
                {
                    "what": "new" if place.is_new else "gone",
                    "x": round(place.centre[0], 2),
                    "y": round(place.centre[1], 2),
                    "sides_m": [round(side, 2) for side in place.sides],
                }
                for place in change.places()
            ],
        }

    def _try(self, work: Callable[[], None]) -> None:
        """A full disk must not end the service: the evidence is still there at the end of the next visit."""
        try:
            work()
        except (ModelError, OSError) as error:
            self._problem = f"map is not kept: {error}"
            self._counts["keeping_failed"] += 1
