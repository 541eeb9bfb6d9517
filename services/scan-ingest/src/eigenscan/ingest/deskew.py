"""Deskews scans: moves beams that were measured while the robot moved to where the lidar was at the stamp.

A lidar that turns ten times a second skews a scan by 6 degrees where the robot turns at 1 rad/s. The scans
themselves show the motion, so odometry's faults stay out of them. They also show in which order beams were
measured. Some drivers reverse the beams and state a positive time between them (rplidar_ros); a simulated
lidar may take all at once. Of two scans that were swept while the robot turned unequally fast, those fit each
other that are deskewed in the right order.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, replace

import numpy as np
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.inner import inner
from eigenscan.geometry.normalize import GRAZING, SURFACE_NOISE, Ranges, Sweep
from eigenscan.geometry.pose import transform
from eigenscan.ingest.motion import Points, Pose, motion_between, moved_in, points_of
from numba import njit, types
from scipy.spatial import KDTree

SHORTEST_S, LONGEST_S = 0.005, 0.5
"""Duration of a sweep, s: in less a robot moves by less than a lidar's noise; none takes longer."""
APART_S = 0.5
"""Between two scans farther apart the motion does not give a velocity."""
LEAST_M, LEAST_RAD = 0.005, 0.002
"""Motion during a sweep that skews it by less than noise."""
UNEQUAL_RAD = 0.015
"""By so much more one of two scans must be skewed than the other for the order of beams to show."""
FAR_M = 0.15
"""m between two scans' points, beyond which it does not matter how far."""
COMPARED = 8
"""Scans before one that it may be compared with."""
LEAD = 5
"""Comparisons by which an order must be ahead of the others: in 90 to 100 of 100 the right one fits best on
olin and both guardians (benchmarks/deskew.py)."""
STRETCHED = 1.5
"""Of the step between beams, how far apart two may come to lie and still have a range between them."""
ORDERS = (0, 1, -1)
"""Beams measured all at once, in their order, against it."""


@dataclass(frozen=True)
class Timing:
    """When a scan's beams are measured: every `increment` s, the last one first where that is negative.

    `stamped_after`: s from the beam that was measured first to the scan's stamp.
    """

    increment: float
    stamped_after: float = 0.0


class Deskew:
    """Deskews the scans of one lidar, from when it is known in which order beams are measured."""

    def __init__(self) -> None:
        self.order: int | None = None
        """One of ORDERS; None: not known yet."""
        self._votes = Counter[int]()
        self._last: Points | None = None
        self.velocity: Pose | None = None
        """In the base frame, m/s, m/s, rad/s: the mean between the last two scans."""
        self._waiting: tuple[Sweep, Pose] | None = None
        """The last scan, and the velocity before it."""
        self._kept: deque[tuple[Sweep, Pose]] = deque(maxlen=COMPARED)

    def take(self, sweep: Sweep, timing: Timing, mount: Pose, stamp: int) -> Sweep:
        """The scan as all of it would be seen at its stamp, ns.

        Without a time between beams, or where the motion is not known, the scan as it is.
        """
        seconds = abs(timing.increment) * (len(sweep.ranges) - 1)
        if self.order == 0 or not SHORTEST_S <= seconds <= LONGEST_S:
            return sweep
        if not 0.0 <= timing.stamped_after <= LONGEST_S:
            timing = replace(timing, stamped_after=0.0)
        self._follow(points_of(sweep.ranges.astype(np.float64), *_grid(sweep), mount, stamp))
        if self.order is None:
            self._find_order(sweep, timing, mount, seconds)
        if not self.order or self.velocity is None:
            return sweep
        ahead, left, turn = self.velocity
        if max(abs(ahead), abs(left)) * seconds < LEAST_M and abs(turn) * seconds < LEAST_RAD:
            return sweep
        return deskewed(sweep, in_order(timing, self.order), self.velocity, mount)

    def _follow(self, points: Points) -> None:
        """Finds the velocity. Two scans skewed alike fit each other as if they were not."""
        before, self._last = self._last, points
        seconds = 0.0 if before is None else (points.stamp - before.stamp) * 1e-9
        if before is None or not 0.0 < seconds <= APART_S:
            self.velocity = None
            return
        moved = motion_between(before, points, moved_in(self.velocity or (0.0, 0.0, 0.0), seconds))
        self.velocity = moved_in(moved.delta, 1.0 / seconds) if moved.fits else None

    def _find_order(self, sweep: Sweep, timing: Timing, mount: Pose, seconds: float) -> None:
        """Compares the scan before this one, whose velocity is known by now, with one of another turn."""
        waiting, self._waiting = self._waiting, None
        if self.velocity is None:
            self._kept.clear()
            return
        self._waiting = sweep, self.velocity
        if waiting is None:
            return
        one, before = waiting
        velocity = tuple((a + b) / 2.0 for a, b in zip(before, self.velocity, strict=True))
        this = one, (velocity[0], velocity[1], velocity[2])
        if self._kept:
            other = max(self._kept, key=lambda kept: abs(kept[1][2] - velocity[2]))
            if abs(other[1][2] - velocity[2]) * seconds >= UNEQUAL_RAD:
                off = {order: _misfit(other, this, in_order(timing, order), mount) for order in ORDERS}
                self._votes[min(off, key=lambda order: off[order])] += 1
                (best, most), *others = self._votes.most_common()
                if most >= LEAD + max((count for _, count in others), default=0):
                    self.order = best
        self._kept.append(this)


