"""Occupancy by ray carving with counts: how often a cell was hit, and how often it was looked through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from numba import njit
from numpy.typing import ArrayLike, NDArray

MARGIN = 2
"""Cells of UNKNOWN around all that was seen."""


@dataclass(frozen=True)
class Carving:
    """Counts (H, W) int32 on a grid whose cell (0, 0) has its outer corner at `low` (2,), m.

    `hits`: rays that ended in the cell; `passes`: rays that passed it.
    """

    hits: NDArray[np.int32]
    passes: NDArray[np.int32]
    low: NDArray[np.float64]
    resolution: float

    @classmethod
    def around(cls, points: ArrayLike, resolution: float) -> Carving:
        """Nothing counted yet, on a grid that holds the points (K, 2), m, aligned with the frame's origin."""
        array = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        low = np.floor(array.min(axis=0) / resolution) - MARGIN
        width, height = (np.floor(array.max(axis=0) / resolution) - low + 1 + MARGIN).astype(int)
        counts = np.zeros((height, width), dtype=np.int32)
        return cls(counts, counts.copy(), low * resolution, resolution)

    def add(self, viewpoints: ArrayLike, ends: ArrayLike) -> None:
        """Counts rays from `viewpoints` (2,) or (K, 2) to the walls at `ends` (K, 2), m, all on the grid."""
        to = np.ascontiguousarray((np.asarray(ends, dtype=np.float64) - self.low) / self.resolution)
        start = (np.asarray(viewpoints, dtype=np.float64) - self.low) / self.resolution
        # always a new array: one signature, compiled once
        _count(self.hits, self.passes, np.broadcast_to(start, to.shape).copy(), to)

    def to_map(self, share: float = 0.25, least_hits: int = 2) -> GridMap:
        """OCCUPIED from `share` of the rays and `least_hits` on; else FREE where looked through, or UNKNOWN.

        The share is well below a half: a ray that grazes a wall passes several of its cells.
        """
        seen = self.hits + self.passes
        cells = np.full(seen.shape, UNKNOWN, dtype=np.uint8)
        cells[self.passes > 0] = FREE
        cells[(self.hits >= least_hits) & (self.hits >= share * seen)] = OCCUPIED
        return GridMap(cells, self.resolution, np.array([*self.low, 0.0]))


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _count(
    hits: NDArray[np.int32], passes: NDArray[np.int32], starts: NDArray[np.float64], ends: NDArray[np.float64]
) -> None:
    """Exact grid traversal (Amanatides and Woo 1987) of each ray, in cells."""
    for k in range(len(ends)):
        x, y = starts[k]
        dx, dy = ends[k, 0] - x, ends[k, 1] - y
        column, row = int(np.floor(x)), int(np.floor(y))
        last_column, last_row = int(np.floor(ends[k, 0])), int(np.floor(ends[k, 1]))
        step_x, step_y = 1 if dx > 0 else -1, 1 if dy > 0 else -1
        to_x = ((column + (dx > 0)) - x) / dx if dx != 0 else np.inf
        to_y = ((row + (dy > 0)) - y) / dy if dy != 0 else np.inf
        per_x = abs(1.0 / dx) if dx != 0 else np.inf
        per_y = abs(1.0 / dy) if dy != 0 else np.inf
        for _ in range(abs(last_column - column) + abs(last_row - row)):
            passes[row, column] += 1
            if to_x < to_y:
                column += step_x
                to_x += per_x
            else:
                row += step_y
                to_y += per_y
        hits[last_row, last_column] += 1
