"""How a robot moved from one scan to a later one, in numpy: the oracle of the compiled form."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi

import numpy as np
from eigenscan.ingest.laying import (
    NEAR,
    NOISE,
    ON_LINE,
    REACH,
    ROUNDS,
    SETTLED,
    STAY,
    WIDE,
    WIDE_ROUNDS,
    Array,
    Index,
)
from eigenscan.ingest.motion import (
    APART_M,
    AS_WELL,
    BEAMS,
    FAR_OFF,
    FITS,
    FIXED,
    HELD_SUPPORT,
    LEAST_POINTS,
    LEAST_SUPPORT,
    LINE_M,
    MOST_BEAMS,
    MOST_TURN,
    NOTHING_IN_COMMON,
    OBLIQUE,
    SHIFTS,
    THING_M,
    TURN_BEAMS,
    TURN_STEP,
    TURNED_BY_FEW,
    Motion,
    Points,
    Pose,
)

_WINDOW = np.arange(-REACH, REACH + 1)


def around(before: Points) -> np.ndarray:
    """Of each beam (B + REACH,) those around it, x + iy; infinite where they have no line."""
    last = len(before.ranges) - 1
    near = np.minimum(np.maximum(np.arange(last + REACH + 1)[:, None] + _WINDOW, 0), last)
    return np.where(before.lined, before.xy[:, 0] + 1j * before.xy[:, 1], inf)[near]


def points_of(ranges: Array, angle_min: float, step: float, mount: Pose, stamp: int) -> Points:
    """The end points of a canonical scan's beams, without missing ranges (NaN or infinite)."""
    ranged = np.isfinite(ranges)
    ranges = np.where(ranged, ranges, np.nan)
    angles = angle_min + step * np.arange(len(ranges)) + mount[2]
    reach = np.where(ranged, ranges, 0.0)
    xy = np.column_stack([mount[0] + reach * np.cos(angles), mount[1] + reach * np.sin(angles)])
    # a neighbour farther off than a wall seen at a slant would be is on another surface
    along = np.diff(xy, axis=0)
    length2 = (along**2).sum(axis=1)
    joined = ranged[1:] & ranged[:-1]
    joined &= length2 <= (0.1 + 4.0 * step * np.minimum(reach[1:], reach[:-1])) ** 2
    # through its nearest neighbours alone a line turns with the noise
    beams, span = np.arange(len(xy)), np.ceil(LINE_M / np.maximum(step * reach, 1e-3)).astype(np.intp)
    span = np.minimum(span, MOST_BEAMS)
    breaks = np.flatnonzero(~joined)
    run = np.searchsorted(breaks, beams)
    first = np.append(0, breaks + 1)[run]
    last = np.append(breaks, len(xy) - 1)[run]
    tangents = xy[np.minimum(beams + span, last)] - xy[np.maximum(beams - span, first)]
    length = np.hypot(tangents[:, 0], tangents[:, 1])
    lined = length > 1e-6
    safe = np.where(lined, length, 1.0)
    normals = np.column_stack([-tangents[:, 1] / safe, tangents[:, 0] / safe])
    return Points(stamp, ranges, angle_min, step, mount, xy, normals, ranged, lined)


