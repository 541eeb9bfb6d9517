"""Narrow things that stand free before a farther background: legs, people, chairs.

They are rarely in a map, and where they are, little is lost without them. So a scan is searched with and
without them; where poses are weighed beam by beam they count again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

JUMP_M = 0.3
"""Step in range from beam to beam, m, that parts one thing from another."""
WIDEST_M = 0.7
"""A free-standing thing wider than this is furniture or a wall."""


def foreground(ranges: NDArray[np.float32], step: float) -> NDArray[np.bool_]:
    """Beams (J,) on narrow free-standing things, of ranges (J,) m that are `step` rad apart.

    A thing is a run of beams without a jump; it stands free where the beams on both of its sides end farther.
    Empty beams end farther than any. At the ends of the field of view nothing is known to stand free.
    """
    near = np.where(np.isnan(ranges), np.inf, ranges).astype(np.float64)
    with np.errstate(invalid="ignore"):
        difference = np.diff(near)
    # between two empty beams there is no jump
    jumps = np.flatnonzero(np.abs(np.nan_to_num(difference, nan=0.0)) > JUMP_M) + 1
    if len(jumps) < 2:
        return np.zeros(len(ranges), dtype=bool)
    first, after = jumps[:-1], jumps[1:]
    falls = difference[first - 1] < 0
    rises = difference[after - 1] > 0
    # as wide as its beams reach, at its farther end
    width = (after - first) * step * np.maximum(near[first], near[after - 1])
    free = np.zeros(len(ranges) + 1, dtype=np.int64)
    chosen = falls & rises & (width < WIDEST_M)
    np.add.at(free, first[chosen], 1)
    np.add.at(free, after[chosen], -1)
    return np.cumsum(free[:-1]) > 0
