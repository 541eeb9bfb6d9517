"""The poses nearest to a scan in eigenspace, over all regions at once, by comparing with every one.

The table is small (a lattice of half a metre and 6 degrees, a byte a coefficient) and lies component by component,
so that comparing with all of it costs less than a tree that has to look at a share of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

_STEPS = 127
_BLOCK = 2048
_BINS = 8192


@dataclass(frozen=True)
class SweepTable:
    """Coefficients (M, n) int8 in units of `unit`, region after region: `bounds` (R + 1,)."""

    table: NDArray[np.int8]
    bounds: NDArray[np.int64]
    unit: float

    @classmethod
    def of(cls, tables: list[NDArray[np.float32]]) -> SweepTable:
        """Table of the regions' coefficients (n_r, M)."""
        unit = max(max(float(np.abs(table).max(initial=0.0)) for table in tables) / _STEPS, 1e-9)
        bounds = np.cumsum([0, *(len(table) for table in tables)])
        packed = np.empty((tables[0].shape[1], bounds[-1]), dtype=np.int8)
        for start, table in zip(bounds[:-1], tables, strict=True):
            packed[:, start : start + len(table)] = np.rint(table.T / np.float32(unit))
        return cls(packed, bounds, unit)

    def nearest(
        self, alphas: NDArray[np.float64], residuals: NDArray[np.float64], count: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Rows (k,) of the about `count` poses with the smallest ||S - S'||^2 (k,), nearest first.

        `alphas` (R, M): the scan in each region's space; `residuals` (R,): ||E||^2 there. What the space does not
        hold counts in full: ||alpha - alpha'||^2 + ||E||^2 is comparable across spaces.
        """
        query = np.clip(np.rint(alphas / self.unit), -2 * _STEPS, 2 * _STEPS).astype(np.int32)
        extra = np.minimum(np.rint(residuals / self.unit**2), 2**29).astype(np.int32)
        rows, square = _nearest(self.table, self.bounds, query, extra, count)
        order = np.argsort(square, kind="stable")
        return rows[order], (square[order] * self.unit**2).astype(np.float32)


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _nearest(
    table: NDArray[np.int8],
    bounds: NDArray[np.int64],
    query: NDArray[np.int32],
    extra: NDArray[np.int32],
    count: int,
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    components, total = table.shape
    square = np.empty(total, dtype=np.int32)
    for r in range(len(bounds) - 1):
        for start in range(bounds[r], bounds[r + 1], _BLOCK):
            stop = min(start + _BLOCK, bounds[r + 1])
            part = square[start:stop]
            part[:] = extra[r]
            for m in range(components):
                q = query[r, m]
                row = table[m, start:stop]
                for i in range(len(part)):
                    d = np.int32(row[i]) - q
                    part[i] += d * d
    least = square.min()
    shift = 0
    # distances grow from the least: a histogram of the near ones finds the count-th without sorting
    spread = min(max(np.int64(square[:: max(total // 512, 1)].mean()) - least, 1), 2**30)
    while (spread >> shift) >= _BINS:
        shift += 1
    histogram = np.zeros(_BINS, dtype=np.int64)
    for i in range(total):
        bin_ = (square[i] - least) >> shift
        if bin_ < _BINS:
            histogram[bin_] += 1
    limit, found = _BINS - 1, 0
    for b in range(_BINS):
        found += histogram[b]
        if found >= count:
            limit = b
            break
    threshold = least + ((limit + 1) << shift)
    rows = np.empty(min(found, total), dtype=np.int64)
    k = 0
    for i in range(total):
        if square[i] < threshold:
            rows[k] = i
            k += 1
    rows = rows[:k]
    return rows, square[rows]
