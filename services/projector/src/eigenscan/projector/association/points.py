"""The coefficients of all poses, pose by pose, for associations that look at few of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.projector.association.manifold import Array, Index, Matches, Sheets
from numba import njit
from numpy.typing import NDArray

LEADING = 3
"""Coefficients that span the space in which the paper looks for the scan."""


@dataclass(frozen=True)
class Points:
    """Coefficients (n, 3 or more) of the poses; region r has those from `bounds[r]` to `bounds[r + 1]`."""

    coefficients: NDArray[np.float32]
    bounds: Index

    @classmethod
    def of(cls, regions: list[Sheets]) -> Points:
        """Points of all poses of the regions."""
        tables = [padded(region.coefficients).reshape(region.rows, -1) for region in regions]
        return cls(np.concatenate(tables), np.cumsum([0, *(region.rows for region in regions)]))

    def nearest_of(self, rows: Index, alphas: Array, residuals: Array, count: int) -> Matches:
        """The `count` nearest among `rows` (k,); `alphas` and `residuals` as in Association."""
        region = np.searchsorted(self.bounds, rows, side="right") - 1
        squares = _squares(self.coefficients, rows, region, alphas.astype(np.float32))
        squares += residuals[region].astype(np.float32)
        return Matches(rows, squares).best(count)


def padded(coefficients: NDArray[np.float32]) -> NDArray[np.float32]:
    """At least three of coefficients (..., M): a space of fewer has nothing in the others."""
    lacking = max(LEADING - coefficients.shape[-1], 0)
    return np.pad(coefficients, [(0, 0)] * (coefficients.ndim - 1) + [(0, lacking)])


def leading(coefficients: NDArray[np.float32]) -> NDArray[np.float32]:
    """The first three of coefficients (..., M)."""
    return padded(coefficients[..., :LEADING])


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _squares(
    coefficients: NDArray[np.float32], rows: Index, region: Index, alphas: NDArray[np.float32]
) -> NDArray[np.float32]:
    out = np.empty(len(rows), dtype=np.float32)
    for i in range(len(rows)):
        total = np.float32(0.0)
        for m in range(alphas.shape[1]):
            d = coefficients[rows[i], m] - alphas[region[i], m]
            total += d * d
        out[i] = total
    return out
