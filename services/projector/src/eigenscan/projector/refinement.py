"""Polishing poses below the grid: end points of the beams on the map's distance field.

Gauss-Newton with Geman-McClure weights whose scale shrinks from the grid's to the map's, so that a pose
slides into the nearest good fit and single foreign points lose their say.
"""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.distance_field import DistanceField, bilinear
from numba import njit
from numpy.typing import NDArray

FIRST_SCALE, LAST_SCALE = 0.4, 0.1
"""m, distance from a wall at which a point has lost three quarters of its weight."""
STEPS = 12
_LARGEST_STEP_M, _LARGEST_STEP_RAD = 0.15, 0.1
_DAMPING = 1e-3


def refine(
    field: DistanceField, poses: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Polished sensor poses (n, 3) and their information matrices (n, 3, 3) per m^2 of point error.

    `points` (B, 2) in the sensor's frame, m.
    """
    return _refine(
        field.distance,
        field.resolution,
        np.asarray(field.origin, dtype=np.float64),
        np.ascontiguousarray(poses, dtype=np.float64),
        np.ascontiguousarray(points),
    )


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _refine(
    distance: NDArray[np.float32],
    resolution: float,
    origin: NDArray[np.float64],
    poses: NDArray[np.float64],
    points: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    polished = poses.copy()
    information = np.zeros((len(poses), 3, 3))
    for i in range(len(poses)):
        pose = polished[i]
        for step in range(STEPS):
            scale = FIRST_SCALE * (LAST_SCALE / FIRST_SCALE) ** (step / (STEPS - 1))
            H, g = _normal_equations(distance, resolution, origin, pose, points, scale)
            information[i] = H
            if step == STEPS - 1:
                break
            H[0, 0] += _DAMPING * len(points)
            H[1, 1] += _DAMPING * len(points)
            H[2, 2] += _DAMPING * len(points)
            move = -_solve(H, g)
            length = np.sqrt(move[0] ** 2 + move[1] ** 2)
            if length > _LARGEST_STEP_M:
                move[:2] *= _LARGEST_STEP_M / length
            pose[:2] += move[:2]
            pose[2] += min(max(move[2], -_LARGEST_STEP_RAD), _LARGEST_STEP_RAD)
        pose[2] = (pose[2] + np.pi) % (2.0 * np.pi) - np.pi
    return polished, information


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _normal_equations(
    distance: NDArray[np.float32],
    resolution: float,
    origin: NDArray[np.float64],
    pose: NDArray[np.float64],
    points: NDArray[np.float64],
    scale: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """J'WJ (3, 3) and J'Wd (3,) of the points' distances d, by x, y and theta in the map frame."""
    turned = pose[2] - origin[2]
    cos, sin = np.cos(turned), np.sin(turned)
    co, so = np.cos(origin[2]), np.sin(origin[2])
    dx, dy = pose[0] - origin[0], pose[1] - origin[1]
    x, y = co * dx + so * dy, co * dy - so * dx
    h00 = h01 = h02 = h11 = h12 = h22 = 0.0
    g0 = g1 = g2 = 0.0
    s2 = scale * scale
    for j in range(len(points)):
        rx, ry = cos * points[j, 0] - sin * points[j, 1], sin * points[j, 0] + cos * points[j, 1]
        d, gc, gr = bilinear(distance, (x + rx) / resolution, (y + ry) / resolution)
        gx, gy = gc / resolution, gr / resolution
        q = s2 / (s2 + d * d)
        w = q * q
        gt = gy * rx - gx * ry
        h00 += w * gx * gx
        h01 += w * gx * gy
        h02 += w * gx * gt
        h11 += w * gy * gy
        h12 += w * gy * gt
        h22 += w * gt * gt
        g0 += w * gx * d
        g1 += w * gy * d
        g2 += w * gt * d
    H = np.array([[h00, h01, h02], [h01, h11, h12], [h02, h12, h22]])
    g = np.array([g0, g1, g2])
    if origin[2] != 0.0:
        R = np.array([[co, -so, 0.0], [so, co, 0.0], [0.0, 0.0, 1.0]])
        H, g = R @ H @ R.T, R @ g
    return H, g


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _solve(H: NDArray[np.float64], g: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solution of a positive definite 3 x 3 system, by cofactors."""
    a, b, c, d, e, f = H[0, 0], H[0, 1], H[0, 2], H[1, 1], H[1, 2], H[2, 2]
    c00, c01, c02 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * c00 + b * c01 + c * c02
    c11, c12, c22 = a * f - c * c, b * c - a * e, a * d - b * b
    return np.array(
        [
            (c00 * g[0] + c01 * g[1] + c02 * g[2]) / det,
            (c01 * g[0] + c11 * g[1] + c12 * g[2]) / det,
            (c02 * g[0] + c12 * g[1] + c22 * g[2]) / det,
        ]
    )
