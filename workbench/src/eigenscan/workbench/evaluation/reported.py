"""For how long health reports what while a log is played."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from eigenscan.workbench.evaluation.figures import Figures

EVERY_NS = 1_000_000_000
"""Of the log, between two looks: services publish their health as often."""
_NUMBER = re.compile(r"\d+(\.\d+)?")


@dataclass
class Reported:
    """Seconds of each fault, and the runs that had it: words that differ in numbers alone are of one."""

    seconds: dict[str, float] = field(default_factory=dict)
    runs: dict[str, int] = field(default_factory=dict)
    _words: dict[str, str] = field(default_factory=dict)
    _due: int | None = None

    def look(self, stamp: int, words: Callable[[], str]) -> None:
        """Counts what is reported at `stamp`, ns, once a second has passed since the last look."""
        if self._due is not None and stamp < self._due:
            return
        self._due = stamp + EVERY_NS
        if found := words():
            kind = self._kind(found)
            self.seconds[kind] = self.seconds.get(kind, 0.0) + EVERY_NS * 1e-9
            self.runs[kind] = 1

    def add(self, other: Reported) -> None:
        """Adds what another run had."""
        for words, seconds in other.seconds.items():
            kind = self._kind(words)
            self.seconds[kind] = self.seconds.get(kind, 0.0) + seconds
            self.runs[kind] = self.runs.get(kind, 0) + other.runs[words]

    def _kind(self, words: str) -> str:
        """The first words of this kind."""
        return self._words.setdefault(_NUMBER.sub("", words), words)

    def figures(self) -> Figures:
        """By its words how long each fault was reported, and in how many runs; the longest first."""
        longest = sorted(self.seconds, key=lambda words: (-self.seconds[words], words))
        return {words: {"seconds": self.seconds[words], "runs": self.runs[words]} for words in longest}
