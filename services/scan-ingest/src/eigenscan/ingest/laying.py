"""Laying a scan on an earlier one, compiled: points of the one on lines through neighbours of the other."""

from __future__ import annotations

from math import atan2, cos, inf, sin, sqrt
from typing import NamedTuple

import numpy as np
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.inner import inner
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Flags = NDArray[np.bool_]

WIDE, NEAR = 0.6, 0.2
"""m, how far a point may be off its line: in the first steps, and in the last."""
NOISE = 0.02
"""m, sigma of a point on its line: a lidar's noise and the roughness of walls."""
REACH = 4
"""Beams to either side that are looked at for the nearest point."""
ROUNDS, WIDE_ROUNDS = 10, 4
SETTLED = 1e-3
"""m and rad: a smaller step is the last."""
STAY = 0.1
"""What a motion weighs that the scans do not determine, in points."""
ON_LINE = 0.06
"""m off its line up to which a beam is explained: three sigma."""


class Walls(NamedTuple):
    """An earlier scan's beams as they are looked up.

    `x`, `y`: where each has its point, infinite without a line; REACH beams before and behind, the ends stand
    for what would be beyond them. `normals` (B, 2).
    """

    x: Array
    y: Array
    xy: Array
    normals: Array
    lidar_x: float
    lidar_y: float
    zero: float
    """Heading of the first beam in the base frame, rad."""
    step: float


@inner(error_model="numpy")  # pragma: no cover - compiled
def walls_of(
    xy: Array, normals: Array, lined: Flags, lidar_x: float, lidar_y: float, zero: float, step: float
) -> Walls:
    """An earlier scan's beams (B,), to lay others on."""
    last = len(xy) - 1
    x, y = np.full(last + 1 + 3 * REACH, inf), np.empty(last + 1 + 3 * REACH)
    for i in range(len(x)):
        beam = min(max(i - REACH, 0), last)
        y[i] = xy[beam, 1]
        if lined[beam]:
            x[i] = xy[beam, 0]
    return Walls(x, y, xy, normals, lidar_x, lidar_y, zero, step)


@inner(error_model="numpy")  # pragma: no cover - compiled
def lay(walls: Walls, points: Array, moved: Array, information: Array, counts: Index, on: Flags) -> None:
    """Lays points (n, 2) on the earlier scan from each of several motions `moved` (k, 3), which it corrects.

    Fills `information` (k, 3, 3), in points, `counts` (k, 2): of points that the earlier scan saw, and of
    those with a line; and which are `on` it (k, n).
    """
    row, sums, step = np.empty(4), np.empty((3, 4)), np.empty(3)
    for number in range(ROUNDS):
        reach = WIDE if number < WIDE_ROUNDS else NEAR
        largest = 0.0
        for k in range(len(moved)):
            x, y, turn = moved[k, 0], moved[k, 1], moved[k, 2]
            along, across = cos(turn), sin(turn)
            sums[:] = 0.0
            counts[k] = 0
            for j in range(len(points)):
                # as the point lies in the earlier base frame, before the shift and after it
                turned_x = along * points[j, 0] - across * points[j, 1]
                turned_y = along * points[j, 1] + across * points[j, 0]
                line, distance2, seen = _nearest(walls, turned_x + x, turned_y + y)
                used = seen and distance2 <= reach * reach
                counts[k, 0] += seen
                counts[k, 1] += used
                on[k, j] = False
                if not used:
                    continue
                # the normal and the error of a beam without a line are zero
                nx, ny = walls.normals[line, 0], walls.normals[line, 1]
                off = nx * (turned_x + x - walls.xy[line, 0]) + ny * (turned_y + y - walls.xy[line, 1])
                row[0], row[1], row[2], row[3] = nx, ny, turned_x * ny - turned_y * nx, off
                on[k, j] = abs(off) <= ON_LINE
                scaled = off / (2.0 * NOISE)
                weight = 1.0 / (1.0 + scaled * scaled)
                for i in range(3):
                    for column in range(4):
                        sums[i, column] += weight * row[i] * row[column]
            information[k] = sums[:, :3]
            # where the scans determine nothing, the motion stays
            for i in range(3):
                sums[i, i] += STAY
            _solve(sums, step)
            for i in range(3):
                moved[k, i] -= step[i]
                largest = max(largest, abs(step[i]))
        if number >= WIDE_ROUNDS and largest < SETTLED:
            break


