"""Steps of the compiled search, one at a time."""

from __future__ import annotations

import numpy as np
from eigenscan.projector.intervals import find_clearance
from eigenscan.projector.likelihood import EXACT, find_support, share_of
from eigenscan.projector.wall_field import WallField
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ranges = NDArray[np.float32]


def support(
    field: WallField, poses: Array, bearings: Array, seen: Ranges, through: Ranges, scale: float = EXACT.scale
) -> tuple[Array, Array]:
    """`find_support` of poses (n, 3), m: mean support (n,), and the share (n,) of explained beams."""
    out = np.empty((2, len(poses)))
    find_support(
        field.cells, field.cell, field.cells_of(poses), bearings, seen, share_of(seen), through, scale, out
    )
    return out[0], out[1]


def clearance(field: WallField, poses: Array, bearings: Array, entered: Ranges, seen: Ranges) -> Ranges:
    """`find_clearance` of poses (n, 3), m."""
    out = np.zeros(entered.shape, dtype=np.float32)
    find_clearance(field.cells, field.cell, field.cells_of(poses), bearings, entered, seen, out)
    return out


def beyond_walls(clear: Ranges, scale: float = EXACT.scale) -> Ranges:
    """What `sure_beyond` is of many beams, by the same formula."""
    square = clear * clear
    sure: Ranges = square / (square + np.float32(scale**2))
    return sure
