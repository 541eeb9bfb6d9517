"""Places positions more densely where the manifold of scans bends or breaks (paper, section 4).

A panorama is interpolated between the corners of a square of positions. If its error exceeds the bound at the
square's middle or at the middle of a side, the square is cut into four, at most twice: in doorways, around
convex corners, and hardly anywhere else. The error is the root mean square over all directions, so it holds
for the scans of all headings. A projection only shortens, so no coefficient vector has a larger error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.eigenspace.embedding import Embedding
from eigenscan.geometry.gridmap import GridMap
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.plan import Plan
from eigenscan.mapbuilder.positions import Positions, free_positions, standable, stands
from numpy.typing import NDArray

Index = NDArray[np.int64]

HALVINGS = 2
"""Most halvings of the spacing: from 0.5 m, no two positions are closer than 0.125 m."""
_BEAMS = 180
_SQUARES_AT_ONCE = 2000
_CORNERS = np.array([[0, 0], [2, 0], [0, 2], [2, 2]])
_BETWEEN = np.array([[1, 1], [1, 0], [0, 1], [2, 1], [1, 2]])
_WEIGHTS = np.array([[1, 1, 1, 1], [1, 1, 0, 0], [1, 0, 1, 0], [0, 1, 0, 1], [0, 0, 1, 1]], dtype=np.float32)
"""Weights of the corners, at each place between them."""


def adaptive_positions(grid: GridMap, plan: Plan, halvings: int = HALVINGS) -> tuple[Positions, float]:
    """Positions on the grid of `plan.spacing`, and between them if `plan.error` requires it.

    Also the share of the places midway between positions, by area, whose interpolated panorama is within
    `plan.error`. The spacing of the result is the smallest possible one.
    """
    whole = 2 ** (halvings + 1)
    unit = plan.spacing / whole
    scene = _Scene(grid, RayCaster.of(grid), standable(grid, plan.clearance), plan, unit)
    squares = _squares(free_positions(grid, plan.spacing / 2, plan.clearance)) * whole
    kept, within, judged = list[Index](), 0.0, 0.0
    for block in np.array_split(squares, -(-len(squares) // _SQUARES_AT_ONCE) or 1):
        for level in range(halvings + 1):
            half = whole >> level + 1
            kept.append((block[:, None] + _CORNERS * half).reshape(-1, 2))
            off = scene.errors(block, half)
            cut = (off > plan.error).any(axis=1) & (level < halvings)
            within += half**2 * np.count_nonzero(off[~cut] <= plan.error)
            judged += half**2 * np.count_nonzero(~np.isnan(off[~cut]))
            block = (block[cut][:, None] + _CORNERS * (half // 2)).reshape(-1, 2)  # noqa: PLW2901
    index = np.unique(np.concatenate(kept)[:, ::-1] // 2, axis=0)[:, ::-1].astype(np.int32)
    free = Positions(index, np.zeros(2), 2 * unit)
    return free.at(np.nonzero(stands(grid, scene.place, free.points))[0]), within / max(judged, 1.0)


def _squares(half_grid: Positions) -> Index:
    """Lower left corners (S, 2), in whole spacings, of the squares that hold a point of the half grid."""
    low = half_grid.index.astype(np.int64) // 2
    # a point on a side belongs to the squares on both of its sides
    around = [low - np.array([dx, dy]) * (half_grid.index % 2 == 0) for dx in (0, 1) for dy in (0, 1)]
    return np.unique(np.concatenate(around), axis=0)


@dataclass(frozen=True)
class _Scene:
    grid: GridMap
    caster: RayCaster
    place: NDArray[np.bool_]
    plan: Plan
    unit: float

    def errors(self, squares: Index, half: int) -> NDArray[np.float64]:
        """Errors (S, 5), m, between the corners of squares (S, 2) of side 2 * `half`, in units of `unit` m.

        NaN for an occupied place; +inf if all the corners for its interpolation are occupied.
        """
        if not len(squares):
            return np.empty((0, len(_BETWEEN)))
        index = squares[:, None] + np.concatenate([_CORNERS, _BETWEEN]) * half
        held, where = np.unique(index.reshape(-1, 2), axis=0, return_inverse=True)
        points = held * self.unit
        free = stands(self.grid, self.place, points)
        values = np.zeros((len(held), _BEAMS), dtype=np.float32)
        seen = self.caster.panoramas(points[free], _BEAMS, self.plan.range_max, self.plan.threads)
        values[free] = Embedding("range", self.plan.analysis.embedding.cap)(seen)[0]
        corner, between = np.split(where.reshape(-1, len(_CORNERS) + len(_BETWEEN)), [len(_CORNERS)], axis=1)
        weights = _WEIGHTS * free[corner][:, None]
        known = weights.sum(axis=2, keepdims=True)
        mixed = (weights / np.maximum(known, 1.0)) @ values[corner]
        off = np.sqrt(np.mean((mixed - values[between]) ** 2, axis=2, dtype=np.float64))
        off[known[..., 0] == 0.0] = np.inf
        off[~free[between]] = np.nan
        return off
