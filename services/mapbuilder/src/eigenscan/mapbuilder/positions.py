"""Grid of the positions that a robot's lidar can be at (paper, section 3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from eigenscan.geometry.distance_tiles import distance_tiles
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from numpy.typing import NDArray
from scipy.ndimage import label

SMALLEST_SPACE_M2 = 0.5
"""Free space cut off from the rest and smaller than this is a gap between walls, not a place."""

AT_ONCE = 1_000_000
"""Grid points that are looked up at a time: each takes some hundred bytes."""


@dataclass(frozen=True)
class Positions:
    """Points `origin` + `index` * `spacing` of a grid that is aligned with the map frame.

    `index` (P, 2) int32, by rows of y, then x. `origin` (2,) and `spacing` in m.
    """

    index: NDArray[np.int32]
    origin: NDArray[np.float64]
    spacing: float

    @property
    def points(self) -> NDArray[np.float64]:
        """Map-frame points (P, 2), m."""
        return self.origin + self.index * self.spacing

    def at(self, which: NDArray[np.int64]) -> Positions:
        """Those `which` (K,)."""
        return replace(self, index=self.index[which])


def standable(grid: GridMap, clearance: float) -> NDArray[np.bool_]:
    """Cells (H, W) that are free, at least `clearance` m from every wall, and part of a place."""
    free = grid.cells == FREE
    for part, distance in distance_tiles(grid.cells != OCCUPIED, clearance / grid.resolution):
        free[part] &= distance * grid.resolution >= clearance
    parts, count = label(free, structure=np.ones((3, 3), dtype=int))
    area = np.zeros(count + 1)
    for rows in np.array_split(parts, max(len(parts) // 512, 1)):  # bincount makes its numbers longer
        area += np.bincount(rows.ravel(), minlength=count + 1) * grid.resolution**2
    place = area >= min(SMALLEST_SPACE_M2, area[1:].max(initial=0.0))
    place[0] = False
    kept: NDArray[np.bool_] = place[parts]
    return kept


def free_positions(grid: GridMap, spacing: float, clearance: float) -> Positions:
    """All grid points on standable cells. The grid's lines run through the map frame's origin.

    So the positions of a part of a building do not move when the map grows elsewhere.
    """
    height, width = grid.cells.shape
    corners = grid.to_map(np.array([[0, 0], [width, 0], [0, height], [width, height]]))
    low = np.floor(corners.min(axis=0) / spacing).astype(np.int64)
    high = np.ceil(corners.max(axis=0) / spacing).astype(np.int64)
    place, found = standable(grid, clearance), [np.empty((0, 2), dtype=np.int32)]
    columns, rows = (np.arange(low[k], high[k] + 1) for k in range(2))
    for block in np.array_split(rows, -(-len(columns) * len(rows) // AT_ONCE)):
        x, y = np.meshgrid(columns, block)
        index = np.column_stack([x.ravel(), y.ravel()])
        found.append(index[stands(grid, place, index * spacing)].astype(np.int32))
    return Positions(np.concatenate(found), np.zeros(2), spacing)


def stands(grid: GridMap, place: NDArray[np.bool_], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which map-frame points (K, 2) lie on cells of `place` (H, W)."""
    height, width = place.shape
    column, row = np.floor(grid.to_grid(points)).astype(np.int64).T
    inside: NDArray[np.bool_] = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    inside[inside] = place[row[inside], column[inside]]
    return inside
