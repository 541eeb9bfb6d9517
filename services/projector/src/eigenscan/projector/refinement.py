"""Refines poses below the grid: end points of the beams on the map's distance field.

Gauss-Newton with Geman-McClure weights whose scale shrinks, so a pose moves into the nearest good fit and
single foreign points lose their weight. Many poses are refined on a coarse field, the best of them on the
map's own. Between the cells' centres the distance is extrapolated along its gradient.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from eigenscan.projector.wall_field import WallField, unpack
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Singles = NDArray[np.float32]
Words = NDArray[np.uint32]
Flat = tuple[Words, int, int, float, float, float, float]
"""A field as compiled code takes it: cells row by row, rows, columns, cell, and its grid's pose."""
Room = tuple[Words, Singles, Singles, Singles, Singles]
"""For each point what `_sum` finds on its way: the cell, the place from the sensor, and that in the field."""


@dataclass(frozen=True)
class Schedule:
    """`steps` evaluations; the scale falls from `first` to `last`, m: there a point weighs a quarter."""

    first: float
    last: float
    steps: int

    @cached_property
    def squares(self) -> Array:
        """Squared scales (steps,), m^2."""
        return np.geomspace(self.first, self.last, self.steps) ** 2


SLIDE = Schedule(0.5, 0.15, 6)
POLISH = Schedule(0.2, 0.1, 6)
"""From a position of the grid to the walls; and from there to the best fit of all beams."""
_LARGEST_STEP_M, _LARGEST_STEP_RAD = 0.15, 0.1
"""Longest step of one evaluation, m and rad."""
_DAMPING = 1e-3
"""Added to each diagonal, for each point: along a hallway the beams fix nothing, and a step stays small."""
_LANES = 16
"""Single numbers in the widest vector registers."""
_HEADINGS, _HEADINGS_PER_RAD = 512, 512 / (2.0 * np.pi)
"""Headings whose cosines are kept; a power of two, twice those of a grid."""


@dataclass(frozen=True)
class Fit:
    """Poses (n, 3) of the sensor, map frame.

    Cost (n,): 0 where all points are on walls and 1 where none is. Information (n, 3, 3): J'WJ of the
    points' distances by x, y, theta.
    """

    poses: Array
    cost: Array
    information: Array


def flat(field: WallField) -> Flat:
    """The field for `fit_poses`."""
    height, width = field.cells.shape
    x, y, theta = field.origin.tolist()
    return field.cells.reshape(-1), height, width, field.cell, x, y, theta


def fit(field: WallField, poses: Array, points: Array, schedule: Schedule) -> Fit:
    """Fit of points (B, 2), m, sensor frame, to the walls, from sensor poses (n, 3) in the map frame.

    Points count `by_reach`.
    """
    found = Fit(np.empty(poses.shape), np.empty(len(poses)), np.empty((len(poses), 3, 3)))
    fit_poses(
        flat(field),
        poses,
        np.ascontiguousarray(points),
        schedule.squares,
        found.poses,
        found.cost,
        found.information,
    )
    return found


def cost_at(field: WallField, poses: Array, points: Array, scale: float) -> Singles:
    """Cost (n,) of sensor poses (n, 3) as they are: that of `fit` with one evaluation at this scale, m."""
    cost = np.empty(len(poses), dtype=np.float32)
    _cost_at(field.cells, field.cell, field.cells_of(poses), np.ascontiguousarray(points), scale, cost)
    return cost


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")  # pragma: no cover - compiled
def _cost_at(cells: Words, cell: float, poses: Array, ends: Array, scale: float, cost: Singles) -> None:
    """`cost_at` with poses as of `WallField.cells_of`."""
    (height, width), every = cells.shape, cells.reshape(-1)
    px, py, weight = _in_cells(ends, cell)
    half, zero, unit, s2 = np.float32(0.5), np.float32(0.0), np.float32(cell), np.float32(scale * scale)
    columns, right, top = np.int32(width), np.float32(width) - half, np.float32(height) - half
    at, words, u, v = np.empty(len(px), np.uint32), np.empty(len(px), np.uint32), px.copy(), py.copy()
    known, cosines = np.full(_HEADINGS, np.finfo(np.float64).max), np.empty((2, _HEADINGS), np.float32)
    for i in range(len(poses)):
        x, y, total = np.float32(poses[i, 0]), np.float32(poses[i, 1]), zero
        # poses of a grid share few headings
        k = np.uint64(np.int64(poses[i, 2] * _HEADINGS_PER_RAD) & (_HEADINGS - 1))
        if known[k] != poses[i, 2]:
            known[k] = poses[i, 2]
            cosines[0, k], cosines[1, k] = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        cos, sin = cosines[0, k], cosines[1, k]
        # the words in a loop of their own: not every processor's vector units look up
        for j in range(len(px)):
            u[j] = min(max(x + cos * px[j] - sin * py[j], zero), right)
            v[j] = min(max(y + sin * px[j] + cos * py[j], zero), top)
            at[j] = np.uint32(np.int32(np.int32(v[j]) * columns) + np.int32(u[j]))
        for j in range(len(px)):
            words[j] = every[np.uint64(at[j])]
        for j in range(len(px)):
            column, row = np.int32(u[j]), np.int32(v[j])
            centre, gx, gy = unpack(words[j])
            d = centre
            d += (gx * (u[j] - np.float32(column) - half) + gy * (v[j] - np.float32(row) - half)) * unit
            d2 = d * d
            total += d2 / (s2 + d2) * weight[j]
        cost[i] = total / max(len(ends), 1)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")  # pragma: no cover - compiled
