"""Association by volumes: tetrahedra of neighbouring poses that enclose the scan (paper, 5.1)."""

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

CORNERS = ((0, 3, 4, 5), (0, 1, 4, 5), (0, 1, 2, 5))
"""Of the tetrahedra of a prism; 0 to 2 at its own heading, 3 to 5 at the next: neighbours share faces."""


@dataclass(frozen=True)
class Tetrahedra(Association):
    """Between a patch and the same patch at the next heading lies a prism of three tetrahedra.

    `lowest` and `highest` (3, T * H): the box around each prism in the first three coefficients.
    """

    patches: Patches
    lowest: Singles
    highest: Singles
    margin: float

    @classmethod
    def of(cls, regions: list[Sheets], margin: float) -> Tetrahedra:
        """Volumes of the regions; `margin` is the part of its size that a scan may lie outside of one."""
        low, high = rows_of([_boxes(region, margin) for region in regions])
        return cls(Patches.of(regions), low, high, margin)

    @property
    def nbytes(self) -> int:
        """Memory of the index, bytes."""
        return self.patches.nbytes + self.lowest.nbytes + self.highest.nbytes

    def nearest(self, alphas: Array, residuals: Array, count: int) -> Matches:
        """Of each volume that encloses the scan in the first three coefficients the interpolated pose.

        Ordered by their interpolated scan's distance in all coefficients. Nothing where the scan lies outside
        of all volumes and their margin. See Association.
        """
        query = alphas.astype(np.float32)
        first = leading(query)
        patches = self.patches
        near = boxes_around(
            self.lowest, self.highest, patches.bounds * patches.headings, np.isfinite(residuals), first
        )
        found = _enclosing(
            near, patches.bounds * patches.headings, patches.triangles, patches.headings,
            patches.points.coefficients, patches.positions, query, first, residuals,
            -self.margin - ROUNDING,
        )  # fmt: skip
        return once(Matches(*found), count)


def _boxes(region: Sheets, margin: float) -> Boxes:
    first = leading(region.coefficients)
    here = first[triangulate(region).T]
    six = np.concatenate([here, np.roll(here, -1, axis=2)])
    low, high = zip(*(box(six[list(four)], margin) for four in CORNERS), strict=True)
    return np.minimum.reduce(low), np.maximum.reduce(high)


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _weights(corners: Singles, rows: Index, x: Singles, weights: Array, least: float) -> bool:
    """Barycentric `weights` (4,) of x in the tetrahedron `rows` (4,); whether none is below `least`."""
    o, p, q, s = corners[rows[0]], corners[rows[1]], corners[rows[2]], corners[rows[3]]
    ex, ey, ez = np.float64(x[0] - o[0]), np.float64(x[1] - o[1]), np.float64(x[2] - o[2])
    px, py, pz = np.float64(p[0] - o[0]), np.float64(p[1] - o[1]), np.float64(p[2] - o[2])
    qx, qy, qz = np.float64(q[0] - o[0]), np.float64(q[1] - o[1]), np.float64(q[2] - o[2])
    sx, sy, sz = np.float64(s[0] - o[0]), np.float64(s[1] - o[1]), np.float64(s[2] - o[2])
    nx, ny, nz = qy * sz - qz * sy, qz * sx - qx * sz, qx * sy - qy * sx
    volume = px * nx + py * ny + pz * nz
    if volume == 0.0:
        return False
    # each weight is the volume with x in the corner's place
    first = (ex * nx + ey * ny + ez * nz) / volume
    nx, ny, nz = py * ez - pz * ey, pz * ex - px * ez, px * ey - py * ex
    second = (sx * nx + sy * ny + sz * nz) / volume
    third = -(qx * nx + qy * ny + qz * nz) / volume
    weights[0], weights[1], weights[2], weights[3] = 1.0 - first - second - third, first, second, third
    return bool(min(first, second, third, weights[0]) >= least)


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _enclosing(
    near: Index,
    bounds: Index,
    triangles: NDArray[np.int32],
    headings: int,
    coefficients: Singles,
    positions: Array,
    alphas: Singles,
    first: Singles,
    residuals: Array,
    least: float,
) -> tuple[Index, Singles, Array]:
    """Row, square and offset of each enclosing tetrahedron of the prisms `near`."""
    out_rows = np.empty(3 * len(near), dtype=np.int64)
    out_squares = np.empty(3 * len(near), dtype=np.float32)
    out_offsets = np.empty((3 * len(near), 3))
    six, rows, weights = np.empty(6, np.int64), np.empty(4, np.int64), np.empty(4)
    step = 2.0 * np.pi / headings
    found, r = 0, 0
    for prism in near:
        while prism >= bounds[r + 1]:
            r += 1
        t, h = prism // headings, prism % headings
        for k in range(3):
            six[k] = triangles[t, k] * headings + h
            six[k + 3] = triangles[t, k] * headings + (h + 1) % headings
        for lower in range(3):
            for k in range(4):
                rows[k] = six[CORNERS[lower][k]]
            if not _weights(coefficients, rows, first[r], weights, least):
                continue
            own = np.argmax(weights)
            square = square_to(coefficients, rows, weights, alphas[r])
            x, y, turn = 0.0, 0.0, 0.0
            for k in range(4):
                x += weights[k] * positions[rows[k] // headings, 0]
                y += weights[k] * positions[rows[k] // headings, 1]
                turn += weights[k] * step if k > lower else 0.0
            home = rows[own] // headings
            out_rows[found] = rows[own]
            out_squares[found] = square + residuals[r]
            out_offsets[found, 0] = x - positions[home, 0]
            out_offsets[found, 1] = y - positions[home, 1]
            out_offsets[found, 2] = turn - (step if own > lower else 0.0)
            found += 1
    return out_rows[:found], out_squares[:found], out_offsets[:found]
