"""Aligns each scan with the ones before it, with odometry or without.

A scan becomes a keyframe after the robot has moved on. A scan that cannot be aligned begins a new part: at
once, or with odometry after a while. Only a bridge can join it to the others.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from eigenscan.geometry.pose import Array, between, compose
from eigenscan.mapbuilder.mapping.alignment import FLOOR, Alignment, align, energy
from eigenscan.mapbuilder.mapping.cloud import Cloud, Outline
from eigenscan.mapbuilder.mapping.correlation import Ground, correlate

NS = 1e9
_INERTIA_S = 0.5
"""Over which speed is averaged: stamps of a log may be uneven."""
_STRAINED = 7.8
"""Squared Mahalanobis distance of a scan from its expected pose that one in twenty exceeds (chi2, 3)."""


@dataclass(frozen=True)
class Sweep:
    """One received scan: `stamp` in ns, `mount` (3,) of the sensor in the base frame.

    `odometry` (3,): the base in the odometry frame at the stamp; None if unknown.
    """

    stamp: int
    outline: Outline
    mount: Array
    odometry: Array | None = None


@dataclass(frozen=True)
class Step:
    """How scans are chained. Lengths in m, angles in rad."""

    distance: float = 0.25
    turn: float = float(np.deg2rad(10.0))
    """Moved this far or turned this much, a scan becomes a keyframe."""
    recent: int = 20
    """Keyframes that a scan is aligned on."""
    least_points: int = 20
    """A scan with fewer is left out."""
    good: float = 0.6
    """Share of points on walls below which a scan is also searched around its expected pose."""
    enough: float = 0.35
    """Share below which it is not aligned at all."""
    blind: int = 10
    """Scans in a row that may go unaligned on odometry alone; after that, the robot may have been carried."""
    gap_s: float = 10.0
    """s without a scan after which a robot that has moved, by its odometry or unknown, begins a new part."""
    beside_s: float = 0.2
    """s within which a scan of another lidar leans on the one before it."""
    fastest: float = 5.0
    """m/s; odometry that claims more has jumped."""
    fastest_turn: float = 8.0
    """rad/s."""
    cell: float = 0.05
    """One point a square of this side is enough of a scan."""


@dataclass(frozen=True)
class Keyframe:
    """A scan that the map is made of; `pose` (3,) in the frame of its part, `cloud` in the base frame."""

    sweep: int
    part: int
    pose: Array
    cloud: Cloud
    covariance: Array | None
    """(3, 3) of the step from the keyframe before, in this one's frame; None: the first of its part."""


@dataclass
class Chain:
    """The placed scans so far."""

    keyframes: list[Keyframe] = field(default_factory=list)
    places: list[tuple[int, int, Array]] = field(default_factory=list)
    """For each placed scan: its number, its keyframe's, and its pose in the keyframe."""
    left_out: int = 0
    """Scans with too few points, or that odometry alone placed before a part ended."""
    jumps: int = 0
    """Steps of odometry that no robot can make."""


