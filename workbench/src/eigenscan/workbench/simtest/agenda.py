"""Simulated time: what happens when, and the clocks of machines."""

from __future__ import annotations

import heapq
from collections.abc import Callable

EPOCH_NS = 1_700_000_000_000_000_000
"""When every simulation begins, ns since 1970."""

Action = Callable[[], None]


class Agenda:
    """Events in the order of their times; those of one time in the order in which they were added."""

    def __init__(self) -> None:
        self.now_ns = 0
        self._waiting: list[tuple[int, int, Action]] = []
        self._added = 0

    @property
    def now(self) -> float:
        """Seconds since the beginning."""
        return self.now_ns * 1e-9

    def after(self, seconds: float, action: Action) -> None:
        """Does something so much later."""
        self.at(self.now_ns + round(seconds * 1e9), action)

    def at(self, due_ns: int, action: Action) -> None:
        """Does something then, ns since the beginning; at once where that is over."""
        self._added += 1
        heapq.heappush(self._waiting, (max(self.now_ns, due_ns), self._added, action))

    def run(self, until: float) -> None:
        """Does what is due up to that second."""
        end, waiting = round(until * 1e9), self._waiting
        while waiting and waiting[0][0] <= end:
            self.now_ns, _, action = heapq.heappop(waiting)
            action()
        self.now_ns = end


class MachineClock:
    """A machine's clock: somebody may set it, but only the time of day."""

    def __init__(self, agenda: Agenda) -> None:
        self._agenda = agenda
        self.offset_ns = 0

    def monotonic(self) -> float:
        """Seconds since the beginning."""
        return self._agenda.now_ns * 1e-9

    def perf_counter(self) -> float:
        """The same: a computation takes no time by itself."""
        return self._agenda.now_ns * 1e-9

    def time_ns(self) -> int:
        """Time of day, ns since 1970."""
        return EPOCH_NS + self._agenda.now_ns + self.offset_ns
