"""Interpolation between the grid's positions by ratios along its axes (paper, section 5.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.projector.association.manifold import Array, Index, Matches, Sheets
from numpy.typing import NDArray


@dataclass(frozen=True)
class Ratios:
    """The grid of all regions: `positions` (P, 2) m; `right` and `above` (P,), the next along x and y, or -1.

    `coefficients` (P, H, M), `region` (P,): positions are counted through the regions.
    """

    coefficients: NDArray[np.float32]
    positions: Array
    right: Index
    above: Index
    region: Index

    @classmethod
    def of(cls, regions: list[Sheets]) -> Ratios:
        """The grid of these regions."""
        before = np.cumsum([0, *(len(region.positions) for region in regions)])

        def beside(dx: int, dy: int) -> Index:
            own = [region.beside(dx, dy) for region in regions]
            return np.concatenate([np.where(i < 0, -1, i + n) for i, n in zip(own, before, strict=False)])

        return cls(
            np.concatenate([region.coefficients for region in regions]),
            np.concatenate([region.positions for region in regions]),
            beside(1, 0),
            beside(0, 1),
            np.repeat(np.arange(len(regions)), np.diff(before)),
        )

    def interpolate(self, found: Matches, alphas: Array) -> Matches:
        """The matches with x and y by section 5.2, their headings as they were.

        p0 is the corner of smallest x and y of the cell that a match lies in. The scan `alphas` (R, M) is
        projected on the two directions in eigenspace that lead from p0 to the next position along x and
        along y; the ratios to their lengths, within 0 to 1, are dx and dy. Where a neighbour is missing the
        match stays.
        """
        headings = self.coefficients.shape[1]
        home = found.rows // headings
        step = 2.0 * np.pi / headings
        # between two headings as between two sheets
        turned = found.rows % headings + found.offsets[:, 2] / step
        low = np.floor(turned).astype(np.int64)
        share = (turned - low)[:, None]

        def sheet(position: Index) -> Array:
            here, there = low % headings, (low + 1) % headings
            one, other = self.coefficients[position, here], self.coefficients[position, there]
            between: Array = (1.0 - share) * one + share * other
            return between

        p0 = self._corner(home, found.offsets)
        right, above = self.right[p0], self.above[p0]
        whole = (p0 >= 0) & (right >= 0) & (above >= 0)
        away = alphas[self.region[home]] - sheet(p0)
        moved = found.offsets.copy()
        at = self.positions[p0].copy()
        for axis, beside in ((0, right), (1, above)):
            along = sheet(beside) - sheet(p0)
            length2 = np.maximum((along**2).sum(axis=1), 1e-12)
            ratio = np.clip((away * along).sum(axis=1) / length2, 0.0, 1.0)
            at[:, axis] += ratio * (self.positions[beside, axis] - self.positions[p0, axis])
        moved[whole, :2] = (at - self.positions[home])[whole]
        return Matches(found.rows, found.squares, moved)

    def _corner(self, home: Index, offsets: Array) -> Index:
        """Position (k,) of smallest x and y of the cell that holds a match, -1 where it is missing."""
        p0 = home.copy()
        for axis, beside in ((0, self.right), (1, self.above)):
            before = np.full(len(beside), -1, dtype=np.int64)
            has = np.flatnonzero(beside >= 0)
            before[beside[has]] = has
            back = offsets[:, axis] < 0.0
            p0 = np.where(back & (p0 >= 0), before[p0], p0)
        return p0
