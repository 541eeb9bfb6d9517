"""Association by a tree: the K nearest poses, none outside the volume that still counts (paper, 5.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.projector.association.manifold import Array, Association, Index, Matches, Sheets
from scipy.spatial import cKDTree

_NODE_BYTES = 72
"""Bytes of a node of scipy's tree: bounds, children and counts."""


@dataclass(frozen=True)
class Trees(Association):
    """A tree over all coefficients for each region; its poses are counted from `bounds` (R + 1,)."""

    trees: tuple[cKDTree, ...]
    bounds: Index

    @classmethod
    def of(cls, regions: list[Sheets], _margin: float = 0.0) -> Trees:
        """Trees of all poses of the regions."""
        # the midpoint split builds in a fraction of the time and is as quick on such data
        trees = tuple(
            cKDTree(region.coefficients.reshape(region.rows, -1), balanced_tree=False, compact_nodes=False)
            for region in regions
        )
        return cls(trees, np.cumsum([0, *(region.rows for region in regions)]))

    @property
    def nbytes(self) -> int:
        """Memory of the index, bytes."""
        return sum(t.data.nbytes + t.indices.nbytes + t.size * _NODE_BYTES for t in self.trees)

    def nearest(self, alphas: Array, residuals: Array, count: int) -> Matches:
        """The `count` nearest of all poses; see Association.

        The volume shrinks from region to region, the best explained one first: a region whose error alone is
        larger than what was found does not have to be looked at.
        """
        rows, squares = np.empty(0, dtype=np.int64), np.empty(0)
        reach = np.inf
        for r in np.argsort(residuals, kind="stable"):
            if residuals[r] >= reach:
                break
            tree = self.trees[r]
            distance, own = tree.query(
                alphas[r],
                k=np.arange(1, min(count, tree.n) + 1),
                distance_upper_bound=np.sqrt(reach - residuals[r]),
            )
            found = np.isfinite(distance)
            rows = np.concatenate([rows, own[found] + self.bounds[r]])
            squares = np.concatenate([squares, distance[found] ** 2 + residuals[r]])
            if len(rows) >= count:
                kept = np.argpartition(squares, count - 1)[:count]
                rows, squares = rows[kept], squares[kept]
                reach = float(squares.max())
        return Matches(rows, squares.astype(np.float32)).best(count)
