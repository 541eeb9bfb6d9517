"""Association by planar patches: triangles of a sheet that the scan lies over (paper, 5.1 and 5.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.projector.association.manifold import Array, Association, Index, Matches, Sheets
from eigenscan.projector.association.patches import (
    ROUNDING,
    Boxes,
    Patches,
    Singles,
    box,
    boxes_around,
    once,
    rows_of,
    square_to,
    triangulate,
)
from eigenscan.projector.association.points import leading
from numba import njit
from numpy.typing import NDArray


@dataclass(frozen=True)
class Triangles(Association):
    """Patches, and how far before and behind each the scan may lie: `reach` (T * H,).

    That is half of the farthest step from one of its corners to the next sheet, and the margin: no pose's
    scan is farther from the nearest sheet. `lowest` and `highest` (3, T * H) hold that, in the first three
    coefficients.
    """

    patches: Patches
    reach: Singles
    lowest: Singles
    highest: Singles
    margin: float

    @classmethod
    def of(cls, regions: list[Sheets], margin: float) -> Triangles:
        """Patches of the regions; `margin` is the part of its size that a scan may lie outside of one."""
        parts = [_reach_and_boxes(region, margin) for region in regions]
        low, high = rows_of([boxes for _, boxes in parts])
        return cls(Patches.of(regions), np.concatenate([reach for reach, _ in parts]), low, high, margin)

    @property
    def nbytes(self) -> int:
        """Memory of the index, bytes."""
        return self.patches.nbytes + self.reach.nbytes + self.lowest.nbytes + self.highest.nbytes

    def nearest(self, alphas: Array, residuals: Array, count: int) -> Matches:
        """Of each patch that the scan lies over, in the first three coefficients, the interpolated pose.

        Ordered by their interpolated scan's distance in all coefficients. Nothing where the scan lies over no
        patch. See Association.
        """
        query = alphas.astype(np.float32)
        first = leading(query)
        patches = self.patches
        bounds = patches.bounds * patches.headings
        near = boxes_around(self.lowest, self.highest, bounds, np.isfinite(residuals), first)
        found = _below(
            near, bounds, patches.triangles, patches.headings, self.reach,
            patches.points.coefficients, patches.positions, query, first, residuals,
            -self.margin - ROUNDING,
        )  # fmt: skip
        return once(Matches(*found), count)


def _reach_and_boxes(region: Sheets, margin: float) -> tuple[Singles, Boxes]:
    first = leading(region.coefficients)
    corners = first[triangulate(region).T]
    forth = np.linalg.norm(np.roll(corners, -1, axis=2) - corners, axis=-1).max(axis=0)
    reach = np.maximum(forth, np.roll(forth, 1, axis=1)) * np.float32(0.5 + margin)
    return reach.ravel(), box(corners, margin, reach[..., None])


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _foot(corners: Singles, rows: Index, x: Singles, weights: Array) -> float:
    """Barycentric `weights` (3,) of the point of the triangle's plane nearest to x; its distance, m."""
    uu, uv, vv, ue, ve, ee = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for m in range(3):
        origin = np.float64(corners[rows[0], m])
        u, v, e = corners[rows[1], m] - origin, corners[rows[2], m] - origin, x[m] - origin
        uu += u * u
        uv += u * v
        vv += v * v
        ue += u * e
        ve += v * e
        ee += e * e
    area = uu * vv - uv * uv
    if area <= 0.0:
        return np.inf
    weights[1] = (vv * ue - uv * ve) / area
    weights[2] = (uu * ve - uv * ue) / area
    weights[0] = 1.0 - weights[1] - weights[2]
    return float(np.sqrt(max(ee - weights[1] * ue - weights[2] * ve, 0.0)))


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _below(
    near: Index,
    bounds: Index,
    triangles: NDArray[np.int32],
    headings: int,
    reach: Singles,
    coefficients: Singles,
    positions: Array,
    alphas: Singles,
    first: Singles,
    residuals: Array,
    least: float,
) -> tuple[Index, Singles, Array]:
    """Row, square and offset of each of the patches `near` that the scan lies over."""
    out_rows = np.empty(len(near), dtype=np.int64)
    out_squares = np.empty(len(near), dtype=np.float32)
    out_offsets = np.zeros((len(near), 3))
    rows, weights = np.empty(3, np.int64), np.empty(3)
    found, r = 0, 0
    for patch in near:
        while patch >= bounds[r + 1]:
            r += 1
        for k in range(3):
            rows[k] = triangles[patch // headings, k] * headings + patch % headings
        away = _foot(coefficients, rows, first[r], weights)
        if away > reach[patch] or weights.min() < least:
            continue
        own = np.argmax(weights)
        square = square_to(coefficients, rows, weights, alphas[r])
        home = rows[own] // headings
        out_rows[found], out_squares[found] = rows[own], square + residuals[r]
        for axis in range(2):
            out_offsets[found, axis] = -positions[home, axis]
            for k in range(3):
                out_offsets[found, axis] += weights[k] * positions[rows[k] // headings, axis]
        found += 1
    return out_rows[:found], out_squares[:found], out_offsets[:found]
