"""Finds narrow things that stand free before a farther background: legs, people, chairs.

Maps rarely contain them, and without them little is lost. So a scan is searched with and without them. When
poses are weighed beam by beam, they count again.
"""

from __future__ import annotations

import numpy as np
from numba import njit
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
    free = np.zeros(len(ranges), dtype=bool)
    _mark(ranges, step, free)
    return free


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _mark(ranges: NDArray[np.float32], step: float, free: NDArray[np.bool_]) -> None:
    first, falls, before = -1, False, np.inf
    for j in range(len(ranges)):
        near = np.inf if np.isnan(ranges[j]) else float(ranges[j])
        difference = near - before
        # between two empty beams, infinity less infinity, there is no jump; nor at the first beam
        if j > 0 and abs(difference) > JUMP_M:
            if first >= 0 and falls and difference > 0:
                # as wide as its beams reach, at its farther end
                farther = max(float(ranges[first]), before)
                if (j - first) * step * farther < WIDEST_M:
                    free[first:j] = True
            first, falls = j, difference < 0
        before = near
