"""What the best pose does not explain: mask and unexpected obstacles (paper, section 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.pose import transform
from numpy.typing import NDArray

THRESHOLD = 0.3
"""m, a range shorter than predicted by more than this is an obstacle."""
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
) -> ObstacleMask:
    """Obstacles of a scan (B,) at a sensor pose (3,) with predicted ranges (B,), +inf: no wall in sight."""
    seen = np.isfinite(ranges)
    with np.errstate(invalid="ignore"):
        error = np.where(seen, ranges - predicted, np.nan).astype(np.float32)
        error[np.isinf(error)] = np.nan
        shorter = np.where(np.isinf(predicted), False, predicted - ranges > THRESHOLD)
    obstacle = seen & shorter
    mask = np.where(seen, np.where(obstacle, OBSTACLE, EXPLAINED), MISSING).astype(np.uint8)
    known = error[np.isfinite(error)]
    bounded = np.clip(known, -_LARGEST_ERROR, _LARGEST_ERROR)
    energy = float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
    robust = float(np.sqrt(np.mean(bounded**2))) if len(known) else np.inf
    r, angle = ranges[obstacle].astype(np.float64), bearings[obstacle]
    points = np.column_stack([r * np.cos(angle), r * np.sin(angle)])
    confidence = float(np.exp(-0.5 * (robust / USUAL_ERROR) ** 2))
    return ObstacleMask(mask, error, energy, confidence, points, transform(pose, points))
