"""How a robot moved from one scan to a later one, by these two scans alone.

Points of the later scan are laid on the lines through neighbouring points of the earlier one (Censi, "An ICP
variant using a point-to-line metric", ICRA 2008), from a turn that the ranges themselves suggest and from the
motion so far. Odometry plays no part, so that it can be held against the result. Compiled, because a scan
would need some 300 small calls of numpy; the tests have it in numpy.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, cos, hypot, inf, isfinite, pi, remainder, sin, sqrt, tau
from typing import NamedTuple

import numpy as np
from eigenscan.geometry.inner import inner
from eigenscan.ingest.laying import NOISE, Array, Flags, Index, Walls, eigen, lay, pulls_at, walls_of
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
TURNED_BY_FEW = 0.2
"""Share of the points, those with the longest levers, by which no turn is known: people walk about."""
OBLIQUE = 2.0 * sqrt(2.0) * NOISE / (2.0 * LINE_M)
"""rad, two sigmas of a normal: a lever that is shorter, as a share of the distance, may be none. In a round
hall where people walked, turns were off by 1 to 6 degrees with a stated 0.15 (benchmarks/mechanisms.py)."""
FIXED = 1.0
"""Points that keep the centre of a turn near the base: along a hallway nothing else does."""
HELD_SUPPORT = 0.25
"""Share of the points that fixes the worst determined direction, from which the match is not started again.

Of 2,711 such matches on six logs none ended more than 2 cm elsewhere when started again; of the 2,399 others
37, of which 13 more than 5 cm (benchmarks/scan_motion.py)."""
SHIFTS = (-0.3, -0.15, 0.15, 0.3)
"""m along the worst determined direction, from which the match starts again: what a robot drives meanwhile.
"""
APART_M, AS_WELL = 0.05, 0.12
"""Distance along it, m, from which two motions differ, and the share of beams that decides between them,
beside those of one thing."""
THING_M = 0.5
"""m around a point, within which beams may be of one thing that moves: a person, a cart. No direction is
fixed by one alone (benchmarks/scan_motion.py)."""
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


def moved_in(velocity: Pose, seconds: float) -> Pose:
    """Motion at a velocity, m/s, m/s, rad/s, in some seconds."""
    x, y, turn = velocity
    return x * seconds, y * seconds, turn * seconds


def points_of(ranges: Array, angle_min: float, step: float, mount: Pose, stamp: int) -> Points:
    """The end points of a canonical scan's beams, without missing ranges (NaN or infinite)."""
    known = np.where(np.isinf(ranges), np.nan, ranges)
    return Points(stamp, known, angle_min, step, mount, *_points(known, angle_min, step, *mount))


def motion_between(before: Points, after: Points, guess: Pose) -> Motion:
    """Motion from a lidar's earlier scan to a later one; starts from `guess` and from the ranges' turn."""
    apart = remainder(before.angle_min - after.angle_min, tau)  # -180 and 180 deg are one direction
    if before.ranges.shape != after.ranges.shape or abs(apart) > before.step:
        return NOTHING_IN_COMMON
    x, y, heading = before.mount
    delta, information, explained, points = _motion(
        before.ranges, before.xy, before.normals, before.lined, after.ranges, after.xy, after.ranged,
        (x, y, heading + before.angle_min, before.step), guess, HELD_SUPPORT, THING_M,
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


class Matches(NamedTuple):
    """Where points came to lie from k starts.

    The motions (k, 3), their information (k, 3, 3), what they explain (k,), of how many points (k,), and
    which are on a line (k, n).
    """

    moved: Array
    information: Array
    explained: Array
    points: Index
    on: Flags


@inner(error_model="numpy")  # pragma: no cover - compiled
def _laid(walls: Walls, points: Array, moved: Array) -> Matches:
    """The motions (k, 3), corrected in place, and what they explain."""
    information, counts = np.empty((len(moved), 3, 3)), np.empty((len(moved), 2), dtype=np.intp)
    on = np.empty((len(moved), len(points)), dtype=np.bool_)
    lay(walls, points, moved, information, counts, on)
    explained, found = np.zeros(len(moved)), np.zeros(len(moved), dtype=np.intp)
    for k in range(len(moved)):
        if counts[k, 1] < LEAST_POINTS:
            moved[k], information[k], on[k] = 0.0, 0.0, False
            continue
        information[k] /= NOISE * NOISE
        explained[k], found[k] = on[k].sum() / max(counts[k, 0], LEAST_POINTS), counts[k, 1]
    return Matches(moved, information, explained, found, on)


@inner(error_model="numpy")  # pragma: no cover - compiled
def _neighbours(points: Array, thing: float) -> Flags:
    """Which of the points (n, 2) may be of one thing with which (n, n): no more than `thing`, m, apart."""
    near = np.empty((len(points), len(points)), dtype=np.bool_)
    for j in range(len(points)):
        for i in range(len(points)):
            x, y = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1]
            near[j, i] = x * x + y * y <= thing * thing
    return near


