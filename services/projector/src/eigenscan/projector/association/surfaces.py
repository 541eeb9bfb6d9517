"""Association by connectivity: of each surface near the scan only its nearest point (paper, 5.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.projector.association.manifold import Array, Index, Matches, Sheets
from eigenscan.projector.association.sweep import SweepTable
from numba import njit
from numpy.typing import NDArray


@dataclass(frozen=True)
class Surfaces:
    """All poses, and which of them are neighbours on a sheet.

    `neighbours` (P, 4): positions beside each position, -1 where there is none, counted through the regions;
    a position has `headings` poses, one on each of its region's sheets.
    """

    poses: SweepTable
    neighbours: NDArray[np.int32]
    headings: int

    @classmethod
    def of(cls, regions: list[Sheets]) -> Surfaces:
        """Surfaces of the regions."""
        neighbours, before = [], 0
        for region in regions:
            own = np.full((len(region.positions), 4), -1, dtype=np.int32)
            for axis, (one, other) in enumerate(region.links()):
                own[one, axis] = other + before
                own[other, axis + 2] = one + before
            neighbours.append(own)
            before += len(own)
        return cls(SweepTable.of(regions), np.concatenate(neighbours), regions[0].coefficients.shape[1])

    @property
    def nbytes(self) -> int:
        """Memory of the index, bytes."""
        return self.poses.nbytes + self.neighbours.nbytes

    def nearest(self, alphas: Array, residuals: Array, count: int) -> Matches:
        """The nearest pose of each connected piece of a sheet inside the volume; see Association.

        The volume is the ball around the scan that holds the `count` nearest poses. A sheet that leaves it
        and comes back, at another place of the region, passes through it twice.
        """
        near = self.poses.nearest(alphas, residuals, count)
        rank = np.full(len(self.neighbours) * self.headings, -1, dtype=np.int32)
        rank[near.rows] = np.arange(len(near.rows), dtype=np.int32)
        return near.take(_nearest_of_pieces(near.rows, rank, self.neighbours, self.headings))


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _nearest_of_pieces(
    rows: Index, rank: NDArray[np.int32], neighbours: NDArray[np.int32], headings: int
) -> Index:
    """Indices into `rows` (k,), nearest first: the first of each connected piece. `rank` (n,) is used up."""
    first = np.empty(len(rows), dtype=np.int64)
    stack = np.empty(len(rows), dtype=np.int64)
    found = 0
    for i in range(len(rows)):
        if rank[rows[i]] < 0:
            continue
        first[found] = i
        found += 1
        stack[0], waiting = rows[i], 1
        rank[rows[i]] = -1
        while waiting:
            waiting -= 1
            position, heading = stack[waiting] // headings, stack[waiting] % headings
            for n in range(4):
                beside = neighbours[position, n]
                row = beside * headings + heading
                if beside >= 0 and rank[row] >= 0:
                    rank[row] = -1
                    stack[waiting] = row
                    waiting += 1
    return first[:found]
