"""Laying a scan on an earlier one, compiled; `motion.lay` is the same in numpy.

Complex products are rounded once, as numpy rounds them, so that a motion is the same to its last bit.
"""

from __future__ import annotations

from math import atan2, cos, inf, sin
from typing import Any

import numpy as np
from eigenscan.geometry.circle import TURN
from eigenscan.ingest.motion import (
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
    Flags,
    Index,
    Motion,
    Points,
    motions,
)
from numba import njit, types
from numba.extending import intrinsic


def lay_compiled(before: Points, points: Array, starts: Array) -> list[Motion]:
    """Points (n, 2) laid on the earlier scan, from each of several motions (k, 3)."""
    moved = starts.copy()
    x, y, heading = before.mount
    lidar = x, y, heading + before.angle_min, before.step
    rows, weighted = np.empty((len(starts), len(points), 4)), np.empty((len(starts), len(points), 3))
    counts = np.empty((len(starts), 3), dtype=np.intp)
    for number in range(ROUNDS):
        reach = WIDE if number < WIDE_ROUNDS else NEAR
        earlier = before.xy, before.normals, before.lined
        _look(*earlier, lidar, points, moved, reach**2, rows, weighted, counts)
        sums = weighted.transpose(0, 2, 1) @ rows
        information, pull = sums[..., :3], sums[..., 3:]
        step = np.linalg.solve(information + STAY, -pull)[..., 0]
        moved += step
        if number >= WIDE_ROUNDS and np.abs(step).max() < SETTLED:
            break
    return motions(moved, information, *counts.T)


def _fuse(_typing: Any, _a: Any, _b: Any, _c: Any) -> Any:  # pragma: no cover - compiled
    def build(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        return builder.fma(*given)

    return types.float64(types.float64, types.float64, types.float64), build


_fused: Any = intrinsic(_fuse)
"""The sum a * b + c with one rounding."""


@njit(  # pragma: no cover - compiled
    "void(f8[:,::1], f8[:,::1], b1[::1], UniTuple(f8, 4), f8[:,::1], f8[:,::1], f8, f8[:,:,::1], "
    "f8[:,:,::1], i8[:,::1])",
    cache=True,
    nogil=True,
)
def _look(
    walls: Array,
    normals: Array,
    lined: Flags,
    lidar: tuple[float, float, float, float],
    points: Array,
    moved: Array,
    reach2: float,
    rows: Array,
    weighted: Array,
    counts: Index,
) -> None:
    """How far points (n, 2) are off the lines of the earlier scan (B, 2) after each motion `moved` (k, 3).

    `lidar`: x, y and heading of its first beam, in the base frame, and rad a beam. `reach2`, m^2: from where
    a line is another's. Fills `rows` (k, n, 4), derivatives by x, y and turn, and the error; the same
    `weighted` (k, n, 3); `counts` (k, 3) of points that the lidar saw, of those with a line, and on it.
    """
    lidar_x, lidar_y, zero, step = lidar
    last = len(walls) - 1
    # the ends stand for what would be beyond them, infinity for beams without a line
    wall_x, wall_y = np.empty((2, len(walls) + 3 * REACH))
    for i in range(len(wall_x)):
        beam = min(max(i - REACH, 0), last)
        wall_x[i], wall_y[i] = walls[beam, 0] if lined[beam] else inf, walls[beam, 1]
    for k in range(len(moved)):
        along, across = cos(moved[k, 2]), sin(moved[k, 2])
        counts[k] = 0
        for j in range(len(points)):
            # as the point lies in the earlier base frame, before the shift and after it
            turned_x = _fused(along, points[j, 0], -(across * points[j, 1]))
            turned_y = _fused(along, points[j, 1], across * points[j, 0])
            x, y = turned_x + moved[k, 0], turned_y + moved[k, 1]
            bearing = atan2(y - lidar_y, x - lidar_x) - zero
            if not 0.0 <= bearing < TURN:  # a division costs as much as all the rest
                bearing = bearing + TURN if -TURN < bearing < 0.0 else bearing % TURN
            centre = int(np.rint(bearing / step))
            seen = centre <= last + REACH
            first = min(max(centre, 0), last + REACH)
            nearest, best = inf, 0
            for i in range(2 * REACH + 1):
                dx, dy = wall_x[first + i] - x, wall_y[first + i] - y
                distance2 = dx * dx + dy * dy
                if distance2 < nearest:
                    nearest, best = distance2, i
            line = min(max(first + best - REACH, 0), last)
            used = seen and nearest <= reach2
            # the normal and the error of a beam without a line are zero
            nx, ny = normals[line, 0], normals[line, 1]
            off = _fused(nx, x - walls[line, 0], ny * (y - walls[line, 1]))
            turn = _fused(turned_x, ny, -(turned_y * nx))
            scaled = off / (2.0 * NOISE)
            weight = used / (1.0 + scaled * scaled)
            rows[k, j, 0], rows[k, j, 1], rows[k, j, 2], rows[k, j, 3] = nx, ny, turn, off
            weighted[k, j, 0], weighted[k, j, 1], weighted[k, j, 2] = nx * weight, ny * weight, turn * weight
            counts[k, 0] += seen
            counts[k, 1] += used
            counts[k, 2] += used and abs(off) <= ON_LINE