@inner(error_model="numpy")  # pragma: no cover - compiled
def _beyond_one(worth: Array, near: Flags) -> float:
    """The sum of what points (n,) are worth, less that of the one thing that is worth most."""
    total, most = 0.0, 0.0
    for j in range(len(worth)):
        if worth[j] > 0.0:
            total += worth[j]
            thing = 0.0
            for i in range(len(worth)):
                thing += worth[i] if near[j, i] else 0.0
            most = max(most, thing)
    return total - most


@inner(error_model="numpy")  # pragma: no cover - compiled
def _ahead(one: Flags, other: Flags, near: Flags) -> float:
    """By how many points a match explains more than another does; those of one thing decide nothing."""
    mine, its = np.zeros(len(one)), np.zeros(len(one))
    for j in range(len(one)):
        mine[j] = one[j] and not other[j]
        its[j] = other[j] and not one[j]
    return _beyond_one(mine, near) - _beyond_one(its, near)


@inner(error_model="numpy")  # pragma: no cover - compiled
def _best(tried: Matches, near: Flags) -> int:
    """The match that explains most; of several that explain alike the first."""
    best = 0
    for k in range(1, len(tried.moved)):
        if _ahead(tried.on[k], tried.on[best], near) > 0.0:
            best = k
    return best


@inner(error_model="numpy")  # pragma: no cover - compiled
def _is_weak(own: Array, least: float) -> bool:
    """Whether fewer points than `least` fix the worst determined direction of the information (3, 3)."""
    smaller, _, _, _ = eigen(own[0, 0], own[1, 0], own[1, 1])
    return bool(smaller * NOISE * NOISE < least)


@inner(error_model="numpy")  # pragma: no cover - compiled
def _held_along(walls: Walls, points: Array, tried: Matches, first: int, near: Flags) -> tuple[Matches, int]:
    """The match, or one further along that fits better; if two fit alike, their difference is undetermined.

    In a hallway, walls fit at any distance along it, and few beams show the distance. The fit then does not
    leave a wrong minimum.
    """
    own = tried.information[first]
    _, _, x, y = eigen(own[0, 0], own[1, 0], own[1, 1])
    moved = np.empty((len(SHIFTS) + 1, 3))
    moved[:] = tried.moved[first]
    for k in range(len(SHIFTS)):
        moved[k + 1, 0] += SHIFTS[k] * x
        moved[k + 1, 1] += SHIFTS[k] * y
    again = _laid(walls, points, moved)
    best = _best(again, near)
    for k in range(len(moved)):
        off = x * (moved[k, 0] - moved[best, 0]) + y * (moved[k, 1] - moved[best, 1])
        if abs(off) > APART_M and _ahead(again.on[best], again.on[k], near) <= AS_WELL * len(points):
            _forget(again.information[best], x, y)
            break
    return again, best


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
def _support(walls: Walls, points: Array, found: Matches, best: int, near: Flags) -> None:
    """Takes out the information on directions that too few points support, beside those of one thing."""
    own, least = found.information[best], LEAST_SUPPORT * found.points[best]
    _, _, x, y = eigen(own[0, 0], own[1, 0], own[1, 1])
    pulls = pulls_at(walls, points, found.moved[best])
    for along, across in ((x, y), (-y, x)):
        if _beyond_one((along * pulls[:, 0] + across * pulls[:, 1]) ** 2, near) < least:
            _forget(own, along, across)
    _doubt_turn(own, points, found.moved[best], pulls)


