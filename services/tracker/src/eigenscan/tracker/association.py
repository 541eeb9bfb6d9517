"""Which hypothesis may belong to which track: validation gate and Gaussian overlap (paper, section 7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.tracker.covariance import determinant, mahalanobis_squared, residual
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class Pairs:
    """Pairs (track, hypothesis) within the gate, shape (p,) each, sorted by track, then hypothesis."""

    track: Index
    hypothesis: Index
    distance2: Array
    """Squared Mahalanobis distance under C* + C."""
    log_overlap: Array
    """ln of the integral of N(X*, C*) times exp(-d^2/2 under C): 0 where the track is a sure point at Y."""


def associate(x: Array, C: Array, y: Array, R: Array, gate: float) -> Pairs:
    """Pairs of tracks (n, 3), (n, 3, 3) and hypotheses (k, 3), (k, 3, 3) with distance^2 <= `gate`."""
    near = np.ones((len(x), len(y)), dtype=bool)
    for axis in (0, 1):
        delta = y[None, :, axis] - x[:, None, axis]
        # one axis alone is never farther than all three together
        near &= delta * delta <= gate * (C[:, axis, axis][:, None] + R[:, axis, axis][None, :])
    i, k = np.nonzero(near)
    total = C[i] + R[k]
    distance2 = mahalanobis_squared(residual(y[k], x[i]), total)
    inside = distance2 <= gate
    i, k, distance2, total = i[inside], k[inside], distance2[inside], total[inside]
    overlap = 0.5 * np.log(determinant(R[k]) / determinant(total)) - 0.5 * distance2
    return Pairs(i, k, distance2, overlap)


def crowding(y: Array, R: Array) -> Array:
    """How many hypotheses (k, 3), (k, 3, 3) share each one's place, itself included; shape (k,), >= 1.

    Overlapping hypotheses describe one peak of the likelihood; dividing by this counts the peak once.
    """
    pairs = associate(y, R, y, R, gate=50.0)
    # under R + R the squared distance is half of what it is under R
    return np.bincount(pairs.track, weights=np.exp(-pairs.distance2), minlength=len(y)).clip(min=1.0)
