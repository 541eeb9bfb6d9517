"""What odometry says of the motion between two stamps, and how far it may be believed."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, isfinite

from eigenscan.tracker.planar import IDENTITY, Pose, between, compose, scaled
from eigenscan.tracker.velocity_gate import Reading, VelocityGate

KEPT_NS = 60_000_000_000
"""Odometry older than this is forgotten. A projector's first answer may come many seconds late."""
KEPT_AT_LEAST, KEPT_AT_MOST = 2, 20_000
"""Samples, whatever their age."""
FARTHEST = 1e7
"""m from the odom frame's origin: beyond it a number is an overflow, not a place."""
LONGEST_NS = 100_000_000
"""Between odometry messages that tell a velocity: at 2 m/s2 it leads 1 cm astray in as long again."""
RESTART_AFTER = 5
"""So many stamps from the past in a row mean that the clock was set back."""


@dataclass(frozen=True)
class Sample:
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


@dataclass(frozen=True)
class Motion:
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
        end.way - start.way,
        end.turn - start.turn,
        end.slip - start.slip,
        end.unknown - start.unknown,
        end.breaks - start.breaks,
        (end.stamp - start.stamp) * 1e-9,
    )


class OdometryTrail:
    """The last seconds of one robot's odometry, interpolated to any stamp."""

    def __init__(self, gate: VelocityGate) -> None:
        self._gate = gate
        self._samples: list[Sample] = []
        self._asked: dict[int, Sample] = {}
        self._past_in_row = 0

    @property
    def newest(self) -> Sample | None:
        """Last sample taken."""
        return self._samples[-1] if self._samples else None

    def take(self, stamp: int, pose: Pose) -> str:
        """Adds odometry at `stamp` ns; gives what became of it: taken, or the reason it was not.

        `taken_as_slip` and `taken_as_jump` are kept too: the first with doubt, the second as a new
        start of the odom frame, its increment unknown. `restarted`: the clock was set back.
        """
        if not all(isfinite(value) and abs(value) < FARTHEST for value in pose):
            return "odometry_not_finite"
        self._asked.clear()
        last = self.newest
        if last is None:
            self._samples.append(Sample(stamp, pose, pose))
            return "odometry_taken"
        if stamp <= last.stamp:
            return self._from_the_past(stamp, pose, last)
        self._past_in_row = 0
        seconds = (stamp - last.stamp) * 1e-9
        step = between(last.raw, pose)
        reading = self._gate.judge(step, seconds)
        self._append(last, stamp, pose, step, reading, seconds)
        return f"odometry_{reading.value}"

    def _from_the_past(self, stamp: int, pose: Pose, last: Sample) -> str:
        if stamp == last.stamp:
            return "odometry_duplicate"
        self._past_in_row += 1
        if self._past_in_row < RESTART_AFTER:
            return "odometry_from_past"
        self._past_in_row = 0
        self._gate.forget()
        self._samples.clear()
        self._samples.append(Sample(stamp, pose, pose))
        return "odometry_restarted"

    def _append(
        self, last: Sample, stamp: int, pose: Pose, step: Pose, reading: Reading, seconds: float
    ) -> None:
        way, turn = hypot(step[0], step[1]), abs(step[2])
        jump = reading is Reading.JUMP
        slip = reading is Reading.SLIP
        self._samples.append(
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
        self._forget_before(stamp - KEPT_NS)

    def _forget_before(self, stamp: int) -> None:
        # in batches: taking from the front of a list moves all of it
        if self._samples[len(self._samples) // 2].stamp < stamp or len(self._samples) > KEPT_AT_MOST:
            del self._samples[: max(len(self._samples) // 2 - KEPT_AT_LEAST, 0)]

    def foretold(self, stamp: int) -> OdometryTrail | None:
        """This trail, had odometry gone on to `stamp`, ns, as it went before; None where it may not have."""
        samples = _extrapolated(self._samples, stamp)
        if samples is None:
            return None
        trail = OdometryTrail(self._gate)
        trail._samples = samples
        return trail

    def covers(self, stamp: int) -> bool:
        """Whether odometry of `stamp` or later has arrived."""
        return bool(self._samples) and self._samples[-1].stamp >= stamp

    def at(self, stamp: int) -> Sample | None:
        """Odometry at `stamp` ns; beyond what is known the last pose, its age counted as unknown time.

        None where there was no odometry yet.
        """
        if not self._samples:
            return None
        known = self._asked.get(stamp)
        if known is None:
            known = self._asked[stamp] = self._found(stamp)
        return known

    def between(self, start: int, end: int) -> Motion:
        """Motion between two stamps, ns; all of it unknown where there was no odometry yet."""
        a, b = self.at(start), self.at(end)
        if a is None or b is None:
            seconds = (end - start) * 1e-9
            return Motion(IDENTITY, 0.0, 0.0, 0.0, abs(seconds), 0.0, seconds)
        return motion(a, b)

    def _found(self, stamp: int) -> Sample:
        index = bisect_left(self._samples, stamp, key=lambda sample: sample.stamp)
        if index == len(self._samples):
            last = self._samples[-1]
            return _held(last, stamp, last.unknown + (stamp - last.stamp) * 1e-9)
        if index == 0:
            first = self._samples[0]
            return _held(first, stamp, first.unknown - (first.stamp - stamp) * 1e-9)
        return _interpolate(self._samples[index - 1], self._samples[index], stamp)


def _extrapolated(samples: Sequence[Sample], stamp: int) -> list[Sample] | None:
    """Samples up to `stamp`, ns, and one there by the last two's velocity.

    None where the next odometry is due before `stamp`, for it is still to come; where the last one is of that
    very stamp; or where a jump or slip, or too long an interval, tells no velocity.
    """
    count = bisect_right(samples, stamp, key=lambda sample: sample.stamp)
    if count < 2:
        return None
    before, last = samples[count - 2], samples[count - 1]
    period, ahead = last.stamp - before.stamp, stamp - last.stamp
    if not 0 < ahead < period <= LONGEST_NS or last.breaks > before.breaks or last.slip > before.slip:
        return None
    share = ahead / period
    step = scaled(between(before.chained, last.chained), share)
    there = Sample(
        stamp,
        compose(last.raw, step),
        compose(last.chained, step),
        last.way + share * (last.way - before.way),
        last.turn + share * (last.turn - before.turn),
        last.slip,
        last.unknown + share * (last.unknown - before.unknown),
        last.breaks,
    )
    return [*samples[:count], there]


def _held(sample: Sample, stamp: int, unknown: float) -> Sample:
    return Sample(
        stamp, sample.raw, sample.chained, sample.way, sample.turn, sample.slip, unknown, sample.breaks
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
