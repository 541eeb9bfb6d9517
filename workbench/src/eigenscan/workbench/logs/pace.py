"""The stamps of a bag's topics beside the recorder's clock.

The two may run at different paces: a simulator at half speed, or a bag that was played faster and recorded
again. So a stray stamp is judged beside its topic's latest one, not by how far it is behind the recorder.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

STRAY_STAMP_NS = 10_000_000_000
"""A stamp this far off where its topic's latest one has it is not believed; nor a pace of a shorter time."""


@dataclass(frozen=True)
class Stamped:
    """A message's time of recording and its stamp, ns."""

    recorded: int
    stamp: int

    @property
    def offset(self) -> int:
        """How far the stamp is ahead of the recorder's clock, ns."""
        return self.stamp - self.recorded


class Pace:
    """Stamps of topics with one clock. `known`: of each a message whose stamp is believed."""

    def __init__(self, known: Mapping[str, Stamped]) -> None:
        self._latest = dict(known)
        self._begun: set[str] = set()
        self._ends: tuple[Stamped, Stamped] | None = None  # the first and the latest one that were believed

    def __contains__(self, topic: str) -> bool:
        return topic in self._latest

    def is_stray(self, topic: str, given: Stamped) -> bool:
        """Whether the topic's next stamp is far off; otherwise it is believed."""
        off = abs(given.stamp - self.due(topic, given.recorded))
        before = self._latest[topic].recorded - given.recorded
        if topic not in self._begun and before > 0:  # who knows at which pace it comes to the known one
            return off > STRAY_STAMP_NS + before
        if off > STRAY_STAMP_NS:
            return True
        self._latest[topic] = given
        self._begun.add(topic)
        self._ends = (self._ends[0] if self._ends else given, given)
        return False

    def due(self, topic: str, recorded: int) -> int:
        """Stamp, ns, that a message recorded then would have."""
        latest = self._latest[topic]
        return latest.stamp + round(self._rate() * (recorded - latest.recorded))

    def _rate(self) -> float:
        """Ns of stamps in a ns of the recorder's clock: one for all topics, so that they stay together."""
        if self._ends is None or self._ends[1].recorded - self._ends[0].recorded < STRAY_STAMP_NS:
            return 1.0
        first, latest = self._ends
        return max((latest.stamp - first.stamp) / (latest.recorded - first.recorded), 0.0)
