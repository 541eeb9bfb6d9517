"""How well a look agrees with the map: who disagrees much is not where it says it is."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.gridmap import OCCUPIED, GridMap
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.keeping.change import TOLERANCE
from eigenscan.mapbuilder.keeping.look import MARGIN, Look
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

ASIDE = np.array([[0.1, 0.0], [-0.1, 0.0], [0.0, 0.1], [0.0, -0.1]])
"""m that a pose may be off: what a look from there would explain contradicts nothing."""
LONGEST_ERROR = 0.5
"""m between a beam and what the map foretells, beyond which it ends at another wall than the one foretold."""


class Agreement:
    """Compares looks with one map."""

    def __init__(self, grid: GridMap) -> None:
        self._grid, self._caster = grid, RayCaster.of(grid)
        reach = max(1, round(TOLERANCE / grid.resolution))
        # a disc rather than a square: a pose that is turned must not agree along the diagonals
        row, column = np.ogrid[-reach : reach + 1, -reach : reach + 1]
        self._near = binary_dilation(grid.cells == OCCUPIED, row**2 + column**2 <= reach**2)

    def contradicts(self, look: Look) -> NDArray[np.bool_]:
        """Which beams (B,) went through a wall, even if the pose is a little off: no beam that grazes one."""
        poses = np.repeat(look.pose[None], len(ASIDE), axis=0)
        poses[:, :2] += ASIDE
        foretold = self._caster.cast(poses, look.bearings, look.ranges)
        return np.asarray((foretold < look.ranges - 2 * MARGIN).all(axis=0))

    def share(self, look: Look) -> float:
        """Share of the beams that end at the wall that the map foretells; 0 where there is no beam."""
        if not len(look.ranges):
            return 0.0
        foretold = self._caster.cast(look.pose, look.bearings, look.ranges + 2 * LONGEST_ERROR)[0]
        column, row = np.floor(self._grid.to_grid(look.points())).astype(np.int64).T
        height, width = self._near.shape
        on_map = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        on_map[on_map] = self._near[row[on_map], column[on_map]]
        return float(np.mean(on_map & (np.abs(foretold - look.ranges) < LONGEST_ERROR)))
