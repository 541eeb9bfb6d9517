"""Polishing poses below the grid: end points of the beams on the map's distance field.

Gauss-Newton with Geman-McClure weights whose scale shrinks, so that a pose slides into the nearest good fit
and single foreign points lose their say. Many poses slide on a coarse field, the best of them are polished
on the map's own. Between the cells' centres the distance is extrapolated along its gradient.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from eigenscan.geometry.pose import compose, inverse
from eigenscan.projector.wall_field import WallField, unpack
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Singles = NDArray[np.float32]
Words = NDArray[np.uint32]


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
_LARGEST_STEP_M, _LARGEST_STEP_RAD = 0.15, 0.1
_DAMPING = 1e-3
_LANES = 16
"""Single numbers in the widest vector registers."""


@dataclass(frozen=True)
class Fit:
    """Poses (n, 3) of the sensor, map frame; cost (n,), 0 where all points are on walls and 1 where none is;
    information (n, 3, 3): J'WJ of the points' distances by x, y, theta.
    """

    poses: Array
    cost: Array
    information: Array


def fit(field: WallField, poses: Array, points: Array, schedule: Schedule) -> Fit:
    """Fit of points (B, 2), m, sensor frame, to the walls, from sensor poses (n, 3) in the map frame."""
    local = np.ascontiguousarray(compose(inverse(field.origin), poses))
    cost = np.empty(len(local))
    information = np.empty((len(local), 3, 3))
    # x, y and weight; a whole number of vectors, for the rest of a loop is slow
    padded = np.zeros((3, -(-len(points) // _LANES) * _LANES), dtype=np.float32)
    padded[:2, : len(points)] = points.T / field.cell
    padded[2, : len(points)] = 1.0
    _fit(field.cells, field.cell, local, padded, schedule.squares, cost, information)
    cos, sin = np.cos(field.origin[2]), np.sin(field.origin[2])
    R = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return Fit(compose(field.origin, local), cost, R @ information @ R.T)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")  # pragma: no cover - compiled
def _fit(
    cells: Words,
    cell: float,
    poses: Array,
    points: Singles,
    scales: Array,
    cost: Array,
    information: Array,
) -> None:
    sums = np.empty(10, dtype=np.float32)
    count = max(points[2].sum(), np.float32(1.0))
    ahead, aside = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    # pose by pose within a step: the processor works at several poses at once
    for step in range(len(scales) - 1):
        for i in range(len(poses)):
            _sum(cells, cell, poses[i], ahead[i], aside[i], points, scales[step], sums)
            turn = _move(poses[i], sums, count)
            # of at most _LARGEST_STEP_RAD, by its series
            t2 = turn * turn
            cos, sin = 1.0 - t2 * (0.5 - t2 / 24.0), turn * (1.0 - t2 * (1.0 / 6.0 - t2 / 120.0))
            ahead[i], aside[i] = ahead[i] * cos - aside[i] * sin, aside[i] * cos + ahead[i] * sin
    for i in range(len(poses)):
        _sum(cells, cell, poses[i], ahead[i], aside[i], points, scales[-1], sums)
        cost[i] = sums[0] / count
        information[i, 0, 0], information[i, 1, 1], information[i, 2, 2] = sums[1], sums[4], sums[6]
        information[i, 0, 1] = information[i, 1, 0] = sums[2]
        information[i, 0, 2] = information[i, 2, 0] = sums[3]
        information[i, 1, 2] = information[i, 2, 1] = sums[5]


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")  # pragma: no cover - compiled
def _sum(
    cells: Words,
    cell: float,
    pose: Array,
    ahead: float,
    aside: float,
    points: Singles,
    scale2: float,
    sums: Singles,
) -> None:
    """Cost, upper triangle of J'WJ row by row, and J'Wd. Single precision, so that it fits vector units."""
    one, half, zero = np.float32(1.0), np.float32(0.5), np.float32(0.0)
    flat, width = cells.reshape(-1), np.int32(cells.shape[1])
    right, top = np.float32(cells.shape[1]) - half, np.float32(cells.shape[0]) - half
    cos, sin = np.float32(ahead), np.float32(aside)
    # one cell of border lies around the grid
    x, y = np.float32(pose[0] / cell + 1.0), np.float32(pose[1] / cell + 1.0)
    s2, unit = np.float32(scale2), np.float32(cell)
    px, py, weight = points[0], points[1], points[2]
    total = h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = zero
    for j in range(len(px)):
        rx, ry = cos * px[j] - sin * py[j], sin * px[j] + cos * py[j]
        u, v = min(max(x + rx, zero), right), min(max(y + ry, zero), top)
        column, row = np.int32(u), np.int32(v)
        centre, gx, gy = unpack(flat[np.uint32(np.int32(row * width) + column)])
        d = centre + (gx * (u - np.float32(column) - half) + gy * (v - np.float32(row) - half)) * unit
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
def _move(pose: Array, sums: Singles, points: float) -> float:
    """One damped Gauss-Newton step; how far it turned, rad."""
    damping = _DAMPING * points
    a, b, c = sums[1] + damping, sums[2], sums[3]
    d, e, f = sums[4] + damping, sums[5], sums[6] + damping
    g0, g1, g2 = sums[7], sums[8], sums[9]
    c00, c01, c02 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * c00 + b * c01 + c * c02
    c11, c12, c22 = a * f - c * c, b * c - a * e, a * d - b * b
    x = -(c00 * g0 + c01 * g1 + c02 * g2) / det
    y = -(c01 * g0 + c11 * g1 + c12 * g2) / det
    turn: float = -(c02 * g0 + c12 * g1 + c22 * g2) / det
    turn = min(max(turn, -_LARGEST_STEP_RAD), _LARGEST_STEP_RAD)
    shorten = min(1.0, _LARGEST_STEP_M / max(np.sqrt(x * x + y * y), 1e-12))
    pose[0] += x * shorten
    pose[1] += y * shorten
    pose[2] += turn
    return turn
