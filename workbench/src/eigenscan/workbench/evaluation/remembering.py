"""A search of the whole map that is made once for each scan, because windows overlap.

What it finds follows from models and scan alone. The process time of the first search is charged again each
time, so the figures are those of the real work.
"""

from __future__ import annotations

import time
from collections import OrderedDict

from eigenscan.projector.candidates import Candidates
from eigenscan.projector.focus import Scope
from eigenscan.projector.observation import Observation
from eigenscan.projector.projection import Search, find_candidates
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import SensorView, Site

KEPT = 5000
"""Searches kept, some kB each: the scans of a few minutes."""


class Remembering:
    """Replaces a projector's search; `owed_ns`: the process time that it saved so far."""

    def __init__(self, search: Search = find_candidates) -> None:
        self._search = search
        self._known: OrderedDict[tuple[str, object, bytes], tuple[Candidates, int]] = OrderedDict()
        self.owed_ns = 0

    def forget(self) -> None:
        """Forgets all that was found."""
        self._known.clear()

    def __call__(
        self, site: Site, view: SensorView, seen: Observation, settings: ProjectorSettings, *, scope: Scope
    ) -> Candidates:
        """What the search finds in the whole map; a search of some regions alone is made each time."""
        key = site.version, seen.sensor, seen.coarse.tobytes()
        if key in self._known and scope.regions is None:
            self._known.move_to_end(key)
            found, took = self._known[key]
            self.owed_ns += took
            return found
        before = time.process_time_ns()
        found = self._search(site, view, seen, settings, scope=scope)
        took = time.process_time_ns() - before
        # with regions that wait for later scans the same scan may find more the next time
        if scope.regions is None and found.waiting is None:
            self._known[key] = found, took
            if len(self._known) > KEPT:
                self._known.popitem(last=False)
        return found
