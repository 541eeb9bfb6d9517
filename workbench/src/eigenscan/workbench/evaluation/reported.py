"""For how long health reports what while a log is played."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from eigenscan.workbench.evaluation.figures import Figures
from eigenscan.workbench.evaluation.reference import NS

_NUMBER = re.compile(r"\d+(\.\d+)?")


@dataclass
class _Fault:
    """Its first words, for how long it was reported, and in how many runs."""

    words: str
    seconds: float = 0.0
    runs: int = 0


@dataclass
class Reported:
    """The faults of a run, or of several: words that differ in numbers alone are of one.

    Health is looked at once a second, as often as services publish it, and each look counts as a second.
    """

    _faults: dict[str, _Fault] = field(default_factory=dict)
    _looked: int | None = None

    def look(self, stamp: int, words: Callable[[], str]) -> None:
        """Counts what is reported at a scan's `stamp`, ns, unless it was looked at within a second."""
        # a clock may be set back
        if self._looked is None or abs(stamp - self._looked) >= NS:
            self._looked = stamp
            self.count(words())

    def count(self, words: str) -> None:
        """Counts what is reported now; empty: nothing."""
        if words:
            fault = self._of(words)
            fault.seconds += 1.0
            fault.runs = 1

    def add(self, other: Reported) -> None:
        """Adds what other runs had."""
        for each in other._faults.values():
            fault = self._of(each.words)
            fault.seconds += each.seconds
            fault.runs += each.runs

    def _of(self, words: str) -> _Fault:
        return self._faults.setdefault(_NUMBER.sub("", words), _Fault(words))

    def figures(self) -> Figures:
        """By its words how long each fault was reported, and in how many runs; the longest first."""
        longest = sorted(self._faults.values(), key=lambda fault: (-fault.seconds, fault.words))
        return {fault.words: {"seconds": fault.seconds, "runs": fault.runs} for fault in longest}
