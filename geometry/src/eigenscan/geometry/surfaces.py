"""Estimates the surfaces in a map's walls that a lidar meets: the walls' middles.

Walls that a robot mapped with an uncertain pose, or in coarse cells, are thicker than the building's. The
surface lies anywhere in them; the middle has the least error. In a map with thin walls nothing changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.distance_tiles import TILE, box_of, distance_tiles
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt, maximum_filter

POINT_SIGMA = 0.05
"""m, error of a beam's end point about the wall of an exact map."""
DEEPEST_M = 1.0
"""Depth in a wall, m, beyond which it counts as equally deep: thicker objects are no walls."""
THICKEST_M = 0.8
"""Thicker ones, m, such as racks that a plan draws filled, or all ground outside, show nothing of how thick
an ordinary wall is drawn (benchmarks/maps.py --simulated --only "racks of 1.1 m, 360°" --way exact)."""
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Surfaces:
    """A map's walls, thinned to their estimated surfaces.

    `grid` is the map itself if all walls are thin. Walls up to `thickness`, m, are thinned to the line in
    their middle, thicker ones (a cupboard, a pillar) by half of it on each side. `thickness` is that of an
    ordinary wall: half of the cells that face free ground belong to walls at least as thick, without those of
    objects thicker than THICKEST_M.
    """

    grid: GridMap
    thickness: float
    thinned: bool = False

    @property
    def inexactness(self) -> float:
        """How far, m, a surface anywhere in an ordinary wall is from its middle: standard deviation.

        0 where walls are thin: then it is part of any lidar's error.
        """
        return self.thickness / 12.0**0.5 if self.thinned else 0.0

    @classmethod
    def of(cls, grid: GridMap, thickness: float = 0.0) -> Surfaces:
        """Surfaces of a map; `thickness` 0: as it is found in the map."""
        wall = grid.cells == OCCUPIED
        if not wall.any():
            return cls(grid, thickness or grid.resolution)
        box = box_of(wall, 1, TILE)  # beyond, nothing changes
        wall, part = wall[box], GridMap(grid.cells[box], grid.resolution, grid.origin)
        depth = _depth(wall, DEEPEST_M / grid.resolution)
        middle = wall & (depth >= maximum_filter(depth, 3) - _ROUNDING)
        cells = 0.5 * thickness / grid.resolution if thickness else _ordinary_depth(part, depth, middle)
        gone = wall & ~middle & (depth < cells - _ROUNDING)
        found = 2.0 * cells * grid.resolution
        if not gone.any():
            return cls(grid, found)
        cells_of_all = grid.cells.copy()
        thinned = cells_of_all[box]
        thinned[gone] = UNKNOWN
        # only ground reached without crossing the middle is free
        reached = binary_dilation(
            thinned == FREE, np.ones((3, 3), dtype=bool), int(np.ceil(cells)) + 1, mask=gone
        )
        thinned[reached & gone] = FREE
        return cls(GridMap(cells_of_all, grid.resolution, grid.origin), found, thinned=True)


def faces_of(grid: GridMap) -> GridMap:
    """The map with only those wall cells that have a neighbour, in any of eight directions, without a wall.

    The others are UNKNOWN.
    """
    wall = grid.cells == OCCUPIED
    inside = wall & ~binary_dilation(~wall, np.ones((3, 3), dtype=bool), border_value=1)
    return GridMap(np.where(inside, np.uint8(UNKNOWN), grid.cells), grid.resolution, grid.origin)


def _depth(wall: NDArray[np.bool_], deepest: float) -> NDArray[np.float32]:
    """Depth (H, W), cells, of each wall cell's centre below the wall's outline; 0 elsewhere."""
    # there is no wall beyond the map's edge
    padded = np.pad(wall, 1)
    depth = np.zeros(padded.shape, dtype=np.float32)
    for part, distance in distance_tiles(padded, deepest):
        depth[part] = np.clip(distance - 0.5, 0.0, deepest)
    return depth[1:-1, 1:-1]


def _ordinary_depth(grid: GridMap, depth: NDArray[np.float32], middle: NDArray[np.bool_]) -> float:
    """Half the thickness, cells, that the median cell facing free ground has behind it."""
    faces = (grid.cells == OCCUPIED) & binary_dilation(grid.cells == FREE)
    height, width = depth.shape
    found = [np.empty(0, dtype=np.float32)]
    for top in range(0, height, TILE):
        for left in range(0, width, TILE):
            part = slice(top, top + TILE), slice(left, left + TILE)
            if faces[part].any() and middle[part].any():  # else there is no nearest one in this tile
                row, column = distance_transform_edt(
                    ~middle[part], return_distances=False, return_indices=True
                )
                found.append(depth[part][row, column][faces[part]])
    halves = np.concatenate(found)
    walls = halves[halves <= 0.5 * THICKEST_M / grid.resolution + _ROUNDING]
    return float(np.median(walls)) if len(walls) else 0.5
