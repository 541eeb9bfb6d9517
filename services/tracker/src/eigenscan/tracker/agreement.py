"""Whether odometry and scans show the same motion: each interval of scan motion is compared with odometry.

Scan-ingest publishes how the robot moved between two scans, by these alone. If odometry differs again
and again, one of them lies: scans are frozen, late, mirrored or of another robot, the lidar's mount is not as
stated, or wheels slip. Then no pose is claimed, for a similar place goes on as well as the right place does.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import exp, hypot, log

from eigenscan.tracker.odometry import Motion, OdometryTrail
from eigenscan.tracker.planar import IDENTITY, Pose, compose, wrap

SIGMA_M, SIGMA_RAD = 0.03, 0.04
"""What the two motions over an interval differ by where nothing is wrong..."""
ONE_SHARE = 0.4
"""Of these variances, what one interval has of it: (0.064 / 2.6 / SIGMA_RAD) squared."""
SIGMA_SHARE = 0.15
"""...and this share of the way and of the turn on top.

Of jarvis' and intel's intervals 99 of 100 are within 5 cm and 0.064 rad. No benchmark prints that yet;
benchmarks/integrity.py prints the false alarms that follow, on `none`.
"""
FARTHEST_M, FARTHEST_RAD = 0.3, 0.4
"""Between two scans farther apart by odometry than this the motion is often found wrongly: left out."""
UNKNOWN_S = 0.05
"""Of an interval that odometry does not cover, above which the interval is not compared."""
MOVED_M, MOVED_RAD = 0.1, 0.1
"""Intervals with less motion are joined: one alone shows nothing."""
TOGETHER_NS = 5_000_000_000
NEUTRAL, FOR_FAULT, AGAINST = 2.0, 3.0, -1.0
"""Nats for a fault: half the squared distance less NEUTRAL, at most and at least; motion errs heavily."""
TELLING = 2.0 * NEUTRAL
"""Squared distance from standing still that a motion needs for the scans to show it."""
AFTER_FAULT = -0.25
"""The same at least once a fault was seen: also a lidar that lies agrees now and then."""
APART = 1.5
"""Nats for a fault where two scans that must have much in common do not fit each other."""
FAULTY = log(0.01 / 0.99)
"""Log odds of a fault before anything moved: one set-up in a hundred is wrong."""
SUREST = (log(0.001), log(100.0))
FORWARDS = 5
"""After so many intervals with right odometry, a reversed one is the encoders' fault, not the mount's."""
JUMPS, JUMPS_NS = 3, 10_000_000_000
"""So many jumps of odometry in so long are no reset but two robots."""
KEPT = 40


Spread = tuple[float, float, float]
"""Covariance of a way: xx, xy, yy [m^2]."""


@dataclass(frozen=True)
class ScanInterval:
    """Motion between two scans of a lidar, stamps in ns; None where they do not fit each other."""

    lidar: str
    since: int
    stamp: int
    moved: Pose | None
    spread: Spread = (0.0, 0.0, 0.0)
    turn_variance: float = 0.0
    repeats: int = 0
    longest_step: float = 0.0
    """s, longest between two scans on the way."""


@dataclass(frozen=True)
class Compared:
    """An interval, or several, with both motions; `scans` None where the scans do not fit each other."""

    since: int
    stamp: int
    scans: Pose | None
    odometry: Pose
    spread: Spread
    is_fault: bool


@dataclass(frozen=True)
class _Open:
    """Intervals of one lidar, one after another, in which too little moved yet."""

    since: int
    scans: Pose = IDENTITY
    odometry: Pose = IDENTITY
    spread: Spread = (0.0, 0.0, 0.0)
    count: int = 0

    def longer_by(self, scans: Pose, odometry: Pose, spread: Spread) -> _Open:
        """With one interval more."""
        (xx, xy, yy), (more_xx, more_xy, more_yy) = self.spread, spread
        total = xx + more_xx, xy + more_xy, yy + more_yy
        scans, odometry = compose(self.scans, scans), compose(self.odometry, odometry)
        return _Open(self.since, scans, odometry, total, self.count + 1)


class _Odds:
    """Log odds that one part of the motion, the way or the turn, is wrong."""

    def __init__(self) -> None:
        self.value = FAULTY
        self._seen = False

    def take(self, gain: float) -> None:
        gain = max(gain, AFTER_FAULT if self._seen else AGAINST)
        self.value = min(max(self.value + min(gain, FOR_FAULT), SUREST[0]), SUREST[1])
        self._seen = self.value > 0.0 or (self._seen and self.value > FAULTY)


class Agreement:
    """How far scan motion and odometry of one robot agree."""

    def __init__(self) -> None:
        self._way, self._turn = _Odds(), _Odds()
        self._waiting: deque[ScanInterval] = deque(maxlen=64)
        self._open: dict[str, tuple[_Open, _Open]] = {}
        """By lidar: the way that is open, and the turn."""
        self._compared: deque[Compared] = deque(maxlen=KEPT)
        self._forwards = 0
        self._reversed_seen = False
        self._jumps: deque[int] = deque(maxlen=JUMPS)
        self._repeated: deque[tuple[str, int]] = deque(maxlen=64)
        self._received: deque[tuple[str, int, int]] = deque(maxlen=64)
        self.reversed = False
        """Whether odometry counted backwards as forwards when it was last compared."""

    @property
    def is_faulty(self) -> bool:
        """Whether odometry or scans rather lie than not."""
        return self.trust < 0.5

    @property
    def trust(self) -> float:
        """Probability that odometry and scans show the same motion."""
        return 1.0 / ((1.0 + exp(self._way.value)) * (1.0 + exp(self._turn.value)))

    @property
    def compared(self) -> list[Compared]:
        """The last comparisons, oldest first."""
        return list(self._compared)

    @property
    def without_sign(self) -> bool:
        """Whether encoders were found out to count backwards as forwards."""
        return self._reversed_seen and self._forwards >= FORWARDS

    def is_repeated(self, lidar: str, stamp: int) -> bool:
        """Whether a scan repeats the one before: it shows nothing new."""
        return (lidar, stamp) in self._repeated

    def note_jump(self, stamp: int) -> None:
        """Odometry's frame jumped."""
        self._jumps.append(stamp)
        if self.two_robots:
            self._way.value = SUREST[1]

    @property
    def two_robots(self) -> bool:
        """Whether odometry jumps so often that two robots must use one name."""
        return len(self._jumps) == JUMPS and abs(self._jumps[-1] - self._jumps[0]) <= JUMPS_NS

    def receive(self, interval: ScanInterval) -> None:
        """Keeps an interval until odometry has come as far; once, for it comes alone and with hypotheses."""
        key = interval.lidar, interval.since, interval.stamp
        if key in self._received:
            return
        self._received.append(key)
        if interval.repeats:
            self._repeated.append((interval.lidar, interval.stamp))
            if interval.moved is None:
                interval = ScanInterval(interval.lidar, interval.since, interval.stamp, IDENTITY)
        self._waiting.append(interval)

    def compare(self, trail: OdometryTrail, until: int) -> list[tuple[ScanInterval, Motion]]:
        """Compares the intervals that end by `until`, ns, with odometry, where there is some.

        By stamps, whatever came first: what arrived early counts no sooner. Gives the intervals over which
        the scans show the motion well, in order, each with odometry's.
        """
        found = []
        due = [each for each in self._waiting if each.stamp <= until]
        for interval in sorted(due, key=lambda each: (each.stamp, each.lidar)):
            self._waiting.remove(interval)
            if not interval.since < interval.stamp:
                continue
            driven = trail.between(interval.since, interval.stamp)
            if _is_far(driven, interval):
                self._open.pop(interval.lidar, None)
                continue
            if interval.moved is not None and not interval.repeats:
                found.append((interval, driven))
            if driven.breaks > 0 or abs(driven.unknown) > UNKNOWN_S:
                self._open.pop(interval.lidar, None)
            else:
                self._take(interval, driven)
        return found

    def _take(self, interval: ScanInterval, driven: Motion) -> None:
        if interval.moved is None:
            self._open.pop(interval.lidar, None)
            self._compared.append(
                Compared(interval.since, interval.stamp, None, driven.delta, (0.0, 0.0, 0.0), True)
            )
            self._way.take(APART)
            return
        held = self._open.setdefault(interval.lidar, (_Open(interval.since), _Open(interval.since)))
        way, turn = (each.longer_by(interval.moved, driven.delta, interval.spread) for each in held)
        if _moves(way):
            self._judge_way(way, interval.stamp)
        if _turns(turn):
            self._judge_turn(turn, interval.stamp)
        # a lidar that stands beside the turn's centre, other than stated, moves sideways with each turn
        done = [_moves(way) or _turns(way), _turns(turn)]
        again = _Open(interval.stamp)
        self._open[interval.lidar] = tuple(  # type: ignore[assignment]
            again if over or interval.stamp - each.since >= TOGETHER_NS else each
            for each, over in zip((way, turn), done, strict=True)
        )

    def _judge_way(self, held: _Open, stamp: int) -> None:
        x, y, turned = held.odometry
        off = distances2(held.scans, held.odometry, held.spread)[0]
        back = distances2(held.scans, (-x, -y, turned), held.spread)[0]
        longer = max(held.scans, held.odometry, key=lambda moved: hypot(moved[0], moved[1]))
        # along a hallway the scans may not even show whether the robot drives or stands
        shows = distances2(IDENTITY, longer, held.spread)[0] > TELLING
        drives = shows and hypot(x, y) > MOVED_M / 2.0
        is_reversed = drives and off > 4.0 * NEUTRAL and back < 2.0 * NEUTRAL
        is_forwards = drives and back > 4.0 * NEUTRAL and off < 2.0 * NEUTRAL
        self._note(held, stamp, off > 2.0 * NEUTRAL)
        self._learn_sign(is_reversed, is_forwards)
        if shows:
            if self.without_sign:
                off = distances2(held.scans, _along(held.odometry, held.scans), held.spread)[0]
            self._way.take(0.5 * off - NEUTRAL)
        if is_reversed or is_forwards:
            self.reversed = is_reversed

    def _judge_turn(self, held: _Open, stamp: int) -> None:
        # each interval errs again
        off = distances2(held.scans, held.odometry, held.spread)[1] / max(held.count * ONE_SHARE, 1.0)
        self._note(held, stamp, off > 2.0 * NEUTRAL)
        self._turn.take(0.5 * off - NEUTRAL)

    def _note(self, held: _Open, stamp: int, is_fault: bool) -> None:
        self._compared.append(Compared(held.since, stamp, held.scans, held.odometry, held.spread, is_fault))

    def _learn_sign(self, is_reversed: bool, is_forwards: bool) -> None:
        known = self.without_sign
        self._reversed_seen |= is_reversed
        self._forwards += is_forwards
        if self.without_sign and not known:
            self._way = _Odds()  # what spoke for a fault was this

    def change(self) -> float:
        """How much the scans changed of what odometry predicted, 0..1, when they were last compared."""
        last = self._compared[-1] if self._compared else None
        if last is None or last.scans is None:
            return 1.0
        driven = hypot(*last.odometry[:2]) + abs(last.odometry[2])
        seen = hypot(*last.scans[:2]) + abs(last.scans[2])
        return min(1.0, (seen + SIGMA_M) / (driven + SIGMA_M))