@inner(error_model="numpy")  # pragma: no cover - compiled
def _doubt_turn(information: Array, points: Array, moved: Array, pulls: Array) -> None:
    """Leaves of the information (3, 3) on a turn what most points (n, 2) show of it by their levers.

    It is a turn about the centre where all levers are least: in a round room its middle.
    """
    x, y, levers = _centre(pulls)
    along, across = cos(moved[2]), sin(moved[2])
    total, worth = 1e-9, np.zeros(len(points))
    for j in range(len(points)):
        total += levers[j] ** 2
        off_x = along * points[j, 0] - across * points[j, 1] - x
        off_y = along * points[j, 1] + across * points[j, 0] - y
        by_noise = (pulls[j, 0] ** 2 + pulls[j, 1] ** 2) * (off_x * off_x + off_y * off_y) * OBLIQUE**2
        worth[j] = max(levers[j] ** 2 - by_noise, 0.0)
    worth.sort()
    of_most = worth[: int(len(worth) * (1.0 - TURNED_BY_FEW))].sum()
    _lessen(information, x, y, of_most / total)


@inner(error_model="numpy")  # pragma: no cover - compiled
def _centre(pulls: Array) -> tuple[float, float, Array]:
    """The centre of the turn that moves points least along their normals, m from the base; levers (n,) there.

    By the pulls (n, 3).
    """
    xx, xy, yy, xt, yt = FIXED, 0.0, FIXED, 0.0, 0.0
    for j in range(len(pulls)):
        x, y, turn = pulls[j]
        xx, xy, yy, xt, yt = xx + x * x, xy + x * y, yy + y * y, xt + x * turn, yt + y * turn
    area = xx * yy - xy * xy
    x, y = (yy * xt - xy * yt) / area, (xx * yt - xy * xt) / area
    return y, -x, pulls[:, 2] - x * pulls[:, 0] - y * pulls[:, 1]


@inner(error_model="numpy")  # pragma: no cover - compiled
def _lessen(information: Array, x: float, y: float, share: float) -> None:
    """Leaves this share of the information (3, 3) on a turn about a centre, m from the base."""
    known = np.empty(3)
    for i in range(3):
        known[i] = information[i, 2] + y * information[i, 0] - x * information[i, 1]
    both = known[2] + y * known[0] - x * known[1]
    if both > 0.0:
        for i in range(3):
            for j in range(3):
                information[i, j] -= (1.0 - share) * known[i] * known[j] / both


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
        _ROW, _ROWS, _ROWS, _MARKS, _ROW, _ROWS, _MARKS, _FOUR, _THREE, _FLOAT, _FLOAT
    ),
    cache=True,
    error_model="numpy",
    nogil=True,
)
def _motion(
    earlier: Array, earlier_xy: Array, normals: Array, lined: Flags, later: Array, later_xy: Array,
    ranged: Flags, lidar: tuple[float, float, float, float], guess: Pose, held_support: float, thing: float,
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
    near = _neighbours(points, thing)
    tried = _laid(walls, points, moved)
    best = _best(tried, near)
    if tried.explained[best] >= FITS and _is_weak(tried.information[best], held_support * len(points)):
        tried, best = _held_along(walls, points, tried, best, near)
    _support(walls, points, tried, best, near)
    x, y, turn = tried.moved[best]
    return (x, y, turn), tried.information[best], tried.explained[best], tried.points[best]
