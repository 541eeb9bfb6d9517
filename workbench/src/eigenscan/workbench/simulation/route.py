"""Ways through free space that keep clear of walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.gridmap import FREE, GridMap, MapError
from eigenscan.geometry.pose import Array
from numpy.typing import NDArray

STEP = 0.1
"""m, cells of the planning grid."""

COMFORT = 0.5
"""m, distance from walls below which a way gets noticeably dearer."""


@dataclass(frozen=True)
class Planner:
    """Cost of each planning cell (H, W); below zero for cells that the robot cannot reach."""

    grid: GridMap
    cost: Array
    clearance: Array
    step: float

    def cell(self, point: Array) -> tuple[int, int]:
        """(row, column) of the reachable cell nearest to a map-frame point (2,)."""
        rows, columns = np.nonzero(self.cost > 0)
        scale = self.step / self.grid.resolution
        column, row = self.grid.to_grid(point) / scale - 0.5
        nearest = int(np.argmin((rows - row) ** 2 + (columns - column) ** 2))
        return int(rows[nearest]), int(columns[nearest])

    def points(self, cells: NDArray[np.int64]) -> Array:
        """Centres of cells (n, 2) of row and column, as map-frame points (n, 2)."""
        scale = self.step / self.grid.resolution
        return self.grid.to_map((cells[:, ::-1] + 0.5) * scale)

    def draw_goal(self, random: np.random.Generator, away_from: Array, at_least: float) -> Array:
        """A roomy point (2,), map frame, `at_least` m from `away_from` (2,), or the farthest there is."""
        reachable = self.cost > 0
        roomy = reachable & (self.clearance > min(COMFORT, 0.8 * float(self.clearance[reachable].max())))
        goals = self.points(np.argwhere(roomy))
        distance = np.hypot(*(goals - away_from).T)
        far = goals[distance >= min(at_least, 0.9 * float(distance.max()))]
        drawn: Array = far[random.integers(len(far))]
        return drawn

    def way(self, start: Array, goal: Array) -> Array:
        """Points (n, 2), about 5 cm apart, from `start` to near `goal`."""
        from skimage.graph import MCP_Geometric

        ways = MCP_Geometric(self.cost)
        ways.find_costs([self.cell(start)], [self.cell(goal)])
        cells = np.array(ways.traceback(self.cell(goal)), dtype=np.int64)
        return _even(_smooth(np.concatenate([[start], self.points(cells[1:])])))


def plan(grid: GridMap, radius: float) -> Planner:
    """Planner for a robot of `radius` m on the largest connected free space of `grid`.

    Raises MapError if the robot fits nowhere.
    """
    from scipy.ndimage import distance_transform_edt, label

    factor = max(1, round(STEP / grid.resolution))
    # outside the map is no free space either
    inside = distance_transform_edt(np.pad(grid.cells == FREE, 1))[1:-1, 1:-1] * grid.resolution
    height, width = (size // factor * factor for size in inside.shape)
    blocks = inside[:height, :width].reshape(height // factor, factor, width // factor, factor)
    clearance = blocks.min(axis=(1, 3))
    parts, count = label(clearance > radius)
    if not count:
        raise MapError(f"a robot of {radius} m radius fits nowhere in the map's free space")
    largest = 1 + int(np.argmax(np.bincount(parts.ravel())[1:]))
    fits = parts == largest
    cost = np.full(clearance.shape, -1.0)
    cost[fits] = 1.0 + (COMFORT / clearance[fits]) ** 2
    return Planner(grid, cost, clearance, factor * grid.resolution)


def _smooth(points: Array, window: int = 5) -> Array:
    """Moving average with both ends kept."""
    if len(points) < 3:
        return points
    padded = np.concatenate(
        [np.repeat(points[:1], window // 2, axis=0), points, np.repeat(points[-1:], window // 2, axis=0)]
    )
    kernel = np.full(window, 1.0 / window)
    smoothed = np.stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in (0, 1)], axis=1)
    smoothed[0], smoothed[-1] = points[0], points[-1]
    return smoothed


def _even(points: Array, spacing: float = 0.05) -> Array:
    """The same line with points at even distances."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.linspace(0.0, along[-1], max(2, int(along[-1] / spacing) + 1))
    return np.stack([np.interp(at, along, points[:, axis]) for axis in (0, 1)], axis=1)