def _is_far(driven: Motion, interval: ScanInterval) -> bool:
    """Whether two scans on the way lie so far apart that the motion between them is often found wrongly."""
    x, y, turn = interval.moved or IDENTITY
    step = min(interval.longest_step / max(driven.seconds, 1e-9), 1.0)
    way, turned = max(driven.way, hypot(x, y)), max(driven.turn, abs(turn))
    return way * step > FARTHEST_M or turned * step > FARTHEST_RAD


def _along(odometry: Pose, scans: Pose) -> Pose:
    """What odometry without a sign predicts nearest to the scans: a part of its way, either way."""
    x, y, turn = odometry
    length2 = x * x + y * y
    share = (x * scans[0] + y * scans[1]) / length2 if length2 else 0.0
    share = min(max(share, -1.0), 1.0)
    return share * x, share * y, turn


def _moves(held: _Open) -> bool:
    return max(hypot(*held.scans[:2]), hypot(*held.odometry[:2])) >= MOVED_M


def _turns(held: _Open) -> bool:
    return max(abs(held.scans[2]), abs(held.odometry[2])) >= MOVED_RAD


def distances2(scans: Pose, odometry: Pose, spread: Spread) -> tuple[float, float]:
    """Squared distances of way and turn, in sigmas of what they differ by where nothing is wrong."""
    way = max(hypot(scans[0], scans[1]), hypot(odometry[0], odometry[1]))
    turn = max(abs(scans[2]), abs(odometry[2]))
    x, y, turned = scans[0] - odometry[0], scans[1] - odometry[1], wrap(scans[2] - odometry[2])
    variance = SIGMA_M**2 + (SIGMA_SHARE * way) ** 2
    xx, xy, yy = spread[0] + variance, spread[1], spread[2] + variance
    off = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / max(xx * yy - xy * xy, 1e-12)
    return off, turned * turned / (SIGMA_RAD**2 + (SIGMA_SHARE * turn) ** 2)
