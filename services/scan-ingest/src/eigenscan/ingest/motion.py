"""How a robot moved from one scan to a later one, by these two scans alone.

Points of the later scan are laid on the lines through neighbouring points of the earlier one (Censi, "An ICP
variant using a point-to-line metric", ICRA 2008), from a turn that the ranges themselves suggest and from the
motion so far. Odometry plays no part, so that it can be held against the result. Compiled, because a scan
would need some 300 small calls of numpy; the tests have it in numpy.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, cos, hypot, inf, isfinite, pi, sin
from typing import NamedTuple

import numpy as np
from eigenscan.geometry.inner import inner
from eigenscan.ingest.laying import NOISE, Array, Flags, Index, Walls, eigen, lay, walls_of
from numba import njit, types

Pose = tuple[float, float, float]
"""x [m], y [m], theta [rad]"""

BEAMS = 90
"""Beams of the later scan that are laid on the earlier one."""
TURN_BEAMS, MOST_TURN, TURN_STEP = 60, 0.7, 0.02
"""Beams that are compared for the first guess of the turn, rad either way, rad a step."""
FAR_OFF = 0.5
"""m, difference of two ranges beyond which it does not matter how far."""
LINE_M, MOST_BEAMS = 0.1, 20
"""m to either side that a beam's line is laid through, and beams at most: noise shall turn it by little.

Chosen on fr079 and a simulated corridor: benchmarks/mechanisms.py."""
LEAST_POINTS = 15
LEAST_SUPPORT = 0.08
"""Share of the points that must fix a direction: fewer, at the ends of a hallway, slide along with it."""
HELD_SUPPORT = 0.25
"""Share of the points that fixes the worst determined direction, from which the match is not started again.

Of 2,711 such matches on six logs none ended more than 2 cm elsewhere when started again; of the 2,399 others
37, of which 13 more than 5 cm (benchmarks/scan_motion.py)."""
SHIFTS = (-0.3, -0.15, 0.15, 0.3)
"""m along the worst determined direction, from which the match starts again: what a robot drives meanwhile.
"""
APART_M, AS_WELL = 0.05, 0.12
"""Distance along it, m, from which two motions differ, and the share of beams that decides between them: a
person who walks ahead of the robot is up to a tenth of what it sees."""
FITS = 0.4
"""Share of the later scan that the earlier one has to explain."""


@dataclass(frozen=True)
class Points:
    """A scan's beams in the base frame.

    Ranges (B,) or NaN, points (B, 2), the normals (B, 2) of the lines through their neighbours, and which of
    them have a range, and a line.
    """

    stamp: int
    ranges: Array
    angle_min: float
    step: float
    mount: Pose
    xy: Array
    normals: Array
    ranged: Flags
    lined: Flags


@dataclass(frozen=True)
class Motion:
    """The base at the later scan in its frame at the earlier one, with the inverse of its covariance (3, 3).

    `explained`: share of the later scan's beams that the earlier one has too. `points`: how many of its beams
    are laid on the earlier one.
    """

    delta: Pose
    information: Array
    explained: float
    points: int = 0

    @property
    def fits(self) -> bool:
        """Whether the two scans have enough in common for the motion to mean anything."""
        return self.explained >= FITS

    @property
    def covariance(self) -> Array:
        """(3, 3) in m^2, m rad, rad^2; a metre or a radian where the scans determine nothing."""
        return np.asarray(np.linalg.inv(self.information + np.eye(3)), dtype=np.float64)


NOTHING_IN_COMMON = Motion((0.0, 0.0, 0.0), np.zeros((3, 3)), 0.0)


def points_of(ranges: Array, angle_min: float, step: float, mount: Pose, stamp: int) -> Points:
    """The end points of a canonical scan's beams, without missing ranges (NaN or infinite)."""
    known = np.where(np.isinf(ranges), np.nan, ranges)
    return Points(stamp, known, angle_min, step, mount, *_points(known, angle_min, step, *mount))


def motion_between(before: Points, after: Points, guess: Pose) -> Motion:
    """Motion from a lidar's earlier scan to a later one; starts from `guess` and from the ranges' turn."""
    if before.ranges.shape != after.ranges.shape or abs(before.angle_min - after.angle_min) > before.step:
        return NOTHING_IN_COMMON
    x, y, heading = before.mount
    delta, information, explained, points = _motion(
        before.ranges, before.xy, before.normals, before.lined, after.ranges, after.xy, after.ranged,
        (x, y, heading + before.angle_min, before.step), guess, HELD_SUPPORT,
    )  # fmt: skip
    return Motion(delta, information, explained, points) if points else NOTHING_IN_COMMON


