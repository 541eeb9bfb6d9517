"""Ground that a robot can drive on, whichever of several places is the true one; and its ways there.

A square of cells around the robot, in its own frame: a cell is free if it is free from every place.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, ceil, hypot

import numpy as np
from eigenscan.geometry.raycast import in_cells
from eigenscan.geometry.trace import DARK
from eigenscan.projector.wall_field import cells_of, distance_near
from eigenscan.projector.weighing import Rays, Walls
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

CELL_M = 0.2
"""Side of a cell of the ground: a quarter of NEAR_M."""
STEP_M = 0.05
"""m, from one look to the next along a straight way: a cell of most maps."""
NEAR_M = 0.8
"""m around the robot in which it may be as near to a wall as it is: it can leave where it stands."""
DIAGONAL = 2.0**0.5
"""Way to the cell across a corner, in cells."""
BACK = 4
"""Cells before the end of a way by which its last heading is known."""


@dataclass(frozen=True)
class Move:
    """A turn, rad, and the straight way after it, m; `way`, m, is the whole of what is driven in the end."""

    heading: float
    distance: float
    way: float


@dataclass(frozen=True)
class Ground:
    """Cells (n, n) by x and y, in the robot's frame at the middle one.

    `length` (n, n): the shortest way, m, inf where there is none; `before` (n, n): the cell before on it, as
    an index of the flat array.
    """

    length: Array
    before: Index
    walls: Walls
    rays: Rays
    places: Array
    radius: float

    @classmethod
    def around(cls, places: Array, walls: Walls, rays: Rays, radius: float, reach: float) -> Ground:
        """Around base poses `places` (k, 3), map frame, for a robot of `radius`, m, as far as `reach`, m."""
        half = ceil(reach / CELL_M)
        axis = (np.arange(2 * half + 1) - half) * CELL_M
        points = np.empty((len(axis) ** 2, 2))
        points[:, 0], points[:, 1] = np.repeat(axis, len(axis)), np.tile(axis, len(axis))
        free = np.empty(len(points), dtype=np.bool_)
        find_free(walls, rays, places, points, radius, free)
        length, before = _ways(free.reshape(len(axis), len(axis)), half, reach)
        return cls(length, before, walls, rays, places, radius)

    def ends(self, least: float, stride: int) -> tuple[Index, Array]:
        """Cells (m,), the nearest first, at least `least`, m, away; and the robot's pose (m, 3) on arrival.

        Of every `stride` cells along and across one.
        """
        size = len(self.length)
        half = size // 2
        some = np.zeros(self.length.shape, dtype=bool)
        some[half % stride :: stride, half % stride :: stride] = True
        found = np.flatnonzero(some & np.isfinite(self.length) & (self.length >= least))
        found = found[np.argsort(self.length.ravel()[found], kind="stable")]
        earlier = found
        for _ in range(BACK):
            earlier = self.before.ravel()[earlier]
        to, since = self._at(found), self._at(earlier)
        return found, np.column_stack([to, np.arctan2(*(to - since).T[::-1])])

    def move(self, end: int) -> Move:
        """The first straight leg of the way to a cell, as far as it goes."""
        way = [end]
        middle = self.length.size // 2
        while way[-1] != middle:
            way.append(int(self.before.flat[way[-1]]))
        lengths = self.length.ravel()
        for cell in way:
            (x, y), rest = self._at(np.array([cell]))[0].tolist(), float(lengths[end] - lengths[cell])
            distance = hypot(x, y)
            if self._is_straight(x, y) or cell == way[-2]:
                break
        return Move(atan2(y, x), distance, distance + rest)

    def _at(self, cells: Index) -> Array:
        """Cells (n,) as points (n, 2), m, in the robot's frame."""
        size = len(self.length)
        return (np.column_stack(np.divmod(cells, size)) - size // 2) * CELL_M

    def _is_straight(self, x: float, y: float) -> bool:
        share = np.linspace(0.0, 1.0, ceil(hypot(x, y) / STEP_M) + 1)
        points = np.column_stack([x * share, y * share])
        free = np.empty(len(points), dtype=np.bool_)
        find_free(self.walls, self.rays, self.places, points, self.radius, free)
        return bool(free.all())


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def find_free(walls: Walls, rays: Rays, places: Array, points: Array, radius: float, free: Flags) -> None:
    """For compiled code: which points (n, 2) in the robot's frame are `free` (n,) from every place (k, 3).

    They are on known ground, and `radius`, m, off every wall.
    """
    cells, cell, map_in_field = walls
    leap, map_in_grid, resolution, _ = rays
    free[:] = True
    at = np.empty((1, 3))
    for k in range(len(places)):
        cos, sin = np.cos(places[k, 2]), np.sin(places[k, 2])
        at[0] = places[k]
        start = cells_of(map_in_field, cell, at)
        # as near to a wall as it stands, with a cell's tolerance
        near = min(radius, distance_near(cells, cell, start[0, 0], start[0, 1]) - cell)
        for i in range(len(points)):
            if not free[i]:
                continue
            x, y = points[i]
            at[0, 0] = places[k, 0] + cos * x - sin * y
            at[0, 1] = places[k, 1] + sin * x + cos * y
            here = cells_of(map_in_field, cell, at)
            least = near if x * x + y * y < NEAR_M * NEAR_M else radius
            ground = in_cells(map_in_grid, resolution, at[:, :2].copy())
            column, row = int(np.floor(ground[0, 0])), int(np.floor(ground[0, 1]))
            inside = 0 <= column < leap.shape[1] and 0 <= row < leap.shape[0]
            known = inside and leap[row, column] < DARK
            free[i] = known and distance_near(cells, cell, here[0, 0], here[0, 1]) >= least


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _ways(free: Flags, half: int, reach: float) -> tuple[Array, Index]:
    """Shortest ways from the middle over free cells (n, n), with diagonal steps, and the cells before."""
    size = len(free)
    length, before = np.full((size, size), np.inf), np.zeros((size, size), dtype=np.int64)
    length[half, half], before[half, half] = 0.0, half * size + half
    waiting, queued = np.empty(size * size + 1, dtype=np.int64), np.zeros((size, size), dtype=np.bool_)
    waiting[0], first, last = half * size + half, 0, 1
    # a cell waits again where a shorter way to it is found, until there is none
    while first != last:
        here = waiting[first]
        first = (first + 1) % len(waiting)
        row, column = here // size, here % size
        queued[row, column] = False
        for r in range(max(row - 1, 0), min(row + 2, size)):
            for c in range(max(column - 1, 0), min(column + 2, size)):
                corner = r != row and c != column
                if not free[r, c] or (corner and not (free[r, column] and free[row, c])):
                    continue
                way = length[row, column] + (DIAGONAL if corner else 1.0) * CELL_M
                if way < length[r, c] - 1e-9 and way <= reach:
                    length[r, c], before[r, c] = way, here
                    if not queued[r, c]:
                        queued[r, c] = True
                        waiting[last] = r * size + c
                        last = (last + 1) % len(waiting)
    return length, before
