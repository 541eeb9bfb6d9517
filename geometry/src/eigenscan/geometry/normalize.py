"""Converts a driver's beams to the contract's: order, limits, angular grid.

NaN is missing (nothing is known), +inf is a beam without a return (REP 117).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from eigenscan.geometry.circle import TURN
from numpy.typing import NDArray

Ranges = NDArray[np.float32]

SMALLEST_STEP = 1e-6  # rad; no lidar comes near it

FARTHEST = 1e5  # m; a larger range or limit counts as none

FARTHEST_MOUNT = 100.0  # m of a lidar from its robot's base, at most: no robot is as large

MOST_BEAMS = 16_384
"""Of a scan: no lidar has more."""
LEAST_APART = 32
"""Beams with a range from which on their spacing is no chance: one in 2^31 that all are even or all odd."""

NO_RETURN_SHARE = 0.999
"""Share of the stated maximum from which a range is no return: drivers round their marker for it."""

SURFACE_NOISE = 0.03
"""m, range noise that two neighbours on one surface may differ by."""

GRAZING = math.tan(math.radians(75.0))
"""Two neighbours that differ by more than a wall seen 75 deg off its normal are not one surface."""


FAULTS = {
    "no_beams": "ranges: no beams",
    "no_valid_range": "ranges: none lies between range_min and range_max, in m",
    "angles_not_finite": "angle_min, angle_increment: must be numbers, in rad",
    "angle_increment_zero": "angle_increment: must not be 0",
    "over_a_turn": "angle_increment: the beams cover over one turn, or are over half a turn apart: give rad",
    "limits_inconsistent": "range_min, range_max: contradict each other, or are no numbers",
    "one_value": "ranges: all have one value: is the lidar covered?",
    "not_in_metres": "ranges: must be metres",
    "mount_too_far": f"mount: not finite, or over {FARTHEST_MOUNT:.0f} m from the base",
}
"""What the reason of a ScanError means, with the field, for whoever can mend it."""


class ScanError(ValueError):
    """A raw scan that nothing can be made of; `reason` is a counter's name."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


@dataclass(frozen=True)
class Sweep:
    """Ranges (B,), m; beam j looks along angle_min + j * angle_increment (rad) in the sensor's frame."""

    ranges: Ranges
    angle_min: float
    angle_increment: float


def orient(sweep: Sweep, upside_down: bool) -> Sweep:
    """Same beams, counter-clockwise seen from above, angle_min in [-pi, pi).

    Raises ScanError for invalid angles: not finite, no step, over a turn, or over half a turn apart.
    """
    ranges, first, step = sweep.ranges, sweep.angle_min, sweep.angle_increment
    count = len(ranges)
    if not (math.isfinite(first) and math.isfinite(step)):
        raise ScanError("angles_not_finite")
    if abs(step) < SMALLEST_STEP:
        raise ScanError("angle_increment_zero")
    if max(count - 1.5, 2.0) * abs(step) > TURN:
        raise ScanError("over_a_turn")
    if upside_down:
        first, step = -first, -step
    if step < 0.0:
        first, step, ranges = first + (count - 1) * step, -step, ranges[::-1]
    if not -math.pi <= first < math.pi:
        first = math.fmod(first, TURN)
        first += TURN if first < -math.pi else -TURN if first >= math.pi else 0.0
    return Sweep(ranges, first, step)


def limits(range_min: float, range_max: float) -> tuple[float, float]:
    """Both limits, m, as in the contract; a maximum of 0 or infinity means none.

    Raises ScanError if they contradict each other.
    """
    low, high = max(range_min, 0.0), 0.0 if range_max > FARTHEST else range_max
    if not (low < FARTHEST and high >= 0.0) or 0.0 < high <= low:
        raise ScanError("limits_inconsistent")
    return low, high


def limit(ranges: Ranges, range_min: float, range_max: float) -> Ranges:
    """Copy with every range within the limits, +inf or NaN.

    NaN, -inf, 0, negative and below `range_min` are missing; +inf and from NO_RETURN_SHARE of
    `range_max` on are no return. `range_max` 0: not stated.
    """
    limited = ranges.astype(np.float32)
    with np.errstate(invalid="ignore"):
        missing = ~(limited >= np.float32(range_min)) | (limited <= 0.0)
        limited[limited >= np.float32(NO_RETURN_SHARE * range_max if range_max > 0.0 else FARTHEST)] = np.inf
    limited[missing] = np.nan
    return limited


