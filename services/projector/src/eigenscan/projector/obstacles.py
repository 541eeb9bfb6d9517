"""What the best pose does not explain: mask and unexpected obstacles (paper, section 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.gridmap import FREE, GridMap
from eigenscan.geometry.pose import transform
from eigenscan.projector.wall_field import WallField
from numpy.typing import NDArray

THRESHOLD = 0.2
"""m, a beam that ends by more than this before its wall, and off every wall, is on an obstacle: the size from
which obstacles matter. Off every wall: beside a corner or along a wall a small error of the pose is a large
one of the range.
"""
EXPLAINED, OBSTACLE, MISSING = 1, 0, 255
USUAL_ERROR = 0.5
"""m, root mean square of an error vector at which the confidence has fallen to exp(-1/2)."""
_LARGEST_ERROR = 1.0


@dataclass(frozen=True)
class ObstacleMask:
    """Mask (B,) uint8 and error (B,) m of a scan at a pose; obstacles (n, 2), m."""

    mask: NDArray[np.uint8]
    error: NDArray[np.float32]
    error_energy: float
    confidence: float
    in_sensor: NDArray[np.float64]
    in_map: NDArray[np.float64]


def find_obstacles(
    pose: NDArray[np.float64],
    bearings: NDArray[np.float64],
    ranges: NDArray[np.float32],
    predicted: NDArray[np.float32],
    walls: WallField,
    grid: GridMap,
) -> ObstacleMask:
    """Obstacles of a scan (B,) at a sensor pose (3,) with predicted ranges (B,), +inf: no wall in sight.

    Where no wall is in sight an end point on free ground is on an obstacle; off the known map it is nothing.
    """
    seen = np.isfinite(ranges)
    with np.errstate(invalid="ignore"):
        error = np.where(seen, ranges - predicted, np.nan).astype(np.float32)
        error[np.isinf(error)] = np.nan
        short = np.flatnonzero(seen & (predicted - ranges > THRESHOLD))
    # of a beam that reaches its wall no more is asked: mostly they are few
    r, bearing = ranges[short].astype(np.float64), bearings[short]
    points = np.column_stack([r * np.cos(bearing), r * np.sin(bearing)])
    ends = transform(pose, points)
    inside = np.isfinite(predicted[short]) | (grid.at(ends) == FREE)
    on_it = inside & (walls.at(ends) > THRESHOLD)
    obstacle = np.zeros(len(ranges), dtype=bool)
    obstacle[short[on_it]] = True
    mask = np.where(seen, np.where(obstacle, OBSTACLE, EXPLAINED), MISSING).astype(np.uint8)
    known = error[np.isfinite(error)]
    bounded = np.minimum(np.abs(known), np.float32(_LARGEST_ERROR))
    energy = float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
    robust = float(np.sqrt(np.mean(bounded**2))) if len(known) else np.inf
    confidence = float(np.exp(-0.5 * (robust / USUAL_ERROR) ** 2))
    return ObstacleMask(mask, error, energy, confidence, points[on_it], ends[on_it])
