"""The motion between two stamps by odometry, and how far it can be trusted.

A stamp between two messages, or beyond the newest, is reached by the velocity of the two messages before it.
So where the robot was at a stamp follows from odometry up to this stamp alone: a pose need not wait for the
next message, and is the same once that has arrived. By how much the velocity leads astray, some millimetres,
the motion to the next stamp is shorter or longer.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Callable
from math import hypot
from typing import NamedTuple

from eigenscan.geometry.pose import FARTHEST_M
from eigenscan.tracker.planar import IDENTITY, Pose, between, compose, scaled
from eigenscan.tracker.velocity_gate import Reading, VelocityGate

KEPT_NS = 60_000_000_000
"""Odometry older than this is forgotten. A projector's first answer may come many seconds late."""
KEPT_AT_LEAST, KEPT_AT_MOST = 2, 20_000
"""Samples, whatever their age."""
ASKED_AT_MOST = 256
"""Poses that are looked up between two messages of odometry, and kept until the next one."""
LONGEST_NS = 100_000_000
"""Between odometry messages that give a velocity: at 2 m/s2 it leads 1 cm astray in as long again."""
RESTART_AFTER = 5
"""So many stamps from the past in a row mean that the clock was set back."""


class Sample(NamedTuple):
    """Odometry at a stamp (ns): sums since the start of a chain from which jumps are taken out."""

    stamp: int
    raw: Pose
    """Base in the odom frame, as odometry gave it."""
    chained: Pose
    """Base in a frame without jumps."""
    way: float = 0.0
    """m driven."""
    turn: float = 0.0
    """rad turned, either way."""
    slip: float = 0.0
    """m of way that odometry measured while its velocity was implausible."""
    unknown: float = 0.0
    """s without usable odometry."""
    breaks: float = 0.0
    """Jumps of the odom frame."""
    extrapolated: bool = False


class Motion(NamedTuple):
    """From one stamp to another: pose increment in the base frame and what its error grows with."""

    delta: Pose
    way: float
    turn: float
    slip: float
    unknown: float
    breaks: float
    seconds: float


def motion(start: Sample, end: Sample) -> Motion:
    """Motion between two samples of one trail."""
    return Motion(
        between(start.chained, end.chained),
        max(end.way - start.way, 0.0),  # a robot that stops was extrapolated too far
        max(end.turn - start.turn, 0.0),
        end.slip - start.slip,
        end.unknown - start.unknown,
        end.breaks - start.breaks,
        (end.stamp - start.stamp) * 1e-9,
    )


Steer = Callable[[int, int, Pose], Pose]
"""Function from two stamps, ns, and the wheels' step between them to the step that counts."""


