"""A clock that was set back while a log was written: time goes on from there, at the usual pace.

It is known by the messages of one key, in the order of the log: LATE_IN_A_ROW of them lie before earlier
ones. The other keys of that clock follow at once, by the same shift: scans and odometry stay together.
"""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.workbench.logs.stamps import LONE_STEP_NS

LATE_IN_A_ROW = 10
"""Messages, as scan-ingest's clock_step_scans: fewer have stray stamps, and are left out."""


@dataclass
class _Course:
    """How the stamps of one key go on, ns."""

    # two, so that a lone one ahead makes no other late
    latest: deque[int] = field(default_factory=lambda: deque(maxlen=2))
    step: int = LONE_STEP_NS
    shift: int = 0  # of the stamps as logged
    late: list[Envelope] = field(default_factory=list)

    def is_late(self, envelope: Envelope, horizon: int) -> bool:
        """Whether a message lies before earlier ones by more than `horizon`."""
        return len(self.latest) == 2 and envelope.stamp + self.shift < min(self.latest) - horizon

    def needed(self) -> int:
        """Shift by which the late ones follow the others."""
        return self.latest[-1] + self.step - self.late[0].stamp


class SetBack:
    """Moves on what follows after a clock was set back by more than `horizon`, ns.

    `logged` gets the stamp as logged of each scan that is moved, by the new one.
    """

    def __init__(self, horizon: int, counters: Counter[str], logged: dict[int, int]) -> None:
        self._horizon, self._counters, self._logged = horizon, counters, logged
        self._courses: defaultdict[str, _Course] = defaultdict(_Course)
        self._shift = 0  # ns, the latest

    def going_on(self, envelopes: Iterable[Envelope]) -> Iterator[Envelope]:
        """The envelopes, in the same order but for late ones, which wait until they show what they are."""
        for envelope in envelopes:
            course = self._courses[envelope.key]
            if not course.is_late(envelope, self._horizon):
                self._leave_out(course)
                yield self._moved(course, envelope)
                continue
            course.late.append(envelope)
            if not self._is_known(course):
                if len(course.late) < LATE_IN_A_ROW:
                    continue
                self._shift = course.needed()
                self._counters["clock_set_back"] += 1
            for each in self._courses.values():
                if each.late and self._is_known(each):
                    yield from self._follow(each)
        for course in self._courses.values():
            self._leave_out(course)

    def _is_known(self, course: _Course) -> bool:
        """Whether the shift of another key brings the late ones to where this one was."""
        return abs(course.needed() - self._shift) <= self._horizon

    def _follow(self, course: _Course) -> Iterator[Envelope]:
        late, course.late, course.shift = course.late, [], self._shift
        for envelope in late:
            yield self._moved(course, envelope)

    def _moved(self, course: _Course, envelope: Envelope) -> Envelope:
        before, time = envelope.stamp, envelope.stamp + course.shift
        if course.shift:
            envelope.message.timestamp.CopyFrom(stamp(time))  # type: ignore[attr-defined]
            if envelope.channel is SCAN_RAW:
                self._logged[time] = self._logged.get(before, before)
        if course.latest and time > course.latest[-1]:
            course.step = time - course.latest[-1]
        course.latest.append(time)
        return envelope

    def _leave_out(self, course: _Course) -> None:
        for envelope in course.late:
            self._counters[f"{envelope.channel.name}_out_of_order"] += 1
        course.late.clear()
