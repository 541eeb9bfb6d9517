"""Boxes that stand about in the building and not in its map: deliveries, moved furniture."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap, MapError
from scipy.ndimage import distance_transform_edt

SIZES = (0.4, 1.2)
"""m, of a side, least and greatest."""
AISLE = 0.8
"""m that a box leaves free around it, so that every place can still be reached."""


def put_boxes(grid: GridMap, count: int, random: np.random.Generator) -> GridMap:
    """The map with `count` boxes more. Raises MapError where so many do not fit."""
    cells = grid.cells.copy()
    for number in range(count):
        half = random.uniform(*SIZES, size=2) / 2
        clear = distance_transform_edt(cells == FREE) * grid.resolution
        places = np.argwhere(clear > float(np.hypot(*half)) + AISLE)
        if not len(places):
            raise MapError(f"{number} boxes fit into the map's free space, not {count}: ask for fewer")
        row, column = places[random.integers(len(places))]
        rows, columns = np.maximum(1, np.round(half / grid.resolution)).astype(np.int64)
        cells[row - rows : row + rows + 1, column - columns : column + columns + 1] = OCCUPIED
    return GridMap(cells, grid.resolution, grid.origin)