_FLOAT, _ROW, _ROWS = types.float64, types.float64[::1], types.float64[:, ::1]
_MARKS, _THREE, _FOUR = types.boolean[::1], types.UniTuple(types.float64, 3), types.UniTuple(types.float64, 4)


@njit(  # pragma: no cover - compiled
    types.Tuple((_ROWS, _ROWS, _MARKS, _MARKS))(_ROW, _FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT),
    cache=True,
    error_model="numpy",
    nogil=True,
)
def _points(
    ranges: Array, angle_min: float, step: float, x: float, y: float, heading: float
) -> tuple[Array, Array, Flags, Flags]:
    """Points (B, 2), normals (B, 2), and which beams have a range, and a line."""
    count = len(ranges)
    xy, normals = np.empty((count, 2)), np.zeros((count, 2))
    ranged, lined = np.empty(count, dtype=np.bool_), np.empty(count, dtype=np.bool_)
    first, last = np.empty(count, dtype=np.intp), np.empty(count, dtype=np.intp)
    for i in range(count):
        ranged[i] = isfinite(ranges[i])
        angle, reach = angle_min + step * i + heading, ranges[i] if ranged[i] else 0.0
        xy[i, 0], xy[i, 1] = x + reach * cos(angle), y + reach * sin(angle)
        first[i] = i
        if i and ranged[i] and ranged[i - 1]:
            # a neighbour farther off than a wall seen at a slant would be is on another surface
            along, across = xy[i, 0] - xy[i - 1, 0], xy[i, 1] - xy[i - 1, 1]
            most = 0.1 + 4.0 * step * min(reach, ranges[i - 1])
            if along * along + across * across <= most * most:
                first[i] = first[i - 1]
    for i in range(count - 1, -1, -1):
        last[i] = last[i + 1] if i + 1 < count and first[i + 1] == first[i] else i
    for i in range(count):
        # through its nearest neighbours alone a line turns with the noise
        reach = ranges[i] if ranged[i] else 0.0
        span = int(min(ceil(LINE_M / max(step * reach, 1e-3)), MOST_BEAMS))
        end, start = min(i + span, last[i]), max(i - span, first[i])
        along, across = xy[end, 0] - xy[start, 0], xy[end, 1] - xy[start, 1]
        length = hypot(along, across)
        lined[i] = length > 1e-6
        if lined[i]:
            normals[i, 0], normals[i, 1] = -across / length, along / length
    return xy, normals, ranged, lined


class Match(NamedTuple):
    """Where points came to lie: the motion (3,), its information (3, 3), the share on lines, how many."""

    moved: Array
    information: Array
    explained: float
    points: int


@inner(error_model="numpy")  # pragma: no cover - compiled
def _laid(walls: Walls, points: Array, moved: Array) -> tuple[Array, Array, Index]:
    """Corrects motions (k, 3); their information (k, 3, 3), what they explain (k,) and of how many points."""
    information, counts = np.empty((len(moved), 3, 3)), np.empty((len(moved), 3), dtype=np.intp)
    lay(walls, points, moved, information, counts)
    explained, found = np.zeros(len(moved)), np.zeros(len(moved), dtype=np.intp)
    for k in range(len(moved)):
        if counts[k, 1] < LEAST_POINTS:
            moved[k], information[k] = 0.0, 0.0
            continue
        information[k] /= NOISE * NOISE
        explained[k], found[k] = counts[k, 2] / max(counts[k, 0], LEAST_POINTS), counts[k, 1]
    return information, explained, found


@inner(error_model="numpy")  # pragma: no cover - compiled
def _held_along(walls: Walls, points: Array, found: Match, held_support: float) -> Match:
    """The motion, or one further along that fits better; if two fit alike, their difference is undetermined.

    In a hallway, walls fit at any distance along it, and few beams show the distance. The fit then does not
    leave a wrong minimum.
    """
    own = found.information
    smaller, _, x, y = eigen(own[0, 0], own[1, 0], own[1, 1])
    if smaller * NOISE * NOISE >= held_support * len(points):
        return found
    moved = np.empty((len(SHIFTS), 3))
    for k in range(len(SHIFTS)):
        moved[k, 0], moved[k, 1] = found.moved[0] + SHIFTS[k] * x, found.moved[1] + SHIFTS[k] * y
        moved[k, 2] = found.moved[2]
    information, explained, counts = _laid(walls, points, moved)
    best = found
    for k in range(len(moved)):
        if explained[k] > best.explained:
            best = Match(moved[k], information[k], explained[k], counts[k])
    is_rivalled = _is_rival(best, found.moved, found.explained, x, y)
    for k in range(len(moved)):
        is_rivalled = is_rivalled or _is_rival(best, moved[k], explained[k], x, y)
    if is_rivalled:
        _forget(best.information, x, y)
    return best


