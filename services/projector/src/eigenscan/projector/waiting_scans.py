"""Scans that wait for the tracker's request.

Whether a scan is fitted locally must follow from messages, not from how fast processes are. So a scan waits
for the request that follows from the scan before it, as long as the tracker's requests come in time.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from math import isinf

from eigenscan.projector.local import KEPT, LONGEST_NS
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.recently_used import RecentlyUsed

MOST_WAITING = 256
"""Scans of a lidar: a tracker that hangs must not fill the memory. 25 s of a lidar of 10 Hz."""


@dataclass
class _Lidar:
    """Stamp of the last scan that was passed on, and of the last request; whether requests come in time."""

    in_time: bool
    passed: int | None = None
    requested: int | None = None
    waiting: deque[Envelope] = field(default_factory=deque)


class WaitingScans:
    """Passes the scans of each lidar on in their order."""

    def __init__(self, counts: Counter[str], within: float) -> None:
        """`counts`: where a request that was waited for and did not come is counted.

        `within`: how long a scan waits, s, by the stamps of its lidar, while fewer than KEPT wait. Infinite:
        from the first scan on, before any request has come in time, while fewer than MOST_WAITING wait.
        """
        self._lidars: RecentlyUsed[tuple[str, str], _Lidar] = RecentlyUsed()
        self._counts, self._within_ns = counts, within * 1e9
        self._always = isinf(within)
        self._most = MOST_WAITING if self._always else KEPT

    def _begin(self) -> _Lidar:
        return _Lidar(in_time=self._always)

    def receive(self, lidar: tuple[str, str], scan: Envelope) -> list[Envelope]:
        """Takes a scan of a lidar, by its robot's and its own name; gives the scans to answer now."""
        known = self._lidars.use(lidar, self._begin)
        known.waiting.append(scan)
        return self._due(known)

    def requested(self, lidar: tuple[str, str], stamp: int) -> list[Envelope]:
        """Takes the stamp, ns, of a request; gives the scans to answer now."""
        known = self._lidars.use(lidar, self._begin)
        known.requested = stamp
        known.in_time = known.in_time or stamp == known.passed
        return self._due(known)

    def has_no_list(self, lidar: tuple[str, str]) -> None:
        """Says that no list is published of the last scan that was passed on: no request follows."""
        known = self._lidars.use(lidar, self._begin)
        known.requested = known.passed

    def rest(self) -> list[Envelope]:
        """All that still waits."""
        waiting = [known.waiting for _, known in self._lidars.items()]
        rest = [scan for scans in waiting for scan in scans]
        for scans in waiting:
            scans.clear()
        return rest

    def _due(self, known: _Lidar) -> list[Envelope]:
        due = list[Envelope]()
        while known.waiting:
            stamp = known.waiting[0].stamp
            waits = (
                known.in_time
                and known.passed is not None
                and known.passed != known.requested
                and 0 < stamp - known.passed <= LONGEST_NS
            )
            # also where the clock was set back, or stands
            is_patient = 0 <= known.waiting[-1].stamp - stamp < self._within_ns
            if waits and is_patient and len(known.waiting) < self._most:
                break
            if waits:
                known.in_time = False
                self._counts["request_missing"] += 1
            due.append(known.waiting.popleft())
            known.passed = stamp
        return due
