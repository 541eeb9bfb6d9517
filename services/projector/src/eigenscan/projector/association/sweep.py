"""The poses nearest to a scan in eigenspace, over all regions at once, by comparing with every one.

The table is small (a lattice of half a metre and 6 degrees, a byte a coefficient) and lies component by
component, so that comparing with all of it costs less than a tree that looks at a share of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.projector.association.manifold import Array, Index, Matches, Sheets
from numba import njit
from numpy.typing import NDArray

_STEPS = 127
_BLOCK = 2048
_BINS = 4096


@dataclass(frozen=True)
class SweepTable:
    """Coefficients (M, n) int8 in units of `unit`, region after region: `bounds` (R + 1,)."""

    table: NDArray[np.int8]
    bounds: Index
    unit: float
    scratch: NDArray[np.float32]
    """Room (n,) for the distances: a large array made anew costs more than what is written to it."""

    @classmethod
    def of(cls, regions: list[Sheets]) -> SweepTable:
        """Table of all poses of the regions."""
        tables = [r.coefficients.reshape(r.rows, -1) for r in regions]
        unit = max(max(float(np.abs(table).max(initial=0.0)) for table in tables) / _STEPS, 1e-9)
        bounds = np.cumsum([0, *(len(table) for table in tables)])
        packed = np.empty((tables[0].shape[1], bounds[-1]), dtype=np.int8)
        for start, table in zip(bounds[:-1], tables, strict=True):
            packed[:, start : start + len(table)] = np.rint(table.T / np.float32(unit))
        return cls(packed, bounds, unit, np.empty(bounds[-1], dtype=np.float32))

    @property
    def nbytes(self) -> int:
        """Memory of the index, bytes."""
        return self.table.nbytes + self.scratch.nbytes

    def nearest(self, alphas: Array, residuals: Array, count: int) -> Matches:
        """The about `count` nearest of all poses; see Association."""
        query = (alphas / self.unit).astype(np.float32)
        extra = (residuals / self.unit**2).astype(np.float32)
        searched = np.flatnonzero(np.isfinite(residuals))
        rows, square = _nearest(self.table, self.bounds, searched, query, extra, count, self.scratch)
        order = np.argsort(square)[:count]
        return Matches.on_grid(rows[order], (square[order] * self.unit**2).astype(np.float32))


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _nearest(
    table: NDArray[np.int8],
    bounds: Index,
    searched: Index,
    query: NDArray[np.float32],
    extra: NDArray[np.float32],
    count: int,
    square: NDArray[np.float32],
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    components, total = len(table), 0
    for r in searched:
        # the distances of the searched regions lie side by side
        skipped = bounds[r] - total
        total += bounds[r + 1] - bounds[r]
        for start in range(bounds[r], bounds[r + 1], _BLOCK):
            stop = min(start + _BLOCK, bounds[r + 1])
            part = square[start - skipped : stop - skipped]
            part[:] = extra[r]
            for m in range(components):
                q = query[r, m]
                row = table[m, start:stop]
                for i in range(len(part)):
                    d = np.float32(row[i]) - q
                    part[i] += d * d
    # a sample of the poses tells well enough how far the count-th is, unless they are few
    every = max(1, min(count // 128, 16))
    threshold = _threshold(square[:total], every, count)
    near = 0
    for i in range(total):
        near += square[i] <= threshold
    rows, squares = np.empty(near, dtype=np.int64), np.empty(near, dtype=np.float32)
    k, i = 0, 0
    for r in searched:
        for pose in range(bounds[r], bounds[r + 1]):
            if square[i] <= threshold:
                rows[k], squares[k] = pose, square[i]
                k += 1
            i += 1
    return rows, squares


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _threshold(square: NDArray[np.float32], every: int, count: int) -> np.float32:
    """Distance below which about `count` poses lie, by a histogram from the least distance to the mean."""
    sample = square[::every].copy()
    least, mean = sample.min(), sample.mean()
    width = np.float32(max((mean - least) / _BINS, 1e-6))
    histogram = np.zeros(_BINS + 1, dtype=np.int64)
    scale = np.float32(1.0) / width
    for i in range(len(sample)):
        histogram[min(int((sample[i] - least) * scale), _BINS)] += every
    limit, found = 0, histogram[0]
    while found < count and limit < _BINS:
        limit += 1
        found += histogram[limit]
    return least + (limit + 1) * width if limit < _BINS else np.float32(1e30)
