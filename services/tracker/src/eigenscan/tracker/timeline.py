"""Puts observations in the order of their stamps, by stamps alone and never by a clock."""

from __future__ import annotations

import heapq
from collections import Counter, deque
from collections.abc import Callable
from enum import Enum

from eigenscan.tracker.observation import Observation
from eigenscan.tracker.odometry import RESTART_AFTER

FUTURE_NS = 1_000_000_000
"""A stamp this far ahead of everything received is not believed until another one confirms it."""
CONFIRMED_NS = 60_000_000_000
"""Another stamp of the same source confirms it within this: scans may be sparse, a minute apart."""
CAUGHT_UP_AFTER = 2
"""The same, where the next one is newer than all of its source: one alone may have been overtaken."""
RECENT = 64
"""Stamps kept of each source, to know a repetition."""


class Outcome(Enum):
    """What becomes of an observation."""

    TAKEN = "taken"
    RESTARTED = "taken, and the clock was set back"
    DUPLICATE = "its stamp is not new"
    TOO_LATE = "its stamp is older than what is still waited for"
    FUTURE = "its stamp is not believed yet"


class Timeline:
    """Observations of one robot that wait for odometry of their time, or for their patience to end."""

    def __init__(
        self, patience: float, late: float, counts: Counter[str], *, believes_stamps: bool = False
    ) -> None:
        self._believes_stamps = believes_stamps
        self._patience, self._late = int(patience * 1e9), int(late * 1e9)
        self._counts = counts
        self._order = 0
        self._forget()

    def _forget(self) -> None:
        self._waiting: list[tuple[int, str, int, Observation]] = []
        self._recent: dict[str, deque[int]] = {}
        self._projectors: set[str] = set()
        self._doubted: dict[str, int] = {}
        self._past_in_row: Counter[str] = Counter()
        """Of each source: lists from the past since one of any source was in time."""
        self._back: dict[str, list[int]] = {}
        """The same: stamps of those that are older than another of their own source."""
        self._received: int | None = None
        self._odometry: int | None = None
        self._alone = False

    def receive_odometry(self, stamp: int, restarted: bool = False) -> None:
        """Notes how far odometry has come; `restarted`: its clock was set back, so what waits never fits."""
        if restarted:
            self._waiting.clear()
        if restarted or self._odometry is None:
            self._odometry = stamp
        self._odometry = max(self._odometry, stamp)

    def receive(self, seen: Observation) -> Outcome:
        """Takes an observation, or counts why not."""
        recent = self._recent.setdefault(seen.source, deque(maxlen=RECENT))
        if seen.stamp in recent:
            self._counts["hypotheses_duplicate"] += 1
            return Outcome.DUPLICATE
        if recent and seen.stamp < max(recent):  # a projector answers scans in their order
            self._back.setdefault(seen.source, []).append(seen.stamp)
            return self._receive_past(seen)
        if self._received is not None and seen.stamp < self._received - self._late:
            return self._receive_past(seen)
        back = self._back.pop(seen.source, [])
        self._past_in_row.clear()  # a source that is slow is no clock that was set back
        # lists that one overtook fall between it and the one before; a clock that was set back passes others
        places = {sum(stamp < late for stamp in recent) for late in back}
        overtaken = len(places) == 1 and 0 not in places
        if len(back) >= CAUGHT_UP_AFTER and not overtaken:  # how much time has passed meanwhile is not known
            return self._restart(seen)
        if self._is_doubtful(seen):
            self._counts["hypotheses_from_future"] += 1
            return Outcome.FUTURE
        self._push(seen)
        return Outcome.TAKEN

    @property
    def waits(self) -> bool:
        """Whether an observation waits."""
        return bool(self._waiting)

    @property
    def newest(self) -> int | None:
        """Newest stamp, ns, that is believed."""
        return self._received

    @property
    def longest_waiting(self) -> tuple[str, int] | None:
        """Source and stamp, ns, of the oldest observation that waits."""
        return (self._waiting[0][1], self._waiting[0][0]) if self._waiting else None

    def _is_doubtful(self, seen: Observation) -> bool:
        if self._received is None or self._believes_stamps:
            return False
        if seen.stamp <= max(self._received, self._odometry or 0) + FUTURE_NS:
            self._doubted.pop(seen.source, None)
            return False
        before = self._doubted.get(seen.source)
        self._doubted[seen.source] = seen.stamp
        return before is None or not 0 < seen.stamp - before <= CONFIRMED_NS

    def _receive_past(self, seen: Observation) -> Outcome:
        self._counts["hypotheses_too_late"] += 1
        self._past_in_row[seen.source] += 1
        if self._past_in_row[seen.source] < RESTART_AFTER:
            return Outcome.TOO_LATE
        return self._restart(seen)

    def _restart(self, seen: Observation) -> Outcome:
        self._counts["clock_set_back"] += 1
        odometry = self._odometry
        self._forget()
        # odometry that has already gone back with the clock still counts
        self._odometry = odometry if odometry is not None and odometry <= seen.stamp + FUTURE_NS else None
        self._push(seen)
        return Outcome.RESTARTED

    def _push(self, seen: Observation) -> None:
        self._recent.setdefault(seen.source, deque(maxlen=RECENT)).append(seen.stamp)
        self._projectors.add(seen.source.rpartition("/")[2])
        self._received = max(self._received or seen.stamp, seen.stamp)
        heapq.heappush(self._waiting, (seen.stamp, seen.source, self._order, seen))
        self._order += 1

    def ready(self, is_known: Callable[[int], bool]) -> list[Observation]:
        """Observations whose odometry is known or whose patience has ended, oldest first.

        `is_known`: whether odometry reaches a stamp, ns. Where several projectors answer it must have come as
        far: their lists of one scan arrive in any order, and are taken in that of their names.
        """
        if not self._waiting or self._received is None:
            return []
        if self._odometry is None and not self._alone:
            # odometry that is missing for as long as patience lasts is not waited for any more
            self._alone = self._waiting[0][0] <= self._received - self._patience
        waited = self._received - (0 if self._odometry is None and self._alone else self._patience)
        known = max(self._odometry or waited, waited)
        result = []
        alone = len(self._projectors) < 2
        while self._waiting:
            stamp = self._waiting[0][0]
            reached = alone and is_known(stamp)
            if not reached and stamp > known:
                break
            if not reached and self._odometry is not None and stamp > self._odometry:
                self._counts["odometry_came_late"] += 1
            result.append(heapq.heappop(self._waiting)[3])
        return result

    def rest(self) -> list[Observation]:
        """All that still waits, oldest first."""
        return [heapq.heappop(self._waiting)[3] for _ in range(len(self._waiting))]
