"""Ranges to the walls of a map: single rays, and panoramas of many positions at once.

A ray runs from cell to cell as in exact grid traversal (Amanatides and Woo 1987). It ends at the face of the
first OCCUPIED cell. It ends without a wall (+inf) at `range_max`, at the map's edge, and in the dark:
UNKNOWN farther than DARK_CELLS cells from anything known. So specks of UNKNOWN are looked
through, while a ray that leaks out of the mapped space knows nothing of what is there.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.distance_tiles import distance_tiles
from eigenscan.geometry.gridmap import OCCUPIED, UNKNOWN, GridMap
from eigenscan.geometry.sweep import sweep, transpose, visits
from eigenscan.geometry.trace import DARK, LEAPS_PER_CELL, OVER, WALL, facing
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation

DARK_CELLS = 2.0
"""Depth in UNKNOWN, in cells from anything known, beyond which nothing is known."""

SWEPT = 20.0
"""m around the positions in which walls are swept; a ray that leaves that part of the map is traced on."""

_NO_WALL = np.float32(np.inf)


@dataclass(frozen=True)
class RayCaster:
    """A map made ready for casting.

    `leap` (H + 2, W + 2) uint8, one cell of DARK around the map: how far any ray can go from anywhere in
    the cell without meeting WALL or DARK, in quarters of a cell, rounded down.
    """

    leap: NDArray[np.uint8]
    grid: GridMap

    @classmethod
    def of(cls, grid: GridMap) -> RayCaster:
        """Caster for `grid`; keep it if you cast against a map more than once."""
        wall = np.pad(grid.cells == OCCUPIED, 1)
        unknown = np.pad(grid.cells == UNKNOWN, 1, constant_values=True)
        dark = np.zeros_like(unknown)
        for part, distance in distance_tiles(unknown, DARK_CELLS):
            dark[part] = distance > DARK_CELLS
        dark[[0, -1], :] = dark[:, [0, -1]] = True
        # distance of cell centres to the walls grown by one cell = distance between the cells' outlines
        free = ~binary_dilation(wall | dark, np.ones((3, 3), dtype=bool))
        leap = np.empty(wall.shape, dtype=np.uint8)
        for part, distance in distance_tiles(free, DARK / LEAPS_PER_CELL):
            leap[part] = np.minimum(np.floor(distance * LEAPS_PER_CELL), DARK - 1)
        leap[wall] = WALL
        leap[dark] = DARK
        return cls(leap, grid)

    def to_cells(self, points: ArrayLike) -> NDArray[np.float64]:
        """Map-frame points (..., 2), m, as continuous (column, row) of `leap`."""
        array, grid = np.asarray(points, dtype=np.float64), self.grid
        cells = in_cells(grid.map_in_grid, grid.resolution, np.ascontiguousarray(array.reshape(-1, 2)))
        found: NDArray[np.float64] = cells.reshape(array.shape)
        return found

    def in_dark(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Which map-frame points (n, 2) lie off the map or deep in UNKNOWN, where rays show nothing."""
        dark: NDArray[np.bool_] = stop_at(self.leap, self.to_cells(points)) == DARK
        return dark

    def cast(self, poses: ArrayLike, bearings: ArrayLike, range_max: ArrayLike) -> NDArray[np.float32]:
        """Ranges (P, B), m, from poses (P, 3) along theta + bearings (B,); +inf where no wall is in sight.

        Rays end at `range_max`, one for all or (B,). A pose in a wall gives 0, one that is not finite NaN.
        """
        pose = np.atleast_2d(np.asarray(poses, dtype=np.float64))
        angles = np.atleast_1d(np.asarray(bearings, dtype=np.float64))
        starts = np.empty(pose.shape)
        starts[:, :2] = self.to_cells(pose[:, :2])
        starts[:, 2] = pose[:, 2] - self.grid.origin[2]
        resolution = self.grid.resolution
        limits = np.empty(angles.shape)
        limits[:] = np.asarray(range_max, dtype=np.float64) / resolution
        out: NDArray[np.float32] = cast_rays(self.leap, starts, angles, limits, resolution)
        return out

    def panoramas(
        self, positions: ArrayLike, beams: int, range_max: float, threads: int = 1
    ) -> NDArray[np.float32]:
        """Ranges (P, N), m, from positions (P, 2) along world directions k 2 pi / N; +inf: no wall in sight.

        The same as `cast`, but all positions are swept together, direction by direction, which is several
        times faster. Threads share the directions and do not change the result.
        """
        points = self.to_cells(np.asarray(positions, dtype=np.float64).reshape(-1, 2))
        if beams < 1:
            raise ValueError(f"a panorama of {beams} beams")
        if not np.isfinite(points).all():
            raise ValueError("panoramas: a position is not finite")
        if not len(points):
            return np.empty((0, beams), dtype=np.float32)
        limit, unit = range_max / self.grid.resolution, self.grid.resolution
        near = min(limit, SWEPT / unit)
        wall, dark, corner = self._within(points, near)
        seen = visits(wall, dark, points, corner)
        angles = np.arange(beams) * (2.0 * np.pi / beams) - self.grid.origin[2]
        by_direction = np.empty((beams, len(points)), dtype=np.float32)

        def work(block: NDArray[np.int64]) -> None:
            sweep(seen, self.leap, angles, block, (near, limit), unit, by_direction)

        blocks = [block for block in np.array_split(np.arange(beams), 4 * max(threads, 1)) if len(block)]
        if threads > 1:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(work, blocks))
        else:
            for block in blocks:
                work(block)
        ranges: NDArray[np.float32] = transpose(by_direction)
        start = stop_at(self.leap, points)
        ranges[start == WALL] = 0.0
        ranges[start == DARK] = _NO_WALL
        return ranges

    def _within(
        self, points: NDArray[np.float64], reach: float
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.int64]]:
        """Walls and dark cells that a ray of `reach` cells can meet, and (column, row) of their corner."""
        height, width = self.leap.shape
        low, high = points.min(axis=0) - reach - 1, points.max(axis=0) + reach + 1
        c0, r0 = np.clip(np.floor(low), 0, (width, height)).astype(np.int64)
        c1, r1 = np.clip(np.ceil(high), 0, (width, height)).astype(np.int64)
        near = self.leap[r0:r1, c0:c1]
        return near == WALL, near == DARK, np.array([c0, r0])


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def in_cells(
    map_in_grid: NDArray[np.float64], resolution: float, points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """For compiled code: map-frame points (P, 2) as continuous (column, row) of `leap`."""
    cos, sin = np.cos(map_in_grid[2]), np.sin(map_in_grid[2])
    out = np.empty(points.shape)
    for p in range(len(points)):
        x, y = points[p]
        out[p, 0] = (cos * x - sin * y + map_in_grid[0]) / resolution + 1.0
        out[p, 1] = (sin * x + cos * y + map_in_grid[1]) / resolution + 1.0
    return out


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def cast_rays(
    leap: NDArray[np.uint8],
    starts: NDArray[np.float64],
    bearings: NDArray[np.float64],
    limits: NDArray[np.float64],
    resolution: float,
) -> NDArray[np.float32]:
    """For compiled code: `cast` from continuous (column, row) and heading (P, 3), `limits` (B,) in cells."""
    height, width = leap.shape
    flat, columns = leap.reshape(-1), np.int64(width)
    right, top = float(width), float(height)
    cos, sin = np.cos(bearings), np.sin(bearings)
    dx, dy, travelled = np.empty(len(bearings)), np.empty(len(bearings)), np.empty(len(bearings))
    # of `onward` for each ray: where in a cell it meets the next face, and 1 / dx and 1 / dy
    face_x, face_y, per_x, per_y = np.empty((4, len(bearings)))
    under_way = np.empty(len(bearings), dtype=np.uint32)
    out = np.empty((len(starts), len(bearings)), dtype=np.float32)
    for p in range(len(starts)):
        x, y, theta = starts[p]
        if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(theta)):
            out[p] = np.nan
            continue
        ahead, aside = np.cos(theta), np.sin(theta)
        # the first leap is the same for all rays
        inside = 0.0 <= x < width and 0.0 <= y < height
        free = leap[int(y), int(x)] if inside else DARK
        first = free / LEAPS_PER_CELL if free < DARK else 0.0
        for b in range(len(bearings)):
            dx[b], dy[b] = ahead * cos[b] - aside * sin[b], aside * cos[b] + ahead * sin[b]
            face_x[b], per_x[b] = facing(dx[b])
            face_y[b], per_y[b] = facing(dy[b])
            travelled[b], under_way[b] = first, b
        # all rays a step, and again: the processor works at several at once. Without branches, which would be
        # guessed wrong at each ray's end
        count = len(bearings)
        while count > 0:
            going = 0
            for k in range(count):
                b = under_way[k]
                way = travelled[b]
                at_x, at_y = x + dx[b] * way, y + dy[b] * way
                here = (way <= limits[b]) & (at_x >= 0.0) & (at_x < right) & (at_y >= 0.0) & (at_y < top)
                column, row = np.int64(at_x), np.int64(at_y)
                free = flat[np.uint64(row * columns + column if here else 0)] if here else DARK
                out[p, b] = way * resolution if free == WALL else np.inf
                under_way[going] = b
                going += int(free < DARK)
                edge = min((column + face_x[b] - at_x) * per_x[b], (row + face_y[b] - at_y) * per_y[b]) + OVER
                travelled[b] = way + (free / LEAPS_PER_CELL if free > 0 else edge)
            count = going
    return out


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def stop_at(leap: NDArray[np.uint8], points: NDArray[np.float64]) -> NDArray[np.uint8]:
    """For compiled code: value of `leap` at continuous (column, row) (P, 2); DARK outside."""
    height, width = leap.shape
    values = np.full(len(points), DARK)
    for p in range(len(points)):
        x, y = points[p]
        if 0.0 <= x < width and 0.0 <= y < height:
            values[p] = leap[int(y), int(x)]
    return values