def motion_between(before: Points, after: Points, guess: Pose) -> Motion:
    """Motion from a lidar's earlier scan to a later one; starts from `guess` and from the ranges' turn."""
    if before.ranges.shape != after.ranges.shape or abs(before.angle_min - after.angle_min) > before.step:
        return NOTHING_IN_COMMON
    chosen = np.flatnonzero(after.ranged)
    if len(chosen) < LEAST_POINTS:
        return NOTHING_IN_COMMON
    points = after.xy[chosen[:: max(len(chosen) // BEAMS, 1)]]
    near = np.hypot(*np.moveaxis(points[:, None] - points, -1, 0)) <= THING_M
    tried = lay(before, points, np.array([guess, (0.0, 0.0, _first_turn(before, after))]))
    best = _best(tried, near)
    if best.explained >= FITS and _smallest(best) < HELD_SUPPORT * len(points):
        best = _held_along(before, points, best, near)
    if not best.count:
        return NOTHING_IN_COMMON
    return Motion(best.delta, _supported(before, points, best, near), best.explained, best.count)


@dataclass(frozen=True)
class Match:
    """A motion, its information (3, 3), what it explains, of how many points, and which are on a line."""

    delta: Pose
    information: Array
    explained: float
    count: int
    on: np.ndarray


def _smallest(match: Match) -> float:
    """How many points fix the worst determined direction."""
    return float(np.linalg.eigvalsh(match.information[:2, :2])[0]) * NOISE**2


def _beyond_one(worth: Array, near: np.ndarray) -> float:
    """The sum of what points (n,) are worth, less that of the one thing that is worth most."""
    return float(worth.sum() - ((near * worth).sum(axis=1) * (worth > 0.0)).max())


def _ahead(one: Match, other: Match, near: np.ndarray) -> float:
    """By how many points a match explains more than another does; those of one thing decide nothing."""
    return _beyond_one(1.0 * (one.on & ~other.on), near) - _beyond_one(1.0 * (other.on & ~one.on), near)


def _best(tried: list[Match], near: np.ndarray) -> Match:
    """The match that explains most; of several that explain alike the first."""
    best = tried[0]
    for match in tried[1:]:
        best = match if _ahead(match, best, near) > 0.0 else best
    return best


def _held_along(before: Points, points: Array, found: Match, near: np.ndarray) -> Match:
    """The match, or one further along that fits better; if two fit alike, their difference is undetermined.

    In a hallway, walls fit at any distance along it, and few beams show the distance. The fit then does not
    leave a wrong minimum.
    """
    x, y = np.linalg.eigh(found.information[:2, :2])[1][:, 0].tolist()
    starts = np.array(found.delta) + np.array((0.0, *SHIFTS))[:, None] * np.array([x, y, 0.0])
    tried = lay(before, points, starts)
    best = _best(tried, near)
    for rival in tried:
        off = x * (rival.delta[0] - best.delta[0]) + y * (rival.delta[1] - best.delta[1])
        if abs(off) > APART_M and _ahead(best, rival, near) <= AS_WELL * len(points):
            return Match(best.delta, _without(best.information, x, y), best.explained, best.count, best.on)
    return best


def _without(information: Array, x: float, y: float) -> Array:
    """Information (3, 3) without what is known along a direction."""
    kept = np.eye(3)
    kept[:2, :2] -= np.outer((x, y), (x, y))
    return np.asarray(kept @ information @ kept)


def _first_turn(before: Points, after: Points) -> float:
    """The turn, rad, after which the ranges of two scans are most alike, as if the lidar had not moved."""
    count = len(after.ranges)
    stride = max(count // TURN_BEAMS, 1)
    beams = np.arange(0, count, stride)
    shift = max(round(TURN_STEP / before.step), 1)
    most = int(MOST_TURN / before.step / shift)
    shifts = shift * np.arange(-most, most + 1)
    found = beams[None, :] + shifts[:, None]
    if 2.0 * pi - count * before.step < 1.5 * before.step:
        found %= count
    inside = (found >= 0) & (found < count)
    off = np.abs(before.ranges[np.where(inside, found, 0)] - after.ranges[beams])
    known = inside & np.isfinite(off)
    alike = known.sum(axis=1)
    cost = np.where(known, np.minimum(off, FAR_OFF), 0.0).sum(axis=1) / np.maximum(alike, 1)
    # of equally good turns the smallest, and none with little support by beams
    cost = np.where(2 * alike >= alike.max(), cost + 1e-3 * np.abs(shifts) * before.step, inf)
    return float(shifts[int(np.argmin(cost))]) * before.step


def lay(before: Points, points: Array, starts: Array) -> list[Match]:
    """Points (n, 2) laid on the earlier scan, from each of several motions (k, 3)."""
    moved = starts.copy()
    lidar, zero = complex(*before.mount[:2]), before.mount[2] + before.angle_min
    last = len(before.ranges) - 1
    # x + iy: numpy takes several times as long for arrays of pairs, and as long for x alone
    own, walls, normals = (
        np.ascontiguousarray(each).view(np.complex128)[:, 0] for each in (points, before.xy, before.normals)
    )
    window = around(before)
    rows = np.empty((len(starts), len(points), 4))
    first = _WINDOW.size * np.arange(len(starts) * len(points)).reshape(len(starts), len(points))
    for number in range(ROUNDS):
        turned = np.exp(1j * moved[:, 2:]) * own
        ends = turned + (moved[:, :1] + 1j * moved[:, 1:2])
        seen = ends - lidar
        bearing = np.arctan2(seen.imag, seen.real) - zero
        centre = np.rint((bearing % (2.0 * pi)) / before.step).astype(np.intp)
        visible = centre <= last + REACH
        centre = np.minimum(centre, last + REACH)
        apart = (window.take(centre, axis=0) - ends[..., None]).view(np.float64)
        apart *= apart
        distance2 = apart[..., ::2] + apart[..., 1::2]
        nearest = distance2.argmin(axis=-1)
        reach = WIDE if number < WIDE_ROUNDS else NEAR
        used = visible & (distance2.take(nearest + first) <= reach**2)
        line = np.minimum(np.maximum(centre + nearest - REACH, 0), last)
        # the normal and the error of a beam without a line are zero
        normal = normals.take(line)
        off = (normal.conj() * (ends - walls.take(line))).real
        weight = used / (1.0 + (off / (2.0 * NOISE)) ** 2)
        rows[..., :2] = normal.view(np.float64).reshape(*normal.shape, 2)
        rows[..., 2] = (turned.conj() * normal).imag
        rows[..., 3] = off
        sums = (rows[..., :3] * weight[..., None]).transpose(0, 2, 1) @ rows
        information, pull = sums[..., :3], sums[..., 3:]
        # where the scans determine nothing, the motion stays
        step = np.linalg.solve(information + STAY * np.eye(3), -pull)[..., 0]
        moved += step
        if number >= WIDE_ROUNDS and np.abs(step).max() < SETTLED:
            break
    on = used & (np.abs(off) <= ON_LINE)
    return matches(moved, information, visible.sum(axis=1), used.sum(axis=1), on)


def matches(moved: Array, information: Array, seen: Index, found: Index, on: np.ndarray) -> list[Match]:
    """What was found from each start: of how many points `seen`, with a line, and which on it."""
    explained = on.sum(axis=1) / np.maximum(seen, LEAST_POINTS)
    nothing = Match((0.0, 0.0, 0.0), np.zeros((3, 3)), 0.0, 0, np.zeros_like(on[0]))
    return [
        Match((x, y, turn), information[k] / NOISE**2, float(explained[k]), int(found[k]), on[k])
        if found[k] >= LEAST_POINTS
        else nothing
        for k, (x, y, turn) in enumerate(moved.tolist())
    ]


def _supported(before: Points, points: Array, match: Match, near: np.ndarray) -> Array:
    """The information (3, 3) without that on directions that too few points support, beside one thing."""
    information, least = match.information, LEAST_SUPPORT * match.count
    _, directions = np.linalg.eigh(information[:2, :2])
    pulls = _pulls(before, points, match.delta)
    for x, y in directions.T.tolist():
        if _beyond_one((pulls[:, :2] @ (x, y)) ** 2, near) < least:
            information = _without(information, x, y)
    return _doubted(information, points, match.delta, pulls)


def _doubted(information: Array, points: Array, moved: Pose, pulls: Array) -> Array:
    """The information (3, 3) with as much of it on a turn as the levers of most points (n, 2) show."""
    normals, levers = pulls[:, :2], pulls[:, 2]
    x, y = np.linalg.solve(normals.T @ normals + FIXED * np.eye(2), normals.T @ levers)
    levers = levers - normals @ (x, y)
    c, s = np.cos(moved[2]), np.sin(moved[2])
    away = np.hypot(*(points @ np.array([[c, s], [-s, c]]) - (y, -x)).T)
    worth = np.maximum(levers**2 - np.square(normals).sum(axis=1) * (away * OBLIQUE) ** 2, 0.0)
    share = np.sort(worth)[: int(len(worth) * (1.0 - TURNED_BY_FEW))].sum() / (np.square(levers).sum() + 1e-9)
    known = information @ (-x, -y, 1.0)
    both = known @ (-x, -y, 1.0)
    return information - (1.0 - share) * np.outer(known, known) / both if both > 0.0 else information


def _pulls(before: Points, points: Array, moved: Pose) -> Array:
    """What each point (n, 2) adds to the information: normal and lever, by the root of its weight (n, 3)."""
    x, y, turn = moved
    ends = points @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) + (x, y)
    bearing = np.arctan2(*(ends - before.mount[:2]).T[::-1]) - (before.mount[2] + before.angle_min)
    centre = np.rint((bearing % (2.0 * pi)) / before.step).astype(np.intp)
    last = len(before.ranges) - 1
    looked = np.clip(np.minimum(centre, last + REACH)[:, None] + _WINDOW, 0, last)
    walls = np.where(before.lined[:, None], before.xy, inf)
    apart = np.hypot(*np.moveaxis(walls[looked] - ends[:, None], -1, 0))
    line = looked[np.arange(len(ends)), apart.argmin(axis=1)]
    used = (centre <= last + REACH) & (apart.min(axis=1) <= NEAR)
    normals = before.normals[line]
    off = (normals * (ends - before.xy[line])).sum(axis=1)
    arms = ends - (x, y)
    levers = arms[:, 0] * normals[:, 1] - arms[:, 1] * normals[:, 0]
    root = used / np.hypot(1.0, off / (2.0 * NOISE))
    return np.asarray(np.column_stack([normals, levers]) * root[:, None])
