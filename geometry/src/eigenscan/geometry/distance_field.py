"""Distance to the nearest wall, for likelihoods and refinement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.gridmap import OCCUPIED, UNKNOWN, GridMap
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

FAR = 1e3
"""Distance in a map without any wall, m."""


@dataclass(frozen=True)
class DistanceField:
    """Distances between cell centres; all arrays are plain, for numba callers.

    `distance` (H, W) float32: m from the cell's centre to the nearest OCCUPIED cell's centre; UNKNOWN
    is no wall. `known` (H, W) bool: the cell is FREE or OCCUPIED. `origin` (3,) and `resolution` as in
    GridMap.
    """

    distance: NDArray[np.float32]
    known: NDArray[np.bool_]
    resolution: float
    origin: NDArray[np.float64]

    @classmethod
    def of(cls, grid: GridMap) -> DistanceField:
        """Field of the map's walls, by the exact Euclidean distance transform."""
        wall = grid.cells == OCCUPIED
        if wall.any():
            distance = (distance_transform_edt(~wall) * grid.resolution).astype(np.float32)
        else:
            distance = np.full(wall.shape, FAR, dtype=np.float32)
        return cls(distance, grid.cells != UNKNOWN, grid.resolution, np.asarray(grid.origin))

    def at(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Distance (...,) in m and its gradient (..., 2) in the map frame at points (..., 2), bilinear.

        Beyond the map the distance of the nearest border cell is given, and its gradient is 0 there.
        A point that is not finite has distance and gradient NaN.
        """
        array = np.asarray(points, dtype=np.float64)
        values = _lookup(
            self.distance, self.resolution, self.origin, np.ascontiguousarray(array.reshape(-1, 2))
        )
        return values[:, 0].reshape(array.shape[:-1]), values[:, 1:].reshape(array.shape)


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def bilinear(distance: NDArray[np.float32], column: float, row: float) -> tuple[float, float, float]:
    """Value and its derivatives by column and row at continuous (column, row), cell centres at +0.5."""
    height, width = distance.shape
    x, y = column - 0.5, row - 0.5
    inside_x, inside_y = 0.0 <= x <= width - 1, 0.0 <= y <= height - 1
    x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
    c, r = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
    c1, r1 = min(c + 1, width - 1), min(r + 1, height - 1)
    fx, fy = x - c, y - r
    d00, d10 = distance[r, c], distance[r, c1]
    d01, d11 = distance[r1, c], distance[r1, c1]
    low, high = d00 + (d10 - d00) * fx, d01 + (d11 - d01) * fx
    by_column = (d10 - d00) * (1.0 - fy) + (d11 - d01) * fy if inside_x else 0.0
    by_row = high - low if inside_y else 0.0
    return low + (high - low) * fy, by_column, by_row


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _lookup(
    distance: NDArray[np.float32],
    resolution: float,
    origin: NDArray[np.float64],
    points: NDArray[np.float64],
) -> NDArray[np.float64]:
    cos, sin = np.cos(origin[2]), np.sin(origin[2])
    out = np.empty((len(points), 3))
    for i in range(len(points)):
        x, y = points[i, 0] - origin[0], points[i, 1] - origin[1]
        if not (np.isfinite(x) and np.isfinite(y)):
            out[i] = np.nan
            continue
        value, gx, gy = bilinear(distance, (cos * x + sin * y) / resolution, (cos * y - sin * x) / resolution)
        gx, gy = gx / resolution, gy / resolution
        out[i, 0] = value
        out[i, 1] = cos * gx - sin * gy
        out[i, 2] = sin * gx + cos * gy
    return out