class OdometryTrail:
    """The last seconds of one robot's odometry, interpolated to any stamp."""

    def __init__(self, gate: VelocityGate, steer: Steer | None = None, *, extrapolates: bool = True) -> None:
        self._gate, self._extrapolates = gate, extrapolates
        self._steer = steer or (lambda _start, _end, step: step)
        self._samples: list[Sample] = []
        self._stamps = array("q")
        """Of the samples: to search in these takes a tenth of the time."""
        self._asked: dict[int, Sample] = {}
        self._past_in_row = 0
        self._delay = 0
        self.behind = 0
        """How far the last message's stamp lay behind the newest, ns: a clock may have been set back."""

    @property
    def newest(self) -> Sample | None:
        """Last sample taken."""
        return self._samples[-1] if self._samples else None

    @property
    def oldest(self) -> Sample | None:
        """First sample that is kept."""
        return self._samples[0] if self._samples else None

    def take(self, stamp: int, pose: Pose) -> str:
        """Adds odometry at `stamp` ns; gives what became of it: taken, or the reason it was not.

        `taken_as_slip` and `taken_as_jump` are kept too: the first with doubt, the second as a new
        start of the odom frame, its increment unknown. `restarted`: the clock was set back.
        """
        if not all(abs(number) < FARTHEST_M for number in pose):  # also not a number
            return "odometry_not_finite"
        self._asked.clear()
        if not self._samples:
            self._keep(Sample(stamp, pose, pose))
            return "odometry_taken"
        last = self._samples[-1]
        if stamp <= last.stamp:
            return self._from_the_past(stamp, pose, last)
        self._past_in_row = self.behind = 0
        seconds = (stamp - last.stamp) * 1e-9
        step = between(last.raw, pose)
        reading = self._gate.judge(step, seconds)
        self._append(last, stamp, pose, self._steer(last.stamp, stamp, step), reading, seconds)
        return f"odometry_{reading.value}"

    def _from_the_past(self, stamp: int, pose: Pose, last: Sample) -> str:
        if stamp == last.stamp:
            return "odometry_duplicate"
        self._past_in_row += 1
        self.behind = last.stamp - stamp
        if self._past_in_row < RESTART_AFTER:
            return "odometry_from_past"
        self._past_in_row = self.behind = 0
        self._gate.forget()
        del self._samples[:], self._stamps[:]
        self._keep(Sample(stamp, pose, pose))
        return "odometry_restarted"

    def _append(
        self, last: Sample, stamp: int, pose: Pose, step: Pose, reading: Reading, seconds: float
    ) -> None:
        way, turn = hypot(step[0], step[1]), abs(step[2])
        jump = reading is Reading.JUMP
        slip = reading is Reading.SLIP
        self._keep(
            Sample(
                stamp,
                pose,
                last.chained if jump else compose(last.chained, step),
                last.way + (0.0 if jump else way),
                last.turn + (0.0 if jump else turn),
                last.slip + (way + turn if slip else 0.0),
                last.unknown + (seconds if jump else 0.0),
                last.breaks + (1.0 if jump else 0.0),
            )
        )
        # in batches: taking from the front of a list moves all of it
        half = len(self._samples) // 2
        if self._samples[half].stamp < stamp - KEPT_NS or len(self._samples) > KEPT_AT_MOST:
            old = max(half - KEPT_AT_LEAST, 0)
            del self._samples[:old], self._stamps[:old]

    def _keep(self, sample: Sample) -> None:
        self._samples.append(sample)
        self._stamps.append(sample.stamp)

    def reaches(self, stamp: int) -> bool:
        """Whether the pose at `stamp`, ns, is known, whatever odometry is still to come."""
        sample = self.at(stamp)
        return sample is not None and (sample.extrapolated or stamp - self._delay <= self._samples[-1].stamp)

    def delay(self, by: int) -> None:
        """Scans are stamped late, `by` ns: the robot was then where odometry stated as long before."""
        self._delay = by

    def at(self, stamp: int) -> Sample | None:
        """Odometry when a scan of `stamp` ns was taken; see `as_stamped`."""
        return self.as_stamped(stamp - self._delay)

    def as_stamped(self, stamp: int) -> Sample | None:
        """Odometry at `stamp` ns; beyond what is known the last pose, its age counted as unknown time.

        None where there was no odometry yet.
        """
        if not self._samples:
            return None
        known = self._asked.get(stamp)
        if known is None:
            if len(self._asked) == ASKED_AT_MOST:  # scans come, odometry has ended
                self._asked.clear()
            known = self._asked[stamp] = self._found(stamp)
        return known

    def between(self, start: int, end: int) -> Motion:
        """Motion between two stamps, ns; all of it unknown where there was no odometry yet."""
        a, b = self.at(start), self.at(end)
        if a is None or b is None:
            seconds = (end - start) * 1e-9
            return Motion(IDENTITY, 0.0, 0.0, 0.0, abs(seconds), 0.0, seconds)
        return motion(a, b)

    def spacing(self, stamp: int) -> int:
        """Time, ns, between the two messages that the pose at `stamp`, ns, is found by.

        0 without two, and at a message itself.
        """
        if len(self._samples) < 2:
            return 0
        after = bisect_left(self._stamps, stamp - self._delay)
        if after < len(self._stamps) and self._stamps[after] == stamp - self._delay:
            return 0
        after = min(max(after, 1), len(self._samples) - 1)
        return self._samples[after].stamp - self._samples[after - 1].stamp

    def leeway(self, stamp: int) -> tuple[float, float]:
        """How far off the pose at `stamp`, ns, is at most, m and rad, if the robot stopped between messages.

        0 where messages come often enough to give a velocity, and at a message itself. Of a robot that drove
        on as before for a share of the period and then stood, the pose between is off by no more than it
        drove less, nor than s (1 - s) of what it drove before.
        """
        after = bisect_left(self._stamps, stamp - self._delay)
        if not 0 < after < len(self._samples):
            return 0.0, 0.0
        before, a, b = (self._samples[max(index, 0)] for index in (after - 2, after - 1, after))
        period = b.stamp - a.stamp
        if period <= LONGEST_NS:
            return 0.0, 0.0
        share = (stamp - self._delay - a.stamp) / period
        steady = scaled(between(before.chained, a.chained), period / max(a.stamp - before.stamp, 1))
        driven = between(a.chained, b.chained)
        less = between(steady, driven)
        most = share * (1.0 - share)
        return (
            min(hypot(less[0], less[1]), most * hypot(steady[0], steady[1])),
            min(abs(less[2]), most * abs(steady[2])),
        )

    def _found(self, stamp: int) -> Sample:
        index = bisect_left(self._stamps, stamp)
        if index < len(self._samples) and self._samples[index].stamp == stamp:
            return self._samples[index]
        if self._extrapolates and index >= 2:
            sample = _extrapolated(self._samples[index - 2], self._samples[index - 1], stamp)
            if sample is not None:
                return sample
        if index == len(self._samples):
            last = self._samples[-1]
            return last._replace(stamp=stamp, unknown=last.unknown + (stamp - last.stamp) * 1e-9)
        if index == 0:
            first = self._samples[0]
            return first._replace(stamp=stamp, unknown=first.unknown - (first.stamp - stamp) * 1e-9)
        return _interpolate(self._samples[index - 1], self._samples[index], stamp)


