"""How a robot moved from one scan to a later one, in numpy: the oracle of the compiled form."""

from __future__ import annotations

from dataclasses import replace
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
    HELD_SUPPORT,
    LEAST_POINTS,
    LEAST_SUPPORT,
    LINE_M,
    MOST_BEAMS,
    MOST_TURN,
    NOTHING_IN_COMMON,
    SHIFTS,
    TURN_BEAMS,
    TURN_STEP,
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
    turn = _first_turn(before, after)
    tried = lay(before, points, np.array([guess, (0.0, 0.0, turn)]))
    best = max(tried, key=lambda each: each.explained)
    return _supported(_held_along(before, points, best) if best.fits else best)


def _held_along(before: Points, points: Array, found: Motion) -> Motion:
    """The motion, or one further along that fits better; if two fit alike, their difference is undetermined.

    In a hallway, walls fit at any distance along it, and few beams show the distance. The fit then does not
    leave a wrong minimum.
    """
    values, directions = np.linalg.eigh(found.information[:2, :2])
    if values[0] * NOISE**2 >= HELD_SUPPORT * len(points):
        return found
    x, y = directions[:, 0].tolist()
    starts = np.array(found.delta) + np.array(SHIFTS)[:, None] * np.array([x, y, 0.0])
    tried = [found, *lay(before, points, starts)]
    best = max(tried, key=lambda each: each.explained)
    for rival in tried:
        off = x * (rival.delta[0] - best.delta[0]) + y * (rival.delta[1] - best.delta[1])
        if abs(off) > APART_M and rival.explained >= best.explained - AS_WELL:
            kept = np.eye(3)
            kept[:2, :2] -= np.outer((x, y), (x, y))
            return replace(best, information=kept @ best.information @ kept)
    return best


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


def lay(before: Points, points: Array, starts: Array) -> list[Motion]:
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
    on_line = (used & (np.abs(off) <= ON_LINE)).sum(axis=1)
    return motions(moved, information, visible.sum(axis=1), used.sum(axis=1), on_line)


def motions(moved: Array, information: Array, seen: Index, found: Index, on_line: Index) -> list[Motion]:
    """What was found from each start: of how many points `seen`, with a line, and on it."""
    explained = on_line / np.maximum(seen, LEAST_POINTS)
    return [
        Motion((x, y, turn), information[k] / NOISE**2, float(explained[k]), int(found[k]))
        if found[k] >= LEAST_POINTS
        else NOTHING_IN_COMMON
        for k, (x, y, turn) in enumerate(moved.tolist())
    ]


def _supported(motion: Motion) -> Motion:
    """The motion without the information on directions that too few points support."""
    values, directions = np.linalg.eigh(motion.information[:2, :2])
    weak = directions[:, values * NOISE**2 < LEAST_SUPPORT * motion.points]
    if not weak.size:
        return motion
    kept = np.eye(3)
    kept[:2, :2] -= weak @ weak.T
    return replace(motion, information=kept @ motion.information @ kept)
