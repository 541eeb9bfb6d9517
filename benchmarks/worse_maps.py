"""Ways in which maps are wrong, on purpose and seeded: a map made worse, and where its poses went.

A pose of the reference is moved as the map around it was: what is judged is whether the robot is found in
the map that it has. Lengths in m.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Move = Callable[[Array], Array]
"""Poses (n, 3) of the true map to those of the worse one."""

CORRELATED_M = 7.0
"""Length over which a warp keeps its direction."""
TILE_M = 1.0
"""Walls are missing in squares of this width."""
PART_M = 30.0
"""Every other so much of the way is missing."""


@dataclass(frozen=True)
class Worse:
    """A map, and its poses."""

    grid: GridMap
    move: Move


Way = Callable[[Worse, Array, int], Worse]
"""Makes a map worse, given the true path (n, 3) and a seed."""


def stays(poses: Array) -> Array:
    """The same poses."""
    return poses


def with_cells(worse: Worse, cells: NDArray[np.uint8]) -> Worse:
    """The same map with other cells."""
    return Worse(GridMap(cells, worse.grid.resolution, worse.grid.origin), worse.move)


def exact(worse: Worse, _path: Array, _seed: int) -> Worse:
    """As it is."""
    return worse


def fatter(by: float) -> Way:
    """Walls fatter by so much on each side."""

    def make(worse: Worse, _path: Array, _seed: int) -> Worse:
        reach = int(np.ceil(by / worse.grid.resolution)) + 1
        grid = padded(worse.grid, reach)
        far = distance_transform_edt(grid.cells != OCCUPIED) * grid.resolution
        cells = np.where(far <= by + 1e-6, np.uint8(OCCUPIED), grid.cells)
        return Worse(GridMap(cells, grid.resolution, grid.origin), worse.move)

    return make


def thinner(worse: Worse, _path: Array, _seed: int) -> Worse:
    """Walls thinned to the line in their middle."""
    from skimage.morphology import skeletonize

    wall = worse.grid.cells == OCCUPIED
    gone = wall & ~skeletonize(wall)
    cells = worse.grid.cells.copy()
    # what was wall becomes what is nearest to it
    _, (row, column) = distance_transform_edt(wall, return_indices=True)
    cells[gone] = worse.grid.cells[row[gone], column[gone]]
    return with_cells(worse, cells)


def coarser(cell: float) -> Way:
    """Cells of this width: wall where any of it was, else free where any was."""

    def make(worse: Worse, _path: Array, _seed: int) -> Worse:
        grid = worse.grid
        height, width = np.ceil(np.array(grid.cells.shape) * grid.resolution / cell).astype(int)
        rows, columns = np.indices(grid.cells.shape)
        target = (
            np.minimum(((rows + 0.5) * grid.resolution / cell).astype(int), height - 1),
            np.minimum(((columns + 0.5) * grid.resolution / cell).astype(int), width - 1),
        )
        wall, free = np.zeros((height, width), bool), np.zeros((height, width), bool)
        np.logical_or.at(wall, target, grid.cells == OCCUPIED)
        np.logical_or.at(free, target, grid.cells == FREE)
        cells = np.where(wall, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.uint8)
        return Worse(GridMap(cells, cell, grid.origin), worse.move)

    return make


def warped(sigma: float, length: float = CORRELATED_M) -> Way:
    """Displaced smoothly, by `sigma` along each axis (standard deviation), over `length`."""

    def make(worse: Worse, _path: Array, seed: int) -> Worse:
        before = worse.grid
        grid = padded(before, int(np.ceil(4.0 * sigma / before.resolution)))
        rng = np.random.default_rng(seed)
        shape, step = grid.cells.shape, 0.5
        coarse = [int(np.ceil(size * grid.resolution / step)) + 2 for size in shape]
        fields = []
        for _ in range(2):
            noise = gaussian_filter(rng.normal(size=coarse), length / step / 2.0, mode="wrap")
            fields.append(noise / noise.std() * sigma)

        def displacement(points: Array) -> Array:
            at = grid.to_grid(points)[..., ::-1] * grid.resolution / step
            return np.stack([map_coordinates(f, at.T, order=1, mode="nearest") for f in fields], axis=-1)

        wall, free = np.zeros(shape, bool), np.zeros(shape, bool)
        rows, columns = np.indices(shape)
        for sub_row, sub_column in ((0.25, 0.25), (0.25, 0.75), (0.75, 0.25), (0.75, 0.75)):
            there = np.column_stack([columns.ravel() + sub_column, rows.ravel() + sub_row])
            target = grid.to_map(there)
            source = target.copy()
            for _ in range(4):
                source = target - displacement(source)
            value = grid.at(source).reshape(shape)
            wall |= value == OCCUPIED
            free |= value == FREE
        cells = np.where(wall, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.uint8)

        def move(poses: Array) -> Array:
            poses = worse.move(poses)
            ahead = poses[:, :2] + 0.5 * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
            start, end = poses[:, :2] + displacement(poses[:, :2]), ahead + displacement(ahead)
            way = end - start
            return np.column_stack([start, np.arctan2(way[:, 1], way[:, 0])])

        return Worse(GridMap(cells, grid.resolution, grid.origin), move)

    return make


def scaled(share: float) -> Way:
    """Larger by this share."""

    def make(worse: Worse, _path: Array, _seed: int) -> Worse:
        grid, size = worse.grid, np.array([1.0 + share, 1.0 + share, 1.0])
        larger = GridMap(grid.cells, grid.resolution * (1.0 + share), grid.origin * size)
        return Worse(larger, lambda poses: worse.move(poses) * size)

    return make


def missing(share: float) -> Way:
    """This share of the walls is not there, by squares of TILE_M."""

    def make(worse: Worse, _path: Array, seed: int) -> Worse:
        grid, rng = worse.grid, np.random.default_rng(seed)
        rows, columns = np.indices(grid.cells.shape) * grid.resolution // TILE_M
        gone = rng.random((int(rows.max()) + 1, int(columns.max()) + 1)) < share
        cells = grid.cells.copy()
        cells[(cells == OCCUPIED) & gone[rows.astype(int), columns.astype(int)]] = FREE
        return with_cells(worse, cells)

    return make


def half(worse: Worse, path: Array, _seed: int) -> Worse:
    """Every other PART_M of the way was never mapped."""
    grid = worse.grid
    there = worse.move(path)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(there[:, :2], axis=0).T))])
    rows, columns = np.indices(grid.cells.shape)
    cells = grid.to_map(np.column_stack([columns.ravel() + 0.5, rows.ravel() + 0.5]))
    # where several parts of the way pass, the first counts
    parts = (way // PART_M).astype(int)
    every = np.unique(np.rint(there[:, :2] * 4.0), axis=0, return_index=True)[1]
    nearest = cKDTree(there[every, :2]).query(cells)[1]
    unseen = (parts[every][nearest] % 2 == 1).reshape(grid.cells.shape)
    return with_cells(worse, np.where(unseen, np.uint8(UNKNOWN), grid.cells))


def smeared(sigma: float, times: int = 4) -> Way:
    """Drawn so many times, each time displaced by `sigma` again: a robot that was not sure of its way."""

    def make(worse: Worse, path: Array, seed: int) -> Worse:
        drawn = [warped(sigma)(worse, path, seed + number).grid.cells for number in range(times)]
        wall, free = (np.any([cells == value for cells in drawn], axis=0) for value in (OCCUPIED, FREE))
        cells = np.where(wall, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.uint8)
        grid = padded(worse.grid, int(np.ceil(4.0 * sigma / worse.grid.resolution)))
        return Worse(GridMap(cells, grid.resolution, grid.origin), worse.move)

    return make


def chain(*ways: Way) -> Way:
    """One after the other."""

    def make(worse: Worse, path: Array, seed: int) -> Worse:
        for number, way in enumerate(ways):
            worse = way(worse, path, seed + number)
        return worse

    return make


def padded(grid: GridMap, by: int) -> GridMap:
    """With so many UNKNOWN cells around."""
    cells = np.pad(grid.cells, by, constant_values=UNKNOWN)
    origin = grid.origin.copy()
    origin[:2] = grid.to_map(np.array([-float(by), -float(by)]))
    return GridMap(cells, grid.resolution, origin)


WAYS: dict[str, Way] = {
    "exact": exact,
    "walls 5 cm fatter": fatter(0.05),
    "walls 10 cm fatter": fatter(0.10),
    "walls 20 cm fatter": fatter(0.20),
    "walls 30 cm fatter": fatter(0.30),
    "walls thinner": thinner,
    "cells of 10 cm": coarser(0.10),
    "cells of 20 cm": coarser(0.20),
    "warped 10 cm": warped(0.10),
    "warped 20 cm": warped(0.20),
    "warped 40 cm": warped(0.40),
    "smeared 10 cm": smeared(0.10),
    "smeared 15 cm, cells of 10 cm": chain(smeared(0.15), coarser(0.10)),
    "1 % larger": scaled(0.01),
    "2 % larger": scaled(0.02),
    "10 % of the walls missing": missing(0.10),
    "30 % of the walls missing": missing(0.30),
    "50 % of the walls missing": missing(0.50),
    "every other 30 m missing": half,
    "warped 15 cm, 15 % of the walls missing": chain(warped(0.15), missing(0.15)),
    # like maps that somebody else made long ago: walls 0.47 m thick, the surface in their middle
    "thick, coarse, warped": chain(warped(0.12), fatter(0.18), coarser(0.10)),
}
"""By name; the last is several at once."""
