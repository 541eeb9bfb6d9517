"""All positions of the site on the model's grid, with the sensor's view from each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from eigenscan.eigenspace.analysis import SEARCH_SPACING, searched
from eigenscan.eigenspace.model import RegionModel
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

NEAR = 3
"""Cells around a point in which its nearest position is looked for, before the tree is asked: that takes ten
times as long."""


@dataclass(frozen=True)
class Lattice:
    """P positions (P, 2) m, map frame; panoramas (P, N) m on the analysis grid, +inf: no wall in sight.

    `neighbours` (P, 9): index of the position one step of the model's grid, `spacing` m, away, -1 if there is
    none; itself at 4. `regions`: for each region the indices of its positions, `searched` those (S,) that are
    searched, `cells` (S, 2) their place on the search grid; `finer`: whether there are others.
    """

    positions: NDArray[np.float64]
    panoramas: NDArray[np.float32]
    neighbours: NDArray[np.int32]
    spacing: float
    finer: bool
    regions: tuple[NDArray[np.int64], ...]
    searched: tuple[NDArray[np.int64], ...]
    cells: tuple[NDArray[np.int64], ...]

    @property
    def searched_spacing(self) -> float:
        """Between neighbouring searched positions, m."""
        return max(1, round(SEARCH_SPACING / self.spacing)) * self.spacing

    @cached_property
    def tree(self) -> cKDTree:
        """Tree of the positions."""
        return cKDTree(self.positions)

    def nearest(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """The position (n,) nearest to each of points (n, 2)."""
        low, grid = self._cells
        found = _nearest(self.positions, low, grid, self.spacing, np.ascontiguousarray(points))
        far = np.flatnonzero(found < 0)
        if len(far):
            found[far] = self.tree.query(points[far])[1]
        return found

    @cached_property
    def region_of(self) -> NDArray[np.int64]:
        """A region (P,) of each position; of those that share it, the last."""
        found = np.zeros(len(self.positions), dtype=np.int64)
        for number, positions in enumerate(self.regions):
            found[positions] = number
        return found

    @cached_property
    def _cells(self) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """The corner of the model's grid, m, and its positions cell by cell, -1 where there is none."""
        low = self.positions.min(axis=0)
        at = np.rint((self.positions - low) / self.spacing).astype(np.int64)
        grid = np.full(at.max(axis=0) + 1, -1, dtype=np.int32)
        grid[at[:, 0], at[:, 1]] = np.arange(len(at))
        return low, grid

    @classmethod
    def of(cls, models: tuple[RegionModel, ...]) -> Lattice:
        """Lattice of the regions of one set; positions that several share are kept once."""
        cell = np.rint(np.concatenate([m.positions for m in models]) / models[0].spacing * 64).astype(
            np.int64
        )
        _, first, member = np.unique(cell, axis=0, return_index=True, return_inverse=True)
        bounds = np.cumsum([0, *(len(model.index) for model in models)])
        member = member.reshape(-1)
        regions = tuple(member[a:b] for a, b in pairwise(bounds))
        index = np.concatenate([model.index for model in models])
        stride = max(1, round(SEARCH_SPACING / models[0].spacing))
        sampled = [searched(model.index, model.spacing) for model in models]
        panoramas = np.concatenate([model.analysed for model in models])
        positions = np.concatenate([model.positions for model in models])
        return cls(
            positions[first],
            panoramas[first],
            _neighbours(index[first]),
            models[0].spacing,
            stride > 1,
            regions,
            tuple(own[at] for own, (at, _) in zip(regions, sampled, strict=True)),
            tuple(cells for _, cells in sampled),
        )


def _neighbours(index: NDArray[np.int32]) -> NDArray[np.int32]:
    low = index.min(axis=0) - 1
    grid = np.full(index.max(axis=0) - low + 2, -1, dtype=np.int32)
    at = index - low
    grid[at[:, 0], at[:, 1]] = np.arange(len(index))
    steps = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
    return np.stack([grid[at[:, 0] + dx, at[:, 1] + dy] for dx, dy in steps], axis=1)


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _nearest(
    positions: NDArray[np.float64],
    low: NDArray[np.float64],
    grid: NDArray[np.int32],
    spacing: float,
    points: NDArray[np.float64],
) -> NDArray[np.int64]:
    """The position (n,) nearest to each point; -1 where none is so near that no cell farther off holds it."""
    found = np.full(len(points), -1, dtype=np.int64)
    for i in range(len(points)):
        x, y = points[i]
        column, row = int(np.rint((x - low[0]) / spacing)), int(np.rint((y - low[1]) / spacing))
        least = ((NEAR + 0.5) * spacing) ** 2
        for c in range(max(column - NEAR, 0), min(column + NEAR + 1, grid.shape[0])):
            for r in range(max(row - NEAR, 0), min(row + NEAR + 1, grid.shape[1])):
                at = grid[c, r]
                if at >= 0:
                    square = (positions[at, 0] - x) ** 2 + (positions[at, 1] - y) ** 2
                    if square < least:
                        least, found[i] = square, at
    return found
