"""Measures a map before any robot uses it: thickness of its walls, and the walls in sight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.distance_tiles import distance_tiles
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.raycast import RayCaster
from eigenscan.geometry.surfaces import Surfaces
from numpy.typing import NDArray

IN_SIGHT_M = 20.0
"""Walls farther away, m, do not count as in sight."""
STRIP_M = 1.0
"""Width, m, that a tenth of a map's free ground has at least where robots drive."""
PLACES, BEAMS = 500, 72
"""Most positions, and the directions from each."""


@dataclass(frozen=True)
class Quality:
    """A map's cells, m; the thickness of an ordinary wall, m, and whether walls are thinned for it.

    Then the share of all beams that meet a wall within range, and the median distance, m; NaN if none does.
    """

    cell_m: float
    wall_thickness_m: float
    thinned: bool
    walls_in_sight: float
    usual_range_m: float
    strips: bool
    """Whether most is occupied, and what is free is as narrow as walls: a map that is read inside out."""

    @property
    def expectation(self) -> str:
        """Consequences for localization, as text; empty for an ordinary map."""
        return (
            "thicker than a lidar's error, so models use their middles, and fewer scans are sure; "
            "eigenscan map DRIVE --on MAP draws them as a lidar sees them"
            if self.thinned
            else ""
        )


def quality(grid: GridMap, points: NDArray[np.float64], within: float) -> Quality:
    """Quality of a map, as seen from positions (P, 2), m, as far as `within`, m."""
    surfaces = Surfaces.of(grid)
    chosen = points[np.linspace(0, len(points) - 1, min(len(points), PLACES)).round().astype(np.int64)]
    ranges = RayCaster.of(surfaces.grid).panoramas(chosen, BEAMS, within)
    seen = ranges[np.isfinite(ranges)]
    return Quality(
        cell_m=grid.resolution,
        wall_thickness_m=surfaces.thickness,
        thinned=surfaces.thinned,
        walls_in_sight=float(np.isfinite(ranges).mean()) if ranges.size else 0.0,
        usual_range_m=float(np.median(seen)) if len(seen) else float("nan"),
        strips=_is_of_strips(grid),
    )


def _is_of_strips(grid: GridMap) -> bool:
    free = grid.cells == FREE
    if not free.any() or np.count_nonzero(grid.cells == OCCUPIED) < np.count_nonzero(free):
        return False
    half = STRIP_M / 2 / grid.resolution
    near = sum(np.count_nonzero(free[part] & (away < half)) for part, away in distance_tiles(free, half))
    return bool(near > 0.9 * np.count_nonzero(free))
