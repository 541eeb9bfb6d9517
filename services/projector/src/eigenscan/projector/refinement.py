"""Polishing poses below the grid: end points of the beams on the map's distance field.

Gauss-Newton with Geman-McClure weights whose scale shrinks from the grid's to the map's, so that a pose
slides into the nearest good fit and single foreign points lose their say. First many poses slide on a coarse
field, then the best of them on the map's own.
"""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.distance_field import DistanceField, bilinear
from eigenscan.geometry.pose import compose, inverse
from eigenscan.projector.wall_field import WallField
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

SLIDE_SCALES = (0.5, 0.15)
"""m, first and last distance from a wall at which a point has lost three quarters of its weight."""
POLISH_SCALES = (0.2, 0.1)
SLIDE_STEPS, POLISH_STEPS = 6, 6
_LARGEST_STEP_M, _LARGEST_STEP_RAD = 0.15, 0.1
_DAMPING = 1e-3


def slide(field: WallField, origin: Array, poses: Array, points: Array) -> tuple[Array, Array]:
    """Poses (n, 3) of the sensor slid towards a fit, and their cost (n,), 0 where all points are on walls.

    `points` (B, 2) in the sensor's frame, m; `origin` (3,) of the map's grid.
    """
    local = np.ascontiguousarray(compose(inverse(origin), poses))
    cost = np.empty(len(local))
    _slide(field.cells, field.cell, local, np.ascontiguousarray(points), cost)
    return compose(origin, local), cost


def polish(field: DistanceField, poses: Array, points: Array) -> tuple[Array, Array]:
    """Polished poses (n, 3) of the sensor and J'WJ (n, 3, 3) of the distances by x, y, theta, map frame."""
    origin = np.asarray(field.origin, dtype=np.float64)
    local = np.ascontiguousarray(compose(inverse(origin), poses))
    information = np.zeros((len(local), 3, 3))
    _polish(field.distance, field.resolution, local, np.ascontiguousarray(points), information)
    cos, sin = np.cos(origin[2]), np.sin(origin[2])
    R = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return compose(origin, local), R @ information @ R.T


@njit(cache=True, nogil=True, inline="always")  # pragma: no cover - compiled
def _scale(scales: tuple[float, float], step: int, steps: int) -> float:
    return scales[0] * (scales[1] / scales[0]) ** (step / (steps - 1))


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _move(pose: Array, h: Array, g: Array, points: int) -> None:
    """One damped Gauss-Newton step; `h` holds the upper triangle of J'WJ, row by row."""
    damping = _DAMPING * points
    a, b, c, d, e, f = h[0] + damping, h[1], h[2], h[3] + damping, h[4], h[5] + damping
    c00, c01, c02 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * c00 + b * c01 + c * c02
    c11, c12, c22 = a * f - c * c, b * c - a * e, a * d - b * b
    x = -(c00 * g[0] + c01 * g[1] + c02 * g[2]) / det
    y = -(c01 * g[0] + c11 * g[1] + c12 * g[2]) / det
    turn = -(c02 * g[0] + c12 * g[1] + c22 * g[2]) / det
    shorten = min(1.0, _LARGEST_STEP_M / max(np.sqrt(x * x + y * y), 1e-12))
    pose[0] += x * shorten
    pose[1] += y * shorten
    pose[2] += min(max(turn, -_LARGEST_STEP_RAD), _LARGEST_STEP_RAD)


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _slide(cells: NDArray[np.float32], cell: float, poses: Array, points: Array, cost: Array) -> None:
    height, width = cells.shape[:2]
    px, py = points[:, 0] / cell, points[:, 1] / cell
    h, g = np.empty(6), np.empty(3)
    for i in range(len(poses)):
        pose = poses[i]
        for step in range(SLIDE_STEPS):
            s2 = _scale(SLIDE_SCALES, step, SLIDE_STEPS) ** 2
            cos, sin = np.cos(pose[2]), np.sin(pose[2])
            # one cell of border around the field
            x, y = pose[0] / cell + 1.0, pose[1] / cell + 1.0
            h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = total = 0.0
            for j in range(len(px)):
                rx, ry = cos * px[j] - sin * py[j], sin * px[j] + cos * py[j]
                column = min(max(int(x + rx), 0), width - 1)
                row = min(max(int(y + ry), 0), height - 1)
                d, gx, gy = cells[row, column, 0], cells[row, column, 1], cells[row, column, 2]
                q = s2 / (s2 + d * d)
                w = q * q
                gt = (gy * rx - gx * ry) * cell
                total += 1.0 - q
                h00 += w * gx * gx
                h01 += w * gx * gy
                h02 += w * gx * gt
                h11 += w * gy * gy
                h12 += w * gy * gt
                h22 += w * gt * gt
                g0 += w * gx * d
                g1 += w * gy * d
                g2 += w * gt * d
            cost[i] = total / max(len(px), 1)
            if step < SLIDE_STEPS - 1:
                h[0], h[1], h[2], h[3], h[4], h[5] = h00, h01, h02, h11, h12, h22
                g[0], g[1], g[2] = g0, g1, g2
                _move(pose, h, g, len(px))


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _polish(
    distance: NDArray[np.float32], resolution: float, poses: Array, points: Array, information: Array
) -> None:
    h, g = np.empty(6), np.empty(3)
    for i in range(len(poses)):
        pose = poses[i]
        for step in range(POLISH_STEPS):
            s2 = _scale(POLISH_SCALES, step, POLISH_STEPS) ** 2
            cos, sin = np.cos(pose[2]), np.sin(pose[2])
            h[:] = 0.0
            g[:] = 0.0
            for j in range(len(points)):
                rx, ry = cos * points[j, 0] - sin * points[j, 1], sin * points[j, 0] + cos * points[j, 1]
                d, gx, gy = bilinear(distance, (pose[0] + rx) / resolution, (pose[1] + ry) / resolution)
                gx, gy = gx / resolution, gy / resolution
                w = (s2 / (s2 + d * d)) ** 2
                gt = gy * rx - gx * ry
                h[0] += w * gx * gx
                h[1] += w * gx * gy
                h[2] += w * gx * gt
                h[3] += w * gy * gy
                h[4] += w * gy * gt
                h[5] += w * gt * gt
                g[0] += w * gx * d
                g[1] += w * gy * d
                g[2] += w * gt * d
            if step < POLISH_STEPS - 1:
                _move(pose, h, g, len(points))
        information[i] = np.array([[h[0], h[1], h[2]], [h[1], h[3], h[4]], [h[2], h[4], h[5]]])