def in_order(timing: Timing, order: int) -> Timing:
    """The same with the beams in one of ORDERS, by the order in which the driver states them."""
    return replace(timing, increment=order * timing.increment)


def deskewed(sweep: Sweep, timing: Timing, velocity: Pose, mount: Pose) -> Sweep:
    """The scan of a lidar at `mount` as it would be had the base stood since its stamp, and before.

    `velocity` in the base frame, m/s, m/s, rad/s.
    """
    step = sweep.angle_increment
    when = timing.increment, timing.stamped_after if timing.increment else 0.0
    ranges = _deskewed(sweep.ranges, sweep.angle_min, step, when, velocity, mount)
    return Sweep(ranges, sweep.angle_min, step)


@inner(error_model="numpy")  # pragma: no cover - compiled
def _as_at_stamp(
    reach: float, bearing: float, since: float, velocity: Pose, mount: Pose
) -> tuple[float, float]:
    """Bearing and range, seen from where the lidar was `since` s before, of a beam's end."""
    turned = velocity[2] * since
    if not np.isfinite(reach):
        return bearing + turned, reach
    # the base drives along the chord of its arc
    along, across = np.cos(turned / 2.0), np.sin(turned / 2.0)
    x = along * velocity[0] * since - across * velocity[1] * since - mount[0]
    y = across * velocity[0] * since + along * velocity[1] * since - mount[1]
    seen_x, seen_y = (
        mount[0] + reach * np.cos(mount[2] + bearing),
        mount[1] + reach * np.sin(mount[2] + bearing),
    )
    cos, sin = np.cos(turned), np.sin(turned)
    x, y = x + cos * seen_x - sin * seen_y, y + sin * seen_x + cos * seen_y
    off = (np.arctan2(y, x) - mount[2] - bearing + np.pi) % TURN - np.pi
    return bearing + off, np.hypot(x, y)


@inner(error_model="numpy")  # pragma: no cover - compiled
def _between(one: float, other: float, to_one: float, to_other: float, step: float) -> float:
    """The range between two beams, at angles from them, as `normalize.resample` finds it.

    Beams were `step` rad apart. By half as much more they may have been moved apart; beyond it nothing is
    known.
    """
    apart = to_one + to_other
    if to_one >= 0.0 and to_other >= 0.0 and 0.0 < apart <= STRETCHED * step:
        surface = SURFACE_NOISE + min(one, other) * min(apart * GRAZING, 1.0)
        chord = one * other * np.sin(apart) / (one * np.sin(to_one) + other * np.sin(to_other))
        if abs(one - other) <= surface and np.isfinite(chord):
            return float(chord)
    nearest = one if abs(to_one) < abs(to_other) else other
    return nearest if min(abs(to_one), abs(to_other)) <= 0.5 * STRETCHED * step else np.nan


_FLOAT, _TWO, _THREE = types.float64, types.UniTuple(types.float64, 2), types.UniTuple(types.float64, 3)
_RANGES = types.Array(types.float32, 1, "A", readonly=True)


@njit(  # pragma: no cover - compiled
    types.float32[::1](_RANGES, _FLOAT, _FLOAT, _TWO, _THREE, _THREE), cache=True, error_model="numpy"
)
def _deskewed(
    ranges: Ranges, angle_min: float, step: float, when: tuple[float, float], velocity: Pose, mount: Pose
) -> Ranges:
    """Ranges (B,) in the directions of the scan's own beams, by the beams as they were measured."""
    increment, stamped_after = when
    count = len(ranges)
    bearings, reach = np.empty(count), np.empty(count)
    for i in range(count):
        since = (increment * i if increment >= 0.0 else -increment * (count - 1 - i)) - stamped_after
        bearings[i], reach[i] = _as_at_stamp(ranges[i], angle_min + step * i, since, velocity, mount)
    closed = TURN - (count - 1) * step < 1.5 * step
    if closed:
        for i in range(count):
            bearings[i] = angle_min + (bearings[i] - angle_min) % TURN
    order = np.argsort(bearings, kind="mergesort")
    out, after = np.empty(count, dtype=np.float32), 0
    for i in range(count):
        wanted = angle_min + step * i
        while after < count and bearings[order[after]] < wanted:
            after += 1
        one, other = after - 1, after
        if not closed:
            one, other = max(one, 0), min(other, count - 1)
        # a full turn goes on at its ends
        a = bearings[order[one]] - (TURN if one < 0 else 0.0)
        b = bearings[order[other % count]] + (TURN if other == count else 0.0)
        out[i] = _between(reach[order[one]], reach[order[other % count]], wanted - a, b - wanted, step)
    return out


def _misfit(one: tuple[Sweep, Pose], other: tuple[Sweep, Pose], timing: Timing, mount: Pose) -> float:
    """Mean distance, m, of a scan's points from an earlier one's, both deskewed; FAR_M: they do not fit."""
    before, after = (
        points_of(straight.ranges.astype(np.float64), *_grid(straight), mount, 0)
        for straight in (deskewed(sweep, timing, velocity, mount) for sweep, velocity in (one, other))
    )
    moved = motion_between(before, after, (0.0, 0.0, 0.0))
    if not moved.fits:
        return FAR_M
    off, _ = KDTree(before.xy[before.ranged]).query(transform(moved.delta, after.xy[after.ranged]))
    return float(np.minimum(off, FAR_M).mean())


def _grid(sweep: Sweep) -> tuple[float, float]:
    return sweep.angle_min, sweep.angle_increment
