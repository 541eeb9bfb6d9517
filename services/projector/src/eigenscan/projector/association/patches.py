"""Planar patches of the sheets: triangles of neighbouring positions (paper, section 4, figure 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.projector.association.manifold import Array, Index, Matches, Sheets
from eigenscan.projector.association.points import Points
from numba import njit
from numpy.typing import NDArray

Singles = NDArray[np.float32]
Boxes = tuple[Singles, Singles]
"""Lowest and highest corners (3, n) of boxes in the first three coefficients."""

ROUNDING = 1e-5
"""Tolerance of a corner's weight: a scan on a face counts as enclosed by both sides."""


@dataclass(frozen=True)
class Patches:
    """Triangles (T, 3) of positions, counted through the regions; each lies on all of `headings` sheets.

    `positions` (P, 2) m, map frame; region r has the triangles from `bounds[r]` to `bounds[r + 1]`.
    """

    points: Points
    positions: Array
    triangles: NDArray[np.int32]
    bounds: Index
    headings: int

    @classmethod
    def of(cls, regions: list[Sheets]) -> Patches:
        """Patches of all sheets of the regions."""
        before = np.cumsum([0, *(len(region.positions) for region in regions)])
        triangles = [triangulate(region) + first for region, first in zip(regions, before, strict=False)]
        return cls(
            Points.of(regions),
            np.concatenate([region.positions for region in regions]),
            np.concatenate(triangles).astype(np.int32),
            np.cumsum([0, *(len(own) for own in triangles)]),
            regions[0].coefficients.shape[1],
        )

    @property
    def nbytes(self) -> int:
        """Memory, bytes."""
        return self.points.coefficients.nbytes + self.positions.nbytes + self.triangles.nbytes


def triangulate(region: Sheets) -> Index:
    """Triangles (T, 3) of the region's positions, each in ascending order.

    A square of four neighbours is cut from its lowest corner to its highest; where one is missing, the others
    make a triangle.
    """
    here = np.arange(len(region.positions))
    right, above, across = region.beside(1, 0), region.beside(0, 1), region.beside(1, 1)
    left, below, back = region.beside(-1, 0), region.beside(0, -1), region.beside(-1, -1)
    triples = [
        (here, right, across),
        (here, above, across),
        (here, right, np.where(across < 0, above, -1)),
        (here, left, np.where(back < 0, below, -1)),
    ]
    found = np.concatenate([np.stack(triple, axis=1) for triple in triples])
    return np.sort(found[(found >= 0).all(axis=1)], axis=1)


def once(found: Matches, count: int) -> Matches:
    """At most `count` matches, nearest first, of each grid pose only the nearest."""
    ordered = found.best(len(found.rows))
    _, first = np.unique(ordered.rows, return_index=True)
    return ordered.take(np.sort(first)[:count])


def box(corners: Singles, margin: float, around: Singles | float = 0.0) -> Boxes:
    """Boxes (T, H, 3) around simplices with `corners` (V, T, H, 3), grown by `margin` and `around` (T, H, 1).

    Where no corner's weight is below -margin, a point lies in the simplex grown about its centre.
    """
    grown, centre = 1.0 + len(corners) * margin, corners.mean(axis=0)
    low = grown * corners.min(axis=0) - (grown - 1.0) * centre - around
    high = grown * corners.max(axis=0) - (grown - 1.0) * centre + around
    return low, high


def rows_of(boxes: list[Boxes]) -> Boxes:
    """Boxes (T, H, 3) of the regions as (3, n), coefficient by coefficient."""
    low, high = (
        np.concatenate([part[side].reshape(-1, part[side].shape[-1]).T for part in boxes], axis=1)
        for side in (0, 1)
    )
    # rounding must not cut what lies on a face
    slack = np.float32(1e-5) * (1.0 + np.abs(low) + np.abs(high))
    return (low - slack).astype(np.float32), (high + slack).astype(np.float32)


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def boxes_around(
    lowest: Singles, highest: Singles, bounds: Index, searched: NDArray[np.bool_], first: Singles
) -> Index:
    """Numbers of the boxes (3, n) that hold the scan (R, 3); region r has those from `bounds[r]` on."""
    inside = np.zeros(lowest.shape[1], dtype=np.bool_)
    for r in np.flatnonzero(searched):
        a, b = bounds[r], bounds[r + 1]
        x, y, z = first[r, 0], first[r, 1], first[r, 2]
        low, high, held = lowest[:, a:b], highest[:, a:b], inside[a:b]
        for i in range(b - a):
            held[i] = (
                (low[0, i] <= x)
                & (x <= high[0, i])
                & (low[1, i] <= y)
                & (y <= high[1, i])
                & (low[2, i] <= z)
                & (z <= high[2, i])
            )
    return np.flatnonzero(inside)


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def square_to(coefficients: Singles, rows: Index, weights: Array, alpha: Singles) -> float:
    """Squared distance of `alpha` (M,) from the scan that the poses `rows` (k,) give by `weights` (k,)."""
    square = 0.0
    for m in range(len(alpha)):
        d = -np.float64(alpha[m])
        for k in range(len(rows)):
            d += weights[k] * coefficients[rows[k], m]
        square += d * d
    return square
