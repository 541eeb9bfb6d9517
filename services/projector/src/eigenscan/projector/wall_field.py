"""Distance to the walls and its gradient, packed for one look-up a point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.geometry.pose import inverse, transform
from numba import njit
from numpy.typing import NDArray

REACH = 1.0
"""Distance from any wall, m, beyond which the field is constant and its gradient 0."""
_DISTANCE_STEPS, _SLOPE_STEPS = 4095, 511
_DISTANCE_UNIT, _SLOPE_UNIT = np.float32(REACH / _DISTANCE_STEPS), np.float32(1.0 / _SLOPE_STEPS)


@dataclass(frozen=True)
class WallField:
    """Cells (h, w) uint32, each `cell` m wide, with a border of one cell around the map's grid.

    A cell holds the distance of its centre from the nearest wall in 12 bits, up to REACH, and in 10 bits each
    the distance's gradient along the grid's axes; `unpack` takes it apart. A quarter of the size of three
    floats, a field stays in the cache. `origin` (3,) is the grid's pose in the map frame.
    """

    cells: NDArray[np.uint32]
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
        distance = np.full((height + 2, width + 2), REACH, dtype=np.float32)
        distance[1:-1, 1:-1] = padded.reshape(height, block, width, block).mean(axis=(1, 3))
        by_row, by_column = np.gradient(distance, cell)
        for slope in (by_row, by_column):
            slope[[0, -1]] = 0.0
            slope[:, [0, -1]] = 0.0
        return cls(_pack(distance, by_column, by_row), cell, np.asarray(field.origin, dtype=np.float64))

    @cached_property
    def map_in_field(self) -> NDArray[np.float64]:
        """The map frame's pose (3,) in the grid's."""
        return inverse(self.origin)

    def cells_of(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses (n, 3) of the map frame in the field: continuous (column, row), and heading, rad."""
        return cells_of(self.map_in_field, self.cell, np.ascontiguousarray(poses))

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """Distance (n,) of map-frame points (n, 2) from the nearest wall, m, at most about REACH."""
        local = transform(self.map_in_field, points) / self.cell + 1.0
        found: NDArray[np.float32] = _distances(self.cells, self.cell, local)
        return found


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def cells_of(
    map_in_field: NDArray[np.float64], cell: float, poses: NDArray[np.float64]
) -> NDArray[np.float64]:
    """`WallField.cells_of` for compiled code."""
    cos, sin = np.cos(map_in_field[2]), np.sin(map_in_field[2])
    out = np.empty(poses.shape)
    for i in range(len(poses)):
        # one cell of border lies around the grid
        out[i, 0] = (map_in_field[0] + cos * poses[i, 0] - sin * poses[i, 1]) / cell + 1.0
        out[i, 1] = (map_in_field[1] + sin * poses[i, 0] + cos * poses[i, 1]) / cell + 1.0
        out[i, 2] = map_in_field[2] + poses[i, 2]
    return out


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _distances(cells: NDArray[np.uint32], cell: float, points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Distances (n,) at continuous (column, row) (n, 2) of the field with its border."""
    out = np.empty(len(points), dtype=np.float32)
    for i in range(len(points)):
        out[i] = distance_near(cells, cell, points[i, 0], points[i, 1])
    return out


@njit(cache=True, nogil=True, fastmath=True, inline="always")  # pragma: no cover - compiled
def distance_near(cells: NDArray[np.uint32], cell: float, column: float, row: float) -> float:
    """Distance at a continuous (column, row) of the field with its border."""
    height, width = cells.shape
    u, v = min(max(column, 0.0), width - 0.5), min(max(row, 0.0), height - 0.5)
    c, r = int(u), int(v)
    centre, gx, gy = unpack(cells[r, c])
    return float(abs(centre + (gx * (u - c - 0.5) + gy * (v - r - 0.5)) * cell))


def _pack(
    distance: NDArray[np.float32], by_column: NDArray[np.float32], by_row: NDArray[np.float32]
) -> NDArray[np.uint32]:
    words: NDArray[np.uint32] = np.rint(distance / _DISTANCE_UNIT).astype(np.uint32)
    for shift, slope in ((12, by_column), (22, by_row)):
        steps = np.rint(np.clip(slope, -1.0, 1.0) * _SLOPE_STEPS) + (_SLOPE_STEPS + 1)
        words |= steps.astype(np.uint32) << np.uint32(shift)
    return words


@njit(cache=True, nogil=True, inline="always")  # pragma: no cover - compiled
def distance_at(word: np.uint32) -> float:
    """Distance, m, of the cell's centre."""
    return float(np.float32(np.int32(word & np.uint32(0xFFF))) * _DISTANCE_UNIT)


@njit(cache=True, nogil=True, fastmath=True, inline="always")  # pragma: no cover - compiled
def unpack(word: np.uint32) -> tuple[np.float32, np.float32, np.float32]:
    """Distance, m, and its gradient by column and by row."""
    middle = np.int32(_SLOPE_STEPS + 1)
    distance = np.float32(np.int32(word & np.uint32(0xFFF))) * _DISTANCE_UNIT
    by_column = np.float32(np.int32((word >> np.uint32(12)) & np.uint32(0x3FF)) - middle) * _SLOPE_UNIT
    by_row = np.float32(np.int32(word >> np.uint32(22)) - middle) * _SLOPE_UNIT
    return distance, by_column, by_row
