"""One ray, from cell to cell, over free space in leaps."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

WALL, DARK = np.uint8(255), np.uint8(254)
"""Values of `leap` at which a ray ends: at a wall, and in unknown space."""
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
    while travelled <= limit:
        at_x, at_y = x + dx * travelled, y + dy * travelled
        if not (0.0 <= at_x < width and 0.0 <= at_y < height):
            return np.inf
        free = leap[int(at_y), int(at_x)]
        if free >= DARK:
            return travelled if free == WALL else np.inf
        travelled += onward(free, at_x, at_y, dx, dy)
    return np.inf


@njit(cache=True, nogil=True, inline="always")  # pragma: no cover - compiled
def onward(free: np.uint8, at_x: float, at_y: float, dx: float, dy: float) -> float:
    """Cells that a ray can go on along (dx, dy) where `leap` is `free`: one leap, or over the cell's edge."""
    if free > 0:
        return free / LEAPS_PER_CELL
    ahead_x, ahead_y = 1.0 if dx > 0.0 else 0.0, 1.0 if dy > 0.0 else 0.0
    to_x = (int(at_x) + ahead_x - at_x) * (1.0 / dx) if abs(dx) > _PARALLEL else np.inf
    to_y = (int(at_y) + ahead_y - at_y) * (1.0 / dy) if abs(dy) > _PARALLEL else np.inf
    return min(to_x, to_y) + _OVER
