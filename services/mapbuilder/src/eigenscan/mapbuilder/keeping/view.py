"""One view: a scan from a known pose, and the map's cells that it shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.carving import Carving
from eigenscan.geometry.gridmap import OCCUPIED, GridMap
from eigenscan.geometry.pose import transform
from numpy.typing import NDArray

MARGIN = 0.1
"""m before its end that a beam shows nothing of: its range and its place are not exact."""


@dataclass(frozen=True)
class View:
    """Beams from a sensor at `pose` (3,), map frame, at `stamp`, ns: `bearings` (B,), rad, `ranges` (B,), m.

    Only beams whose end is near enough to show its cell.
    """

    stamp: int
    pose: NDArray[np.float64]
    bearings: NDArray[np.float64]
    ranges: NDArray[np.float64]

    def points(self, ranges: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Map-frame points (B, 2), m, along the beams: their ends, or at other `ranges` (B,)."""
        r = self.ranges if ranges is None else ranges
        return transform(self.pose, np.column_stack([r * np.cos(self.bearings), r * np.sin(self.bearings)]))


@dataclass(frozen=True)
class Marks:
    """Cells that one view struck, and those that it looked through: masks (h, w) of a part of the map."""

    part: tuple[slice, slice]
    struck: NDArray[np.bool_]
    crossed: NDArray[np.bool_]


def mark(view: View, grid: GridMap, through: NDArray[np.bool_]) -> Marks:
    """The grid's cells that the view shows. A cell that any beam struck does not count as seen through.

    `through` (B,): beams that may show that they passed a mapped wall.
    """
    place = grid.to_grid(view.pose[:2])
    ends = grid.to_grid(view.points())
    before = grid.to_grid(view.points(np.maximum(view.ranges - MARGIN, 0.0)))
    carving = Carving.around(np.concatenate([ends, place[None]]), 1.0)
    carving.add(place, before[through])
    pierced = (carving.passes + carving.hits) > 0
    carving.add(place, before[~through])
    crossed = (carving.passes + carving.hits) > 0
    struck = np.zeros_like(crossed)
    column, row = np.floor(ends - carving.low).astype(np.int64).T
    struck[row, column] = True
    corner = carving.low.astype(np.int64)[::-1]
    low = np.clip(corner, 0, grid.cells.shape)
    high = np.clip(corner + crossed.shape, 0, grid.cells.shape)
    part, inner = (
        (slice(r0, r1), slice(c0, c1)) for (r0, c0), (r1, c1) in ((low, high), (low - corner, high - corner))
    )
    seen = np.where(grid.cells[part] == OCCUPIED, pierced[inner], crossed[inner])
    return Marks(part, struck[inner], seen & ~struck[inner])
