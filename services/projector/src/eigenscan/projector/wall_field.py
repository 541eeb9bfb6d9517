"""Distance to the walls and its gradient, packed for one look-up a point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.distance_field import DistanceField
from numpy.typing import NDArray

CELL = 0.1
"""m, at least: coarse poses need no finer gradient."""
REACH = 1.0
"""m: farther from any wall the distance says no more, and its gradient is 0."""


@dataclass(frozen=True)
class WallField:
    """`cells` (h, w, 4) float32: distance in m, its gradient in the grid's frame, unused; `cell` m wide."""

    cells: NDArray[np.float32]
    cell: float

    @classmethod
    def of(cls, field: DistanceField) -> WallField:
        """Field at a cell of CELL or the map's own where that is larger."""
        block = max(1, round(CELL / field.resolution))
        height, width = (max(1, -(-size // block)) for size in field.distance.shape)
        padded = np.pad(
            np.minimum(field.distance, np.float32(REACH)),
            ((0, height * block - field.distance.shape[0]), (0, width * block - field.distance.shape[1])),
            mode="edge",
        )
        distance = padded.reshape(height, block, width, block).mean(axis=(1, 3), dtype=np.float32)
        cell = block * field.resolution
        cells = np.zeros((height + 2, width + 2, 4), dtype=np.float32)
        cells[..., 0] = REACH
        cells[1:-1, 1:-1, 0] = distance
        if min(distance.shape) > 1:
            by_row, by_column = np.gradient(distance, cell)
            cells[1:-1, 1:-1, 1], cells[1:-1, 1:-1, 2] = by_column, by_row
        return cls(cells, cell)
