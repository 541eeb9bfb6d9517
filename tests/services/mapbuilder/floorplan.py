"""Floor plans to build from; lengths in m."""

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap


def blank(
    width: float,
    height: float,
    resolution: float = 0.05,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> GridMap:
    """Unknown everywhere; lengths in m."""
    cells = np.full((round(height / resolution), round(width / resolution)), UNKNOWN, dtype=np.uint8)
    return GridMap(cells, resolution, np.array(origin))


def box(grid: GridMap, left: float, bottom: float, right: float, top: float, value: int) -> None:
    """Sets the cells of a rectangle, m in the grid's own axes."""
    scale = 1 / grid.resolution
    rows = slice(round(bottom * scale), round(top * scale))
    grid.cells[rows, round(left * scale) : round(right * scale)] = value


def room(grid: GridMap, left: float, bottom: float, right: float, top: float) -> None:
    """A rectangle of free space inside walls of one cell."""
    wall = grid.resolution
    box(grid, left - wall, bottom - wall, right + wall, top + wall, OCCUPIED)
    box(grid, left, bottom, right, top, FREE)


def two_rooms() -> GridMap:
    """Two rooms of 5 m x 4 m above a hallway of 12 m x 2 m, a door of 0.9 m into each."""
    grid = blank(14.0, 9.0)
    room(grid, 1.0, 1.0, 13.0, 3.0)
    room(grid, 1.5, 3.2, 6.5, 7.2)
    room(grid, 7.0, 3.2, 12.0, 7.2)
    for left in (3.0, 9.0):
        box(grid, left, 2.9, left + 0.9, 3.3, FREE)
        for side in (left - 0.05, left + 0.9):
            box(grid, side, 3.0, side + 0.05, 3.2, OCCUPIED)
    return grid
