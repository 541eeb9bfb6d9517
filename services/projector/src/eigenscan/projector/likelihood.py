"""How much likelier a scan is at a pose than at a place that the map does not show.

A beam is a mixture: the wall that the map predicts; something nearer, such as a person or furniture;
anything at all. A scan of an unknown place draws its ranges from what the map's panoramas show anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WALL_SIGMA = 0.1
"""m, spread of a range about the predicted wall: noise, map resolution and rest of the pose error."""
WALL, NEARER, ANYTHING = 0.75, 0.15, 0.1
"""Shares of the mixture."""
HORIZON = 30.0
"""m, `anything` is spread evenly up to here or the sensor's own limit."""
INDEPENDENCE = 0.25
"""Independent beams per beam of 2 degrees: neighbours see the same wall and the same mistakes."""


@dataclass(frozen=True)
class RangeHistogram:
    """Density (K,) 1/m of the ranges that a building shows, over bins of `width` m."""

    density: NDArray[np.float64]
    width: float

    @classmethod
    def of(cls, ranges: NDArray[np.float32], horizon: float) -> RangeHistogram:
        """Histogram of ranges of any shape; what is beyond the horizon is left out."""
        width = 0.5
        bins = max(int(np.ceil(horizon / width)), 1)
        seen = ranges[np.isfinite(ranges) & (ranges < bins * width)]
        counts = np.bincount((seen / width).astype(np.int64), minlength=bins)[:bins].astype(np.float64)
        # one range of ten is anywhere: other buildings differ
        density = (0.9 * counts / max(counts.sum(), 1.0) + 0.1 / bins) / width
        return cls(density, width)

    def at(self, ranges: NDArray[np.float32]) -> NDArray[np.float64]:
        """Density at ranges (B,)."""
        index = np.minimum((ranges / self.width).astype(np.int64), len(self.density) - 1)
        found: NDArray[np.float64] = self.density[index]
        return found


def log_likelihood(
    seen: NDArray[np.float32],
    predicted: NDArray[np.float32],
    elsewhere: RangeHistogram,
    horizon: float,
) -> NDArray[np.float64]:
    """Ln p(scan | pose) / p(scan | unknown place), (n,), of beams `seen` (B,) finite, `predicted` (n, B)."""
    wall = np.minimum(predicted, horizon).astype(np.float64)
    z = seen.astype(np.float64)
    hit = np.exp(-0.5 * ((z - wall) / WALL_SIGMA) ** 2) / (np.sqrt(2.0 * np.pi) * WALL_SIGMA)
    nearer = (z < wall) / np.maximum(wall, 0.5)
    p = WALL * hit + NEARER * nearer + ANYTHING / horizon
    ratio = np.log(p) - np.log(elsewhere.at(seen))
    total: NDArray[np.float64] = INDEPENDENCE * ratio.sum(axis=1)
    return total
