"""The obstacle mask of the paper's section 6: the scan beside its reconstruction from the coefficients."""

from __future__ import annotations

import numpy as np
from eigenscan.eigenspace.embedding import CIRCUMFERENCE
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.pose import transform
from eigenscan.projector.candidates import Candidates
from eigenscan.projector.observation import Observation
from eigenscan.projector.obstacles import EXPLAINED, MISSING, OBSTACLE, ObstacleMask
from eigenscan.projector.site import SensorView
from numpy.typing import NDArray

Array = NDArray[np.float64]


def reconstruction(view: SensorView, found: Candidates, region: int) -> Array:
    """S^ = mean + sum of alpha_n phi_n (J,), m: the scan as a region's components hold it (paper, eq. 3)."""
    alpha, vectors = found.projected.coefficients[region], view.spaces.vectors[region]
    mean = view.spaces.mean[region][:, None]
    scan: Array = mean + np.tensordot(alpha, vectors.astype(np.float64), 1)
    if view.embedding.kind == "range":
        plain: Array = scan[0]
        return plain
    turned: Array = np.arctan2(scan[1], scan[0]) * (CIRCUMFERENCE / TURN)
    return turned


def occluded(
    view: SensorView, seen: Observation, found: Candidates, pose: Array, bearings: Array
) -> ObstacleMask:
    """Mask of a scan (B,): 0 where S^ exceeds S by more than a threshold, 1 elsewhere.

    The threshold is the root mean square error that nearly no scan of the best pose's region exceeds. S^ has
    the beams of the analysis; a beam of the sensor is compared with the nearest of them. `bearings` (B,) rad.
    """
    region = int(found.region[0])
    estimated = reconstruction(view, found, region)
    grid = seen.bearings[1] - seen.bearings[0] if len(seen.bearings) > 1 else 1.0
    nearest = np.rint((bearings - seen.sensor.angle_min) / grid).astype(np.int64).clip(0, len(estimated) - 1)
    returned = np.isfinite(seen.ranges)
    r = np.where(returned, seen.ranges, 0.0).astype(np.float64)
    reach = np.minimum(r, view.embedding.cap)
    foreseen = estimated[nearest]
    if view.embedding.kind == "ring":  # of the ranges at one place of the ring the nearest
        foreseen = foreseen + CIRCUMFERENCE * np.rint((reach - foreseen) / CIRCUMFERENCE)
    error = np.where(returned, reach - foreseen, np.nan)
    threshold = float(np.sqrt(view.usual_error[region]))
    obstacle = returned & (-np.nan_to_num(error) > threshold)
    mask = np.where(returned, np.where(obstacle, OBSTACLE, EXPLAINED), MISSING).astype(np.uint8)
    known = error[returned]
    energy = float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
    confidence = float(np.exp(-0.5 * (energy / threshold) ** 2)) if len(known) else 0.0
    points = np.column_stack([r * np.cos(bearings), r * np.sin(bearings)])[obstacle]
    return ObstacleMask(mask, error.astype(np.float32), energy, confidence, points, transform(pose, points))