def own_beams(sweep: Sweep) -> Sweep:
    """The sweep on the lidar's own grid, where its driver writes a finer one and leaves beams empty between.

    Empty beams are missing, or without a return.
    """
    known = np.isfinite(sweep.ranges)
    if (known[1:] & known[:-1]).any():  # so it nearly always is
        return sweep
    at = np.flatnonzero(known)
    if len(at) < LEAST_APART:
        return sweep
    apart = int(np.gcd.reduce(np.diff(at)))
    first = int(at[0]) % apart
    return Sweep(
        sweep.ranges[first::apart].copy(),
        sweep.angle_min + first * sweep.angle_increment,
        sweep.angle_increment * apart,
    )


@dataclass(frozen=True)
class _Grid:
    """Places of the wanted directions (K,) between a sweep's beams."""

    first: float  # rad, first direction
    left: NDArray[np.int64]
    right: NDArray[np.int64]
    nearest: NDArray[np.int64]
    near: NDArray[np.bool_]  # the nearest beam is within half a step
    apart: NDArray[np.float32]  # rad, between the left and the right beam
    sines: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]  # to left, to right, apart


@lru_cache(maxsize=64)
def _grid(count: int, angle_min: float, own: float, step: float) -> _Grid:
    gap = TURN / own - (count - 1)  # steps between the last beam and the first, the other way round
    closed = gap < 1.5
    margin = 0.5 * min(own, step)
    first = math.ceil((angle_min - (0.0 if closed else margin)) / step - 1e-6)
    last = angle_min + (count - 1) * own + margin
    total = round(TURN / step) if closed else max(math.floor(last / step + 1e-6) - first + 1, 1)
    position = ((first + np.arange(total)) * step - angle_min) / own
    left = np.clip(np.floor(position).astype(np.int64), 0, count - 1)
    beyond = closed & (left == count - 1)
    right = np.where(beyond, 0, np.minimum(left + 1, count - 1))
    apart = np.where(beyond, max(gap, 1e-9), 1.0) * own
    offset = (position - left) * own
    nearest = np.where(offset < 0.5 * apart, left, right)
    near = np.minimum(np.abs(offset), np.abs(apart - offset)) <= 0.5 * step * (1.0 + 1e-6)
    # a beam's own direction keeps its range to the last bit
    between = (offset > 1e-6 * own) & (apart - offset > 1e-6 * own)
    inside = between & (left != right) & (apart < 0.5 * math.pi)
    chord = np.where(inside, apart, np.nan)
    sines = [np.sin(angle).astype(np.float32) for angle in (offset, apart - offset, chord)]
    start = first * step if first * step < math.pi else first * step - TURN
    return _Grid(start, left, right, nearest, near, apart.astype(np.float32), (sines[0], sines[1], sines[2]))


def resample(sweep: Sweep, step: float) -> Sweep:
    """Ranges on the multiples of `step` (rad) that the beams cover; a full turn stays one.

    Between two beams on one surface the chord between their endpoints is taken. Across a jump, or
    beside a beam without a range, the nearest beam, if it is within half a step; else nothing is known.
    """
    grid = _grid(len(sweep.ranges), sweep.angle_min, sweep.angle_increment, step)
    a, b = sweep.ranges[grid.left], sweep.ranges[grid.right]
    sine_a, sine_b, sine = grid.sines
    with np.errstate(invalid="ignore", divide="ignore"):
        surface = np.abs(a - b) <= SURFACE_NOISE + np.minimum(a, b) * np.minimum(grid.apart * GRAZING, 1.0)
        chord = a * b * sine / (a * sine_a + b * sine_b)
    kept = np.where(grid.near, sweep.ranges[grid.nearest], np.float32(np.nan))
    ranges = np.where(surface & np.isfinite(chord), chord, kept)
    return Sweep(ranges, grid.first, step)