def _extrapolated(before: Sample, last: Sample, stamp: int) -> Sample | None:
    """The pose at `stamp`, ns, by the velocity from `before` to `last`.

    None where the next message is due by then; or where a jump or slip, or too long an interval, shows no
    velocity.
    """
    period, ahead = last.stamp - before.stamp, stamp - last.stamp
    if ahead >= period or period > LONGEST_NS or last.breaks > before.breaks or last.slip > before.slip:
        return None
    share = ahead / period
    step = scaled(between(before.chained, last.chained), share)
    return Sample(
        stamp,
        compose(last.raw, step),
        compose(last.chained, step),
        last.way + share * (last.way - before.way),
        last.turn + share * (last.turn - before.turn),
        last.slip,
        last.unknown + share * (last.unknown - before.unknown),
        last.breaks,
        extrapolated=True,
    )


def _interpolate(a: Sample, b: Sample, stamp: int) -> Sample:
    share = (stamp - a.stamp) / (b.stamp - a.stamp)

    def mix(start: float, end: float) -> float:
        return start + share * (end - start)

    jumped = b.breaks > a.breaks
    near = b if share >= 0.5 else a
    return Sample(
        stamp,
        # between the two sides of a jump there is nothing to interpolate
        near.raw if jumped else compose(a.raw, scaled(between(a.raw, b.raw), share)),
        compose(a.chained, scaled(between(a.chained, b.chained), share)),
        mix(a.way, b.way),
        mix(a.turn, b.turn),
        mix(a.slip, b.slip),
        mix(a.unknown, b.unknown),
        mix(a.breaks, b.breaks),
    )