@inner(error_model="numpy")  # pragma: no cover - compiled
def _is_rival(best: Match, moved: Array, explained: float, x: float, y: float) -> bool:
    """Whether another motion (3,) fits as well as the best, at another distance along x, y."""
    off = x * (moved[0] - best.moved[0]) + y * (moved[1] - best.moved[1])
    return abs(off) > APART_M and explained >= best.explained - AS_WELL


@inner(error_model="numpy")  # pragma: no cover - compiled
def _forget(information: Array, x: float, y: float) -> None:
    """Takes what is known along a direction out of the information (3, 3)."""
    known = np.empty(3)
    for i in range(3):
        known[i] = x * information[0, i] + y * information[1, i]
    both = x * known[0] + y * known[1]
    for i in range(3):
        at = x if i == 0 else y if i == 1 else 0.0
        for j in range(3):
            to = x if j == 0 else y if j == 1 else 0.0
            information[i, j] += at * both * to - at * known[j] - known[i] * to


@inner(error_model="numpy")  # pragma: no cover - compiled
def _support(match: Match) -> None:
    """Takes out the information on directions that too few points support."""
    own, least = match.information, LEAST_SUPPORT * match.points
    smaller, larger, x, y = eigen(own[0, 0], own[1, 0], own[1, 1])
    if smaller * NOISE * NOISE < least:
        _forget(own, x, y)
    if larger * NOISE * NOISE < least:
        _forget(own, -y, x)


@inner(error_model="numpy")  # pragma: no cover - compiled
def _first_turn(before: Array, after: Array, step: float) -> float:
    """The turn, rad, after which the ranges of two scans are most alike, as if the lidar had not moved."""
    count = len(after)
    stride, shift = max(count // TURN_BEAMS, 1), max(round(TURN_STEP / step), 1)
    most = int(MOST_TURN / step / shift)
    is_closed = 2.0 * pi - count * step < 1.5 * step
    costs, alike = np.empty(2 * most + 1), np.zeros(2 * most + 1, dtype=np.intp)
    for number in range(len(costs)):
        turned, cost = shift * (number - most), 0.0
        for beam in range(0, count, stride):
            found = beam + turned
            if is_closed:
                found %= count
            if 0 <= found < count:
                off = abs(before[found] - after[beam])
                if isfinite(off):
                    alike[number] += 1
                    cost += min(off, FAR_OFF)
        costs[number] = cost / max(alike[number], 1) + 1e-3 * abs(turned) * step
    # of equally good turns the smallest, and none with little support by beams
    best, least = 0, inf
    for number in range(len(costs)):
        if 2 * alike[number] >= alike.max() and costs[number] < least:
            best, least = number, costs[number]
    return shift * (best - most) * step


@njit(  # pragma: no cover - compiled
    types.Tuple((_THREE, _ROWS, _FLOAT, types.int64))(
        _ROW, _ROWS, _ROWS, _MARKS, _ROW, _ROWS, _MARKS, _FOUR, _THREE, _FLOAT
    ),
    cache=True,
    error_model="numpy",
    nogil=True,
)
def _motion(
    earlier: Array, earlier_xy: Array, normals: Array, lined: Flags, later: Array, later_xy: Array,
    ranged: Flags, lidar: tuple[float, float, float, float], guess: Pose, held_support: float,
) -> tuple[Pose, Array, float, int]:  # fmt: skip
    """The motion, its information (3, 3), the share that it explains, and on how many points; 0: none."""
    chosen = np.flatnonzero(ranged)
    if len(chosen) < LEAST_POINTS:
        return (0.0, 0.0, 0.0), np.zeros((3, 3)), 0.0, 0
    points = later_xy[chosen[:: max(len(chosen) // BEAMS, 1)]]
    walls = walls_of(earlier_xy, normals, lined, *lidar)
    moved = np.zeros((2, 3))
    moved[0, 0], moved[0, 1], moved[0, 2] = guess
    moved[1, 2] = _first_turn(earlier, later, walls.step)
    information, explained, found = _laid(walls, points, moved)
    best = int(np.argmax(explained))
    match = Match(moved[best], information[best], explained[best], found[best])
    if match.explained >= FITS:
        match = _held_along(walls, points, match, held_support)
    _support(match)
    x, y, turn = match.moved
    return (x, y, turn), match.information, match.explained, match.points
