"""One ray, from cell to cell, over free space in leaps."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

WALL, DARK = np.uint8(255), np.uint8(254)
"""Values of `leap` at which a ray ends: at a wall, and in unknown space."""
LEAPS_PER_CELL = 4.0
_PARALLEL = 1e-12
OVER = 1e-6
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
    (face_x, per_x), (face_y, per_y) = facing(dx), facing(dy)
    return min((int(at_x) + face_x - at_x) * per_x, (int(at_y) + face_y - at_y) * per_y) + OVER


@njit(cache=True, nogil=True, inline="always")  # pragma: no cover - compiled
def facing(d: float) -> tuple[float, float]:
    """Where in a cell, 0 or 1, a ray with the component `d` meets the next face, and 1 / d.

    One that runs along the faces meets them at infinity.
    """
    if abs(d) <= _PARALLEL:
        return 1.0, np.inf
    return 1.0 if d > 0.0 else 0.0, 1.0 / d
