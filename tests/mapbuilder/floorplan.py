"""Floor plans to build from; lengths in m."""

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap


def blank(width, height, resolution=0.05, origin=(0.0, 0.0, 0.0)):
    """Unknown everywhere; lengths in m."""
    cells = np.full((round(height / resolution), round(width / resolution)), UNKNOWN, dtype=np.uint8)
    return GridMap(cells, resolution, np.array(origin))


def box(grid, left, bottom, right, top, value):
    """Sets the cells of a rectangle, m in the grid's own axes."""
    scale = 1 / grid.resolution
    rows = slice(round(bottom * scale), round(top * scale))
    grid.cells[rows, round(left * scale) : round(right * scale)] = value


def room(grid, left, bottom, right, top):
    """A rectangle of free space inside walls of one cell."""
    wall = grid.resolution
    box(grid, left - wall, bottom - wall, right + wall, top + wall, OCCUPIED)
    box(grid, left, bottom, right, top, FREE)