class Chainer:
    """Aligns scans in the order of their stamps."""

    def __init__(self, step: Step) -> None:
        self._step = step
        self.chain = Chain()
        self._recent: deque[Keyframe] = deque(maxlen=step.recent)
        self._local: Cloud | None = None
        self._last: tuple[Sweep, Array] | None = None
        self._velocity = np.zeros(3)
        self._seconds = 0.1
        self._blind: list[tuple[int, int, Array]] = []
        self._aligned: Sweep | None = None

    def add(self, number: int, sweep: Sweep) -> None:
        """Places one scan; leaves out one with too few points."""
        cloud = Cloud.of(sweep.outline, sweep.mount).thinned(self._step.cell)
        if np.count_nonzero(cloud.lengths) < self._step.least_points:
            self.chain.left_out += 1
            return
        if self._last is None or self._local is None or self._after_gap(sweep, *self._last):
            self._begin(number, sweep, cloud)
            return
        expected, prior, leads = self._expect(sweep, *self._last)
        found = self._align(cloud, expected, prior, leads)
        if found.share >= (self._step.good if self._blind else self._step.enough):
            self.chain.places += self._blind
            self._blind = []
            self._place(number, sweep, cloud, found)
            self._aligned = sweep
        elif self._beside(sweep):
            # the lidar looks elsewhere than the one before, and shows what that one will see
            self._place(number, sweep, cloud, Alignment(expected, prior + FLOOR, found.share))
        elif leads and len(self._blind) < self._step.blind:
            # a blocked lidar: odometry alone, until the walls are seen again
            newest = len(self.chain.keyframes) - 1
            self._blind.append((number, newest, between(self._recent[-1].pose, expected)))
            self._last = (sweep, expected)
        else:
            self._begin(number, sweep, cloud)

    def _after_gap(self, sweep: Sweep, last: Sweep, pose: Array) -> bool:
        """Whether the robot moved where the log has no scans: odometry over so long is no step of a chain."""
        if sweep.stamp - last.stamp <= self._step.gap_s * NS:
            return False
        expected, _, leads = self._expect(sweep, last, pose)
        moved = between(pose, expected)
        return (
            not leads or float(np.hypot(*moved[:2])) > self._step.distance or abs(moved[2]) > self._step.turn
        )

    def _beside(self, sweep: Sweep) -> bool:
        """Whether another lidar of the robot was aligned just before."""
        last = self._aligned
        if last is None or np.array_equal(last.mount, sweep.mount):
            return False
        return abs(sweep.stamp - last.stamp) <= self._step.beside_s * NS

    def _begin(self, number: int, sweep: Sweep, cloud: Cloud) -> None:
        """The first scan of a part, at the part's origin."""
        part = self.chain.keyframes[-1].part + 1 if self.chain.keyframes else 0
        self.chain.left_out += len(self._blind)
        self._blind = []
        self._recent.clear()
        self._velocity[:] = 0.0
        self._keep(Keyframe(number, part, np.zeros(3), cloud, None))
        self._aligned = sweep
        self._last = (sweep, np.zeros(3))

    def _expect(self, sweep: Sweep, last: Sweep, pose: Array) -> tuple[Array, Array, bool]:
        """Expected pose, its covariance in its own frame, and whether odometry leads there."""
        # stamps of a log may be uneven: a step in no time is no speed
        self._seconds = seconds = min(max((sweep.stamp - last.stamp) / NS, 0.1), 1.0)
        if sweep.odometry is not None and last.odometry is not None:
            moved = between(last.odometry, sweep.odometry)
            way, turn = float(np.hypot(*moved[:2])), abs(float(moved[2]))
            if way <= self._step.fastest * seconds + 0.1 and turn <= self._step.fastest_turn * seconds + 0.1:
                return compose(pose, moved), _odometry_covariance(way, turn), True
            self.chain.jumps += 1
        return compose(pose, self._velocity * seconds), _free(seconds), False

    def _align(self, cloud: Cloud, expected: Array, prior: Array, leads: bool) -> Alignment:
        """Aligns with the keyframes just before, from the expected pose.

        If scan and expectation disagree, it also tries other starts and takes the likeliest. Odometry may be
        wrong, so a contradiction costs no more than an unlikely error; inertia is not wrong in that way.
        """
        assert self._local is not None
        assert self._last is not None
        found = align(self._local, cloud, expected, prior)
        if found.share >= self._step.good and _strain(expected, prior, found.pose) < _STRAINED:
            return found
        _, last = self._last
        starts = [found.pose, last, compose(last, self._velocity * self._seconds)]
        if found.share < self._step.good:
            window = 3 * np.sqrt([prior[0, 0], prior[2, 2]]) + [0.2, 0.1]
            peaks, _ = correlate(Ground(self._local, np.zeros((0, 2))), cloud, expected, window)
            starts += list(peaks[:4])
        free = _free(self._seconds)
        others = [align(self._local, cloud, start, free) for start in starts]
        # against odometry, only a convincing match counts
        others = [one for one in others if not leads or one.share >= self._step.good]
        local, most = self._local, _STRAINED if leads else np.inf

        def cost(one: Alignment) -> float:
            return energy(local, cloud, one.pose) + min(_strain(expected, prior, one.pose), most)

        return min([found, *others], key=cost)

    def _place(self, number: int, sweep: Sweep, cloud: Cloud, found: Alignment) -> None:
        assert self._last is not None
        speed = between(self._last[1], found.pose) / self._seconds
        self._velocity += self._seconds / (self._seconds + _INERTIA_S) * (speed - self._velocity)
        self._last = (sweep, found.pose)
        newest = self._recent[-1]
        moved = between(newest.pose, found.pose)
        if np.hypot(*moved[:2]) < self._step.distance and abs(moved[2]) < self._step.turn:
            self.chain.places.append((number, len(self.chain.keyframes) - 1, moved))
            return
        self._keep(Keyframe(number, newest.part, found.pose, cloud, found.covariance))

    def _keep(self, keyframe: Keyframe) -> None:
        self.chain.keyframes.append(keyframe)
        self.chain.places.append((keyframe.sweep, len(self.chain.keyframes) - 1, np.zeros(3)))
        self._recent.append(keyframe)
        self._local = Cloud.joined([frame.cloud.moved(frame.pose) for frame in self._recent])


def _odometry_covariance(way: float, turn: float) -> Array:
    """Covariance (3, 3) of a step of wheel odometry: a tenth of the way and of the turn, and slip."""
    along = 0.02 + 0.1 * way
    heading = np.deg2rad(1.0) + 0.1 * turn + 0.05 * way
    return np.diag([along, along, heading]) ** 2


def _strain(expected: Array, prior: Array, pose: Array) -> float:
    """Squared Mahalanobis distance of `pose` from the expected one."""
    step = between(expected, pose)
    return float(step @ np.linalg.solve(prior, step))


def _free(seconds: float) -> Array:
    """Covariance (3, 3) of constant motion: speed changes and turns of a robot."""
    return np.diag([0.05 + 0.5 * seconds, 0.05 + 0.5 * seconds, 0.05 + 1.0 * seconds]) ** 2
