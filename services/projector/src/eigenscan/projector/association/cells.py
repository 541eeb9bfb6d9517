"""Association by a table of cells: eigenspace cut into cubes that list their poses (paper, section 5.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.projector.association.manifold import Array, Association, Index, Matches, Sheets
from eigenscan.projector.association.points import LEADING, Points, leading
from numpy.typing import NDArray

_MOST_CELLS = 1 << 16
"""Along one axis, so that a cell's number stays a whole number of 64 bits."""


@dataclass(frozen=True)
class CellTable(Association):
    """The poses (n,) in the order of their cells' numbers `keys` (n,), along the first three coefficients.

    A cell is a cube of `side`; `low` (3,) is the corner of the first of `shape` (3,) cells of each region.
    """

    points: Points
    rows: NDArray[np.int32]
    keys: Index
    side: float
    low: Array
    shape: Index

    @classmethod
    def of(cls, regions: list[Sheets], _margin: float = 0.0) -> CellTable:
        """Table with cells as wide as neighbouring poses are apart on average, over all regions."""
        points = Points.of(regions)
        first = leading(points.coefficients).astype(np.float64)
        low = first.min(axis=0)
        extent = float(np.ptp(first, axis=0).max())
        side = max(mean_step(regions), extent / _MOST_CELLS, 1e-6)
        cells = ((first - low) // side).astype(np.int64)
        shape = cells.max(axis=0) + 1
        region = np.repeat(np.arange(len(regions)), np.diff(points.bounds))
        keys = _number(region, cells, shape)
        order = np.argsort(keys, kind="stable")
        return cls(points, order.astype(np.int32), keys[order], side, low, shape)

    @property
    def nbytes(self) -> int:
        """Memory of the index, bytes."""
        return self.points.coefficients.nbytes + self.rows.nbytes + self.keys.nbytes

    def nearest(self, alphas: Array, residuals: Array, count: int) -> Matches:
        """The nearest of the poses in the scan's cells and those around them.

        In each region as many rings of cells count as it takes to hold `count` poses in all. See Association.
        """
        centre = (leading(alphas.astype(np.float32)) - self.low) // self.side
        cell = np.clip(centre.astype(np.int64), 0, self.shape - 1)
        searched = np.flatnonzero(np.isfinite(residuals))
        wanted = min(count, int(np.diff(self.points.bounds)[searched].sum()))
        rings = 1
        rows = self._within(searched, cell[searched], rings)
        while len(rows) < wanted:
            rings += 1
            rows = self._within(searched, cell[searched], rings)
        return self.points.nearest_of(rows, alphas, residuals, count)

    def _within(self, regions: Index, cell: Index, rings: int) -> Index:
        """Rows of `regions` (r,) in the cells at most `rings` from `cell` (r, 3) along each axis."""
        step = np.arange(-rings, rings + 1)
        dx, dy = (grid.ravel() for grid in np.meshgrid(step, step, indexing="ij"))
        region = np.repeat(regions, len(dx))
        columns = np.empty((len(region), LEADING), dtype=np.int64)
        columns[:, 0] = (cell[:, :1] + dx).ravel()
        columns[:, 1] = (cell[:, 1:2] + dy).ravel()
        columns[:, 2] = np.repeat(np.maximum(cell[:, 2] - rings, 0), len(dx))
        last = np.repeat(np.minimum(cell[:, 2] + rings, self.shape[2] - 1), len(dx))
        inside = ((columns[:, :2] >= 0) & (columns[:, :2] < self.shape[:2])).all(axis=1)
        # the cells of a column lie side by side
        from_key = _number(region[inside], columns[inside], self.shape)
        to_key = from_key + last[inside] - columns[inside, 2]
        start = np.searchsorted(self.keys, from_key)
        stop = np.searchsorted(self.keys, to_key, side="right")
        held = stop - start
        at = np.arange(held.sum()) + np.repeat(start - np.cumsum(held) + held, held)
        found: Index = self.rows[at].astype(np.int64)
        return found


def mean_step(regions: list[Sheets]) -> float:
    """Root mean square distance, in the first three coefficients, of poses next to each other."""
    total, pairs = 0.0, 0
    for region in regions:
        first = leading(region.coefficients)
        for one, other in region.links():
            total += float(np.sum((first[one] - first[other]) ** 2, dtype=np.float64))
            pairs += len(one) * first.shape[1]
        total += float(np.sum((first - np.roll(first, 1, axis=1)) ** 2, dtype=np.float64))
        pairs += region.rows
    return float(np.sqrt(total / max(pairs, 1)))


def _number(region: Index, cell: Index, shape: Index) -> Index:
    number: Index = ((region * shape[0] + cell[:, 0]) * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    return number
