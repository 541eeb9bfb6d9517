"""Distance to the walls and its gradient, packed for one look-up a point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.distance_field import DistanceField
from numpy.typing import NDArray

REACH = 1.0
"""m: farther from any wall the distance says no more, and its gradient is 0."""


@dataclass(frozen=True)
class WallField:
    """Cells (h, w, 4) float32, each `cell` m wide, with a border of one cell around the map's grid.

    A cell holds the distance of its centre from the nearest wall, m, the distance's gradient in the grid's
    frame, and 0. `origin` (3,) is the grid's pose in the map frame.
    """

    cells: NDArray[np.float32]
    cell: float
    origin: NDArray[np.float64]

    @classmethod
    def of(cls, field: DistanceField, least_cell: float = 0.0) -> WallField:
        """Field at the map's resolution, or at a multiple of it that is about `least_cell` m."""
        block = max(1, round(least_cell / field.resolution))
        height, width = (-(-size // block) for size in field.distance.shape)
        padded = np.pad(
            np.minimum(field.distance, np.float32(REACH)),
            ((0, height * block - field.distance.shape[0]), (0, width * block - field.distance.shape[1])),
            mode="edge",
        )
        cell = block * field.resolution
        cells = np.zeros((height + 2, width + 2, 4), dtype=np.float32)
        cells[..., 0] = REACH
        cells[1:-1, 1:-1, 0] = padded.reshape(height, block, width, block).mean(axis=(1, 3))
        by_row, by_column = np.gradient(cells[..., 0], cell)
        cells[..., 1], cells[..., 2] = by_column, by_row
        cells[[0, -1], :, 1:] = 0.0
        cells[:, [0, -1], 1:] = 0.0
        return cls(cells, cell, np.asarray(field.origin, dtype=np.float64))