def fit_poses(
    field: Flat,
    start: Array,
    ends: Array,
    scales: Array,
    poses: Array,
    cost: Array,
    information: Array,
) -> None:
    """For compiled code: `fit` with the field as of `flat`, `scales` as of Schedule.squares."""
    cells, height, width, cell, x0, y0, turned = field
    x, y, weight = _in_cells(ends, cell)
    count = max(len(ends), 1)
    sums = np.empty(10, dtype=np.float32)
    room = np.empty(len(x), np.uint32), np.empty_like(x), np.empty_like(x), np.empty_like(x), np.empty_like(x)
    cos0, sin0 = np.cos(turned), np.sin(turned)
    ahead, aside = np.cos(start[:, 2] - turned), np.sin(start[:, 2] - turned)
    for i in range(len(poses)):
        # cells of the field, around whose grid lies a border of one cell
        dx, dy = start[i, 0] - x0, start[i, 1] - y0
        poses[i, 0] = (cos0 * dx + sin0 * dy) / cell + 1.0
        poses[i, 1] = (cos0 * dy - sin0 * dx) / cell + 1.0
        poses[i, 2] = start[i, 2]
    # pose by pose within a step: the processor works at several poses at once
    for step in range(len(scales) - 1):
        for i in range(len(poses)):
            at = poses[i, 0], poses[i, 1], ahead[i], aside[i]
            _sum(cells, height, width, cell, at, x, y, weight, scales[step], room, sums)
            x_step, y_step, turn = _step(sums, count)
            poses[i, 0] += x_step / cell
            poses[i, 1] += y_step / cell
            poses[i, 2] += turn
            # of at most _LARGEST_STEP_RAD, by its series
            t2 = turn * turn
            cos, sin = 1.0 - t2 * (0.5 - t2 / 24.0), turn * (1.0 - t2 * (1.0 / 6.0 - t2 / 120.0))
            ahead[i], aside[i] = ahead[i] * cos - aside[i] * sin, aside[i] * cos + ahead[i] * sin
    for i in range(len(poses)):
        at = poses[i, 0], poses[i, 1], ahead[i], aside[i]
        _sum(cells, height, width, cell, at, x, y, weight, scales[-1], room, sums)
        cost[i] = sums[0] / count
        _turn(sums, cos0, sin0, information[i])
        dx, dy = (poses[i, 0] - 1.0) * cell, (poses[i, 1] - 1.0) * cell
        poses[i, 0] = x0 + cos0 * dx - sin0 * dy
        poses[i, 1] = y0 + sin0 * dx + cos0 * dy
        poses[i, 2] = (poses[i, 2] + np.pi) % (2.0 * np.pi) - np.pi


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _in_cells(points: Array, cell: float) -> tuple[Singles, Singles, Singles]:
    """Points (n, 2), m, in cells, and their weights as of `by_reach`.

    Filled up with points that weigh nothing to a whole number of vectors, for the rest of a loop is slow.
    """
    room = -(-len(points) // _LANES) * _LANES
    x, y, weight = np.zeros(room, np.float32), np.zeros(room, np.float32), np.zeros(room, np.float32)
    root, total = np.empty(len(points)), 0.0
    for j in range(len(points)):
        x[j], y[j] = points[j, 0] / cell, points[j, 1] / cell
        root[j] = np.sqrt(np.hypot(points[j, 0], points[j, 1]))
        total += root[j]
    mean = max(total / max(len(points), 1), 1e-9)
    for j in range(len(points)):
        weight[j] = root[j] / mean
    return x, y, weight


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")  # pragma: no cover - compiled
def _sum(
    flat: Words,
    height: int,
    width: int,
    cell: float,
    at: tuple[float, float, float, float],
    px: Singles,
    py: Singles,
    weight: Singles,
    scale2: float,
    room: Room,
    sums: Singles,
) -> None:
    """Cost, upper triangle of J'WJ row by row, and J'Wd. Single precision, so that it fits vector units.

    `at`: x and y in cells, cosine and sine of the heading.
    `room`, (B,) each, is filled.
    """
    one, half, zero = np.float32(1.0), np.float32(0.5), np.float32(0.0)
    columns = np.int32(width)
    right, top = np.float32(width) - half, np.float32(height) - half
    x, y, cos, sin = np.float32(at[0]), np.float32(at[1]), np.float32(at[2]), np.float32(at[3])
    s2, unit = np.float32(scale2), np.float32(cell)
    total = h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = zero
    words, ahead, aside, u, v = room
    # the words in a loop of their own: not every processor's vector units look up
    for j in range(len(px)):
        ahead[j], aside[j] = cos * px[j] - sin * py[j], sin * px[j] + cos * py[j]
        u[j], v[j] = min(max(x + ahead[j], zero), right), min(max(y + aside[j], zero), top)
        words[j] = np.uint32(np.int32(np.int32(v[j]) * columns) + np.int32(u[j]))
    for j in range(len(px)):
        words[j] = flat[np.uint64(words[j])]
    for j in range(len(px)):
        rx, ry = ahead[j], aside[j]
        column, row = np.int32(u[j]), np.int32(v[j])
        centre, gx, gy = unpack(words[j])
        d = centre + (gx * (u[j] - np.float32(column) - half) + gy * (v[j] - np.float32(row) - half)) * unit
        q = s2 / (s2 + d * d)
        w = q * q * weight[j]
        gt = (gy * rx - gx * ry) * unit
        wx, wy, wt = w * gx, w * gy, w * gt
        total += (one - q) * weight[j]
        h00 += wx * gx
        h01 += wx * gy
        h02 += wx * gt
        h11 += wy * gy
        h12 += wy * gt
        h22 += wt * gt
        g0 += wx * d
        g1 += wy * d
        g2 += wt * d
    sums[0] = total
    sums[1], sums[2], sums[3], sums[4], sums[5], sums[6] = h00, h01, h02, h11, h12, h22
    sums[7], sums[8], sums[9] = g0, g1, g2


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")  # pragma: no cover - compiled
def _step(sums: Singles, points: float) -> tuple[float, float, float]:
    """One damped Gauss-Newton step: m, m, rad, in the field's frame."""
    damping = _DAMPING * points
    a, b, c = sums[1] + damping, sums[2], sums[3]
    d, e, f = sums[4] + damping, sums[5], sums[6] + damping
    g0, g1, g2 = sums[7], sums[8], sums[9]
    c00, c01, c02 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * c00 + b * c01 + c * c02
    c11, c12, c22 = a * f - c * c, b * c - a * e, a * d - b * b
    x = -(c00 * g0 + c01 * g1 + c02 * g2) / det
    y = -(c01 * g0 + c11 * g1 + c12 * g2) / det
    turn = -(c02 * g0 + c12 * g1 + c22 * g2) / det
    shorten = min(1.0, _LARGEST_STEP_M / max(np.sqrt(x * x + y * y), 1e-12))
    return x * shorten, y * shorten, min(max(turn, -_LARGEST_STEP_RAD), _LARGEST_STEP_RAD)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")  # pragma: no cover - compiled
def _turn(sums: Singles, cos: float, sin: float, out: Array) -> None:
    """J'WJ (3, 3) in the map frame."""
    a, b, c, d, e = sums[1], sums[2], sums[3], sums[4], sums[5]
    out[0, 0] = cos * cos * a - 2.0 * cos * sin * b + sin * sin * d
    out[1, 1] = sin * sin * a + 2.0 * cos * sin * b + cos * cos * d
    out[0, 1] = out[1, 0] = cos * sin * (a - d) + (cos * cos - sin * sin) * b
    out[0, 2] = out[2, 0] = cos * c - sin * e
    out[1, 2] = out[2, 1] = sin * c + cos * e
    out[2, 2] = sums[6]
