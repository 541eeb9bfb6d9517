"""A room, and what a lidar sees in it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

MOUNT = (0.2, 0.05, 0.1)
WALLS = np.array(
    [
        *((-3.0, -2.0, 5.0, -2.0), (5.0, -2.0, 5.0, 2.5), (5.0, 2.5, 1.0, 2.5), (1.0, 2.5, 1.0, 3.5)),
        *((1.0, 3.5, -3.0, 3.5), (-3.0, 3.5, -3.0, -2.0), (2.0, -0.5, 3.0, -0.5), (3.0, -0.5, 3.0, 0.5)),
    ]
)
"""x, y to x, y [m]: a room with a niche and a table."""


def seen(bases: Array, bearings: Array, mount: tuple[float, float, float] = MOUNT) -> Array:
    """Ranges (B,) of beams, each from its own base pose (B, 3), by rays against WALLS."""
    cos, sin = np.cos(bases[:, 2]), np.sin(bases[:, 2])
    x, y = bases[:, 0] + cos * mount[0] - sin * mount[1], bases[:, 1] + sin * mount[0] + cos * mount[1]
    angles = bases[:, 2] + mount[2] + bearings
    along_x, along_y = np.cos(angles)[:, None], np.sin(angles)[:, None]
    start_x, start_y = WALLS[:, 0] - x[:, None], WALLS[:, 1] - y[:, None]
    wall_x, wall_y = WALLS[:, 2] - WALLS[:, 0], WALLS[:, 3] - WALLS[:, 1]
    across = along_x * wall_y - along_y * wall_x
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (start_x * wall_y - start_y * wall_x) / across
        part = (start_x * along_y - start_y * along_x) / across
    hit = (reach > 0.0) & (part >= 0.0) & (part <= 1.0)
    result: Array = np.where(hit, reach, np.inf).min(axis=1)
    return result
