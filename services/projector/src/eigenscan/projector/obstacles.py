"""Finds the parts of a scan that the best pose does not explain: mask and obstacles (paper, section 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.gridmap import FREE, UNKNOWN, GridMap
from eigenscan.projector.wall_field import WallField, distance_near
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Singles = NDArray[np.float32]

THRESHOLD = 0.2
"""m, a beam that ends by more than this before its wall, and off every wall, is on an obstacle: the size from
which obstacles matter. Off every wall: beside a corner or along a wall a small error of the pose is a large
one of the range.
"""
EXPLAINED, OBSTACLE, MISSING = 1, 0, 255
USUAL_ERROR = 0.5
"""m, root mean square of an error vector at which the confidence has fallen to exp(-1/2)."""
_LARGEST_ERROR = 1.0
"""m, as which a larger error of a beam counts in the confidence."""


@dataclass(frozen=True)
class ObstacleMask:
    """Mask (B,) uint8 and error (B,) m of a scan at a pose; obstacles (n, 2), m."""

    mask: NDArray[np.uint8]
    error: NDArray[np.float32]
    error_energy: float
    confidence: float
    in_sensor: NDArray[np.float64]
    in_map: NDArray[np.float64]


def find_obstacles(
    pose: NDArray[np.float64],
    bearings: NDArray[np.float64],
    ranges: NDArray[np.float32],
    predicted: NDArray[np.float32],
    walls: WallField,
    grid: GridMap,
) -> ObstacleMask:
    """Obstacles of a scan (B,) at a sensor pose (3,) with predicted ranges (B,), +inf: no wall in sight.

    Where no wall is in sight an end point on free ground is on an obstacle; off the known map it is nothing.
    """
    beams = len(ranges)
    mask, error = np.empty(beams, dtype=np.uint8), np.empty(beams, dtype=np.float32)
    in_sensor, in_map = np.empty((beams, 2)), np.empty((beams, 2))
    count, square, bounded = _mark(
        pose,
        bearings,
        ranges,
        predicted,
        (walls.cells, walls.cell, walls.map_in_field),
        (grid.cells, grid.resolution, grid.map_in_grid),
        (mask, error, in_sensor, in_map),
    )
    energy, confidence = np.sqrt(square), np.exp(-0.5 * bounded / USUAL_ERROR**2)
    return ObstacleMask(mask, error, float(energy), float(confidence), in_sensor[:count], in_map[:count])


@njit(cache=True, nogil=True, error_model="numpy")  # pragma: no cover - compiled
def _mark(
    pose: Array,
    bearings: Array,
    ranges: Singles,
    predicted: Singles,
    walls: tuple[NDArray[np.uint32], float, Array],
    ground: tuple[NDArray[np.uint8], float, Array],
    out: tuple[NDArray[np.uint8], Singles, Array, Array],
) -> tuple[int, float, float]:
    """Fills the mask, the errors and the obstacles' points; their number, and the mean squared errors.

    The second of them is of errors that are bounded, +inf where no error is known.
    """
    mask, error, in_sensor, in_map = out
    count, known, square, bounded = 0, 0, 0.0, 0.0
    for j in range(len(ranges)):
        mask[j], error[j] = MISSING, np.nan
        if not np.isfinite(ranges[j]):
            continue
        mask[j] = EXPLAINED
        in_sight = np.isfinite(predicted[j])
        if in_sight:
            error[j] = ranges[j] - predicted[j]
            e = float(error[j])
            known += 1
            square += e * e
            bounded += min(e * e, _LARGEST_ERROR**2)
        # of a beam that reaches its wall no more is asked: mostly they are few
        if not predicted[j] - ranges[j] > np.float32(THRESHOLD):
            continue
        r = float(ranges[j])
        x, y = r * np.cos(bearings[j]), r * np.sin(bearings[j])
        at_x, at_y = _moved(pose, x, y)
        if (in_sight or _cell_at(ground, at_x, at_y) == FREE) and _off_walls(walls, at_x, at_y) > THRESHOLD:
            mask[j] = OBSTACLE
            in_sensor[count, 0], in_sensor[count, 1] = x, y
            in_map[count, 0], in_map[count, 1] = at_x, at_y
            count += 1
    if not known:
        return count, np.nan, np.inf
    return count, square / known, bounded / known


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _moved(pose: Array, x: float, y: float) -> tuple[float, float]:
    """A point given in the frame of `pose` (3,), in the frame that `pose` is given in."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return cos * x - sin * y + pose[0], sin * x + cos * y + pose[1]


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _cell_at(ground: tuple[NDArray[np.uint8], float, Array], x: float, y: float) -> int:
    """The map's cell at a point of the map frame; UNKNOWN outside."""
    cells, resolution, map_in_grid = ground
    u, v = _moved(map_in_grid, x, y)
    column, row = np.floor(u / resolution), np.floor(v / resolution)
    if not (0 <= column < cells.shape[1] and 0 <= row < cells.shape[0]):
        return UNKNOWN
    return int(cells[int(row), int(column)])


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _off_walls(walls: tuple[NDArray[np.uint32], float, Array], x: float, y: float) -> float:
    """Distance of a point of the map frame from the nearest wall, m."""
    cells, cell, map_in_field = walls
    u, v = _moved(map_in_field, x, y)
    # one cell of border lies around the grid
    return float(distance_near(cells, cell, u / cell + 1.0, v / cell + 1.0))
