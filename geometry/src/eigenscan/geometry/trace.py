"""One ray, from cell to cell, over free space in leaps."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

WALL, DARK = np.uint8(255), np.uint8(254)
"""Values of `leap` where a ray ends: at a wall, and where nothing is known."""
LEAPS_PER_CELL = 4.0
_PARALLEL = 1e-12
_OVER = 1e-6
"""Cells by which a step goes over a cell's edge."""


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def trace(
    leap: NDArray[np.uint8],
    x: float,
    y: float,
    dx: float,
    dy: float,
    limit: float,
    travelled: float,
) -> float:
    """Cells that a ray travels from continuous (column, row) along (dx, dy), a unit vector; inf: no wall.

    `leap` (H, W): WALL, DARK, or how far any ray can go from anywhere in the cell without meeting one of
    them, in 1 / LEAPS_PER_CELL cells. The ray is known to be free for the first `travelled` cells.
    """
    height, width = leap.shape
    along_x, along_y = abs(dx) > _PARALLEL, abs(dy) > _PARALLEL
    inverse_x, inverse_y = 1.0 / dx if along_x else np.inf, 1.0 / dy if along_y else np.inf
    ahead_x, ahead_y = 1.0 if dx > 0.0 else 0.0, 1.0 if dy > 0.0 else 0.0
    while travelled <= limit:
        at_x, at_y = x + dx * travelled, y + dy * travelled
        if not (0.0 <= at_x < width and 0.0 <= at_y < height):
            return np.inf
        column, row = int(at_x), int(at_y)
        free = leap[row, column]
        if free >= DARK:
            return travelled if free == WALL else np.inf
        if free > 0:
            travelled += free / LEAPS_PER_CELL
        else:
            to_x = (column + ahead_x - at_x) * inverse_x if along_x else np.inf
            to_y = (row + ahead_y - at_y) * inverse_y if along_y else np.inf
            travelled += min(to_x, to_y) + _OVER
    return np.inf
