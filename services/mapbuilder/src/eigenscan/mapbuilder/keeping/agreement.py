"""Measures how well a view agrees with the map: much disagreement shows a wrong pose."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.gridmap import OCCUPIED, GridMap
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.keeping.change import TOLERANCE
from eigenscan.mapbuilder.keeping.view import MARGIN, View
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

ASIDE = np.array([[0.1, 0.0], [-0.1, 0.0], [0.0, 0.1], [0.0, -0.1]])
"""m that a pose may be off; a view that this explains contradicts nothing."""
LONGEST_ERROR = 0.5
"""m between a beam and its prediction, beyond which it ends at another wall."""


class Agreement:
    """Compares views with one map."""

    def __init__(self, grid: GridMap) -> None:
        self._grid, self._caster = grid, RayCaster.of(grid)
        reach = max(1, round(TOLERANCE / grid.resolution))
        # a disc rather than a square: a pose that is turned must not agree along the diagonals
        row, column = np.ogrid[-reach : reach + 1, -reach : reach + 1]
        self._near = binary_dilation(grid.cells == OCCUPIED, row**2 + column**2 <= reach**2)

    def contradicts(self, view: View) -> NDArray[np.bool_]:
        """Which beams (B,) went through a wall, also for a slightly wrong pose; no grazing beams."""
        poses = np.repeat(view.pose[None], len(ASIDE), axis=0)
        poses[:, :2] += ASIDE
        predicted = self._caster.cast(poses, view.bearings, view.ranges)
        return np.asarray((predicted < view.ranges - 2 * MARGIN).all(axis=0))

    def share(self, view: View) -> float:
        """Share of the beams that end at the predicted wall; 0 without any beam."""
        if not len(view.ranges):
            return 0.0
        predicted = self._caster.cast(view.pose, view.bearings, view.ranges + 2 * LONGEST_ERROR)[0]
        column, row = np.floor(self._grid.to_grid(view.points())).astype(np.int64).T
        height, width = self._near.shape
        on_map = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        on_map[on_map] = self._near[row[on_map], column[on_map]]
        return float(np.mean(on_map & (np.abs(predicted - view.ranges) < LONGEST_ERROR)))
