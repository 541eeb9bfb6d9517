"""Association by connectivity: of each surface near the scan only its nearest point (paper, 5.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.projector.association.manifold import Array, Association, Index, Matches, Sheets
from eigenscan.projector.association.sweep import SweepTable
from numba import njit
from numpy.typing import NDArray


@dataclass(frozen=True)
class Surfaces(Association):
    """All poses, and which of them are neighbours on a sheet.

    `neighbours` (P, 4): positions beside each position, -1 where there is none, counted through the regions;
    a position has `headings` poses, one on each of its region's sheets.
    """

    poses: SweepTable
    neighbours: NDArray[np.int32]
    headings: int
    scratch: NDArray[np.int32]
    """Room (n,) for the poses' places in the list, -1 between scans."""

    @classmethod
    def of(cls, regions: list[Sheets], _margin: float = 0.0) -> Surfaces:
        """Surfaces of the regions."""
        neighbours, before = [], 0
        for region in regions:
            own = np.full((len(region.positions), 4), -1, dtype=np.int32)
            for axis, (one, other) in enumerate(region.links()):
                own[one, axis] = other + before
                own[other, axis + 2] = one + before
            neighbours.append(own)
            before += len(own)
        headings = regions[0].coefficients.shape[1]
        free = np.full(before * headings, -1, dtype=np.int32)
        return cls(SweepTable.of(regions), np.concatenate(neighbours), headings, free)

    @property
    def nbytes(self) -> int:
        """Memory of the index, bytes."""
        return self.poses.nbytes + self.neighbours.nbytes + self.scratch.nbytes

    def nearest(self, alphas: Array, residuals: Array, count: int) -> Matches:
        """Of the `count` nearest poses those without a nearer neighbour on their sheet; see Association.

        A sheet that bends away and comes back, at another place of the region, passes the scan twice.
        """
        near = self.poses.nearest(alphas, residuals, count).best(count)
        return near.take(_nearest_of_surfaces(near.rows, self.neighbours, self.headings, self.scratch))


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _nearest_of_surfaces(
    rows: Index, neighbours: NDArray[np.int32], headings: int, place: NDArray[np.int32]
) -> Index:
    """Indices into `rows` (k,), nearest first, of those before all their neighbours in the list."""
    first = np.empty(len(rows), dtype=np.int64)
    for i in range(len(rows)):
        place[rows[i]] = i
    found = 0
    for i in range(len(rows)):
        position, heading = rows[i] // headings, rows[i] % headings
        lowest = True
        for n in range(4):
            beside = neighbours[position, n]
            if beside >= 0 and 0 <= place[beside * headings + heading] < i:
                lowest = False
        if lowest:
            first[found] = i
            found += 1
    for i in range(len(rows)):
        place[rows[i]] = -1
    return first[:found]
