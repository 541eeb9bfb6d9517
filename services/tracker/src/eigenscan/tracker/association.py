"""Which hypothesis may belong to which track: validation gate and Gaussian overlap (paper, section 7)."""

from __future__ import annotations

from math import log
from typing import NamedTuple

import numpy as np
from eigenscan.geometry.symmetric import MATRICES, determinant, inverse, plus, square, triangle
from eigenscan.tracker.symmetric import ROWS, apart
from numba import njit, types
from numpy.typing import NDArray
from scipy.special import chdtri

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class Pairs(NamedTuple):
    """Pairs (track, hypothesis) within the gate, shape (p,) each, sorted by track, then hypothesis."""

    track: Index
    hypothesis: Index
    distance2: Array
    """Squared Mahalanobis distance under C* + C."""
    log_overlap: Array
    """ln of the integral of N(X*, C*) times exp(-d^2/2 under C): 0 where the track is a sure point at Y."""


def gate(probability: float) -> float:
    """Squared Mahalanobis distance of three dimensions that this share of right hypotheses is within."""
    return float(chdtri(3, 1.0 - probability))


_INDEX, _NUMBERS = types.int64[::1], types.float64[::1]
_PAIRS = types.Tuple((_INDEX, _INDEX, _NUMBERS, _NUMBERS))


@njit(
    _PAIRS(ROWS, MATRICES, ROWS, MATRICES, types.float64), cache=True, nogil=True, error_model="numpy"
)  # pragma: no cover - compiled
def within_gate(x: Array, C: Array, y: Array, R: Array, gate: float) -> tuple[Index, Index, Array, Array]:
    """Arrays of `Pairs`: tracks (n, 3), (n, 3, 3) and hypotheses (k, 3), (k, 3, 3), distance^2 <= `gate`."""
    room = len(x) * len(y)
    track, hypothesis = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64)
    distance2, log_overlap = np.empty(room), np.empty(room)
    count = 0
    for i in range(len(x)):
        for k in range(len(y)):
            # one axis alone is never farther than all three together
            if (y[k, 0] - x[i, 0]) ** 2 > gate * (C[i, 0, 0] + R[k, 0, 0]):
                continue
            if (y[k, 1] - x[i, 1]) ** 2 > gate * (C[i, 1, 1] + R[k, 1, 1]):
                continue
            own = triangle(R[k])
            total = plus(triangle(C[i]), own)
            length = square(inverse(total), apart(y[k], x[i]))
            if length <= gate:
                track[count], hypothesis[count], distance2[count] = i, k, length
                log_overlap[count] = 0.5 * log(determinant(own) / determinant(total)) - 0.5 * length
                count += 1
    return track[:count], hypothesis[:count], distance2[:count], log_overlap[:count]


@njit(_NUMBERS(ROWS, MATRICES), cache=True)  # pragma: no cover - compiled
def crowding_each(y: Array, R: Array) -> Array:
    """How many hypotheses (k, 3), (k, 3, 3) share each one's place, itself included; shape (k,), >= 1.

    Overlapping hypotheses describe one peak of the likelihood; dividing by this counts the peak once.
    """
    track, _, distance2, _ = within_gate(y, R, y, R, 50.0)
    count = np.zeros(len(y))
    for pair in range(len(track)):
        # under R + R the squared distance is half of what it is under R
        count[track[pair]] += np.exp(-distance2[pair])
    return np.maximum(count, 1.0)
