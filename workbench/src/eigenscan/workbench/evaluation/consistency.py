"""Tests the size of covariances, by the normalised error and innovation squared.

Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4. The
error test takes the reference for exact; the innovation test needs none. Both use only right poses, because
the calibration judges wrong ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Floats = NDArray[np.float64]

FREEDOM = 3
"""Degrees of freedom of a pose: x, y, heading."""
PROBABILITY = 0.95


@dataclass(frozen=True)
class Consistency:
    """Mean of `n` squares that are apart, and the interval that holds it in 95 of 100 consistent runs.

    Above `high` the covariances are too small (sure of itself), below `low` too large.
    """

    n: int
    apart_m: float
    mean: float | None
    low: float | None
    high: float | None


def consistency(normalised: Floats, metres: Floats, apart_m: float) -> Consistency:
    """Tests normalised squares (n,) at distances (n,), m, along the log; NaN: no value there.

    Only rows `apart_m` apart count. Overlapping windows share a distance, so a stretch in several of them
    counts once.
    """
    sound = np.isfinite(normalised)
    values = normalised[sound][apart(metres[sound], apart_m)]
    if not len(values):
        return Consistency(0, apart_m, None, None, None)
    low, high = bounds(len(values))
    return Consistency(len(values), apart_m, float(values.mean()), low, high)


def apart(metres: Floats, apart_m: float) -> NDArray[np.intp]:
    """Rows whose distances (n,) are at least `apart_m` apart: the first, then always the next."""
    order = np.argsort(metres, kind="stable")
    way = metres[order]
    chosen, row = [], 0
    while row < len(way):
        chosen.append(row)
        row = int(np.searchsorted(way, way[row] + apart_m))
    return order[chosen]


def bounds(n: int) -> tuple[float, float]:
    """Interval of the mean of `n` independent chi-square variables of 3 degrees of freedom."""
    low, high = chi2.interval(PROBABILITY, FREEDOM * n)
    return float(low / n), float(high / n)