@inner(error_model="numpy")  # pragma: no cover - compiled
def pulls_at(walls: Walls, points: Array, moved: Array) -> Array:
    """What each point (n, 2) adds to a motion's information: its normal and its lever, m, (n, 3).

    Both by the root of its weight. The lever is that of a turn about the base.
    """
    pulls = np.zeros((len(points), 3))
    along, across = cos(moved[2]), sin(moved[2])
    for j in range(len(points)):
        x = along * points[j, 0] - across * points[j, 1] + moved[0]
        y = along * points[j, 1] + across * points[j, 0] + moved[1]
        line, distance2, seen = _nearest(walls, x, y)
        if seen and distance2 <= NEAR * NEAR:
            nx, ny = walls.normals[line, 0], walls.normals[line, 1]
            scaled = (nx * (x - walls.xy[line, 0]) + ny * (y - walls.xy[line, 1])) / (2.0 * NOISE)
            root = 1.0 / sqrt(1.0 + scaled * scaled)
            pulls[j, 0], pulls[j, 1] = root * nx, root * ny
            pulls[j, 2] = root * ((x - moved[0]) * ny - (y - moved[1]) * nx)
    return pulls


@inner(error_model="numpy")  # pragma: no cover - compiled
def _nearest(walls: Walls, x: float, y: float) -> tuple[int, float, bool]:
    """The beam whose point is nearest of those that look at a place, its distance, m^2; whether any does."""
    last = len(walls.xy) - 1
    bearing = atan2(y - walls.lidar_y, x - walls.lidar_x) - walls.zero
    if not 0.0 <= bearing < TURN:  # a division costs as much as all the rest
        bearing = bearing + TURN if -TURN < bearing < 0.0 else bearing % TURN
    centre = int(np.rint(bearing / walls.step))
    first = min(max(centre, 0), last + REACH)
    nearest, best = inf, 0
    for i in range(2 * REACH + 1):
        dx, dy = walls.x[first + i] - x, walls.y[first + i] - y
        distance2 = dx * dx + dy * dy
        if distance2 < nearest:
            nearest, best = distance2, i
    return min(max(first + best - REACH, 0), last), nearest, centre <= last + REACH


@inner(error_model="numpy")  # pragma: no cover - compiled
def _solve(sums: Array, step: Array) -> None:
    """Solves positive definite equations (3, 4), the right-hand side last, by elimination in place."""
    for i in range(3):
        for below in range(i + 1, 3):
            share = sums[below, i] / sums[i, i]
            for column in range(i, 4):
                sums[below, column] -= share * sums[i, column]
    for i in range(2, -1, -1):
        left = sums[i, 3]
        for column in range(i + 1, 3):
            left -= sums[i, column] * step[column]
        step[i] = left / sums[i, i]


@inner(error_model="numpy")  # pragma: no cover - compiled
def eigen(a: float, b: float, c: float) -> tuple[float, float, float, float]:
    """Eigenvalues of a, b; b, c >= 0, the smaller one first, and its direction x, y: that of LAPACK."""
    apart, root = a - c, sqrt((a - c) * (a - c) + 4.0 * b * b)
    larger = 0.5 * (a + c + root)
    smaller = max(a, c) / larger * min(a, c) - b / larger * b if larger > 0.0 else 0.0
    if abs(b) <= np.finfo(np.float64).eps * sqrt(a * c):
        return (smaller, larger, 0.0, 1.0) if apart > 0.0 else (smaller, larger, 1.0, 0.0)
    slope = 2.0 * b / (abs(apart) + root)
    length = sqrt(1.0 + slope * slope)
    if apart > 0.0:
        return smaller, larger, slope / length, -1.0 / length
    return smaller, larger, -1.0 / length, slope / length
