"""Point-to-line alignment of one cloud on another, with a prior (Chen and Medioni 1992; Censi 2008)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.pose import Array, between, compose, transform
from eigenscan.mapbuilder.mapping.cloud import Cloud
from numpy.typing import ArrayLike, NDArray

SIGMA = 0.05
"""Standard deviation of a point from its wall, m: range noise, and walls that are not straight."""
ALIGNED = 0.7
"""Cosine of the angle within which two walls are one; the two faces of a thin wall are opposite."""
AGREE = 0.15
"""m, within which a point lies on the wall that it is matched to."""
REACHES = (0.6, 0.6, 0.4, 0.4, 0.25, 0.25, 0.15, 0.15)
"""m, within which a point looks for its wall: shrinks with the steps."""
FINE = (0.25, 0.15, 0.15, 0.15)
"""The same from a start that is known to be close."""
STRETCH = 4.0
"""Factor by which points count less than independent ones, because a bent wall moves many of them."""
FLOOR = np.diag([0.01, 0.01, np.deg2rad(0.2)]) ** 2
"""Least covariance of an alignment: walls are not flat, and beams not exact."""
WEAKEST = np.diag([1.0, 1.0, 0.5]) ** 2
"""Covariance along undetermined directions, such as along a hallway."""


@dataclass(frozen=True)
class Alignment:
    """`pose` (3,) of the cloud in the reference's frame; `share` 0..1 of its points that lie on walls.

    `covariance` (3, 3) of the pose in the cloud's own frame: of the d in compose(pose, d).
    """

    pose: Array
    covariance: Array
    share: float


def align(
    reference: Cloud,
    cloud: Cloud,
    start: ArrayLike,
    prior: Array | None = None,
    reaches: tuple[float, ...] = REACHES,
) -> Alignment:
    """Pose of `cloud` in the frame of `reference`, from `start` (3,) on.

    `prior` (3, 3): covariance of the start, in the cloud's own frame; without it the points alone decide.
    """
    start = np.asarray(start, dtype=np.float64)
    belief = np.linalg.inv(WEAKEST if prior is None else prior)
    pose, information = start, np.zeros((3, 3))
    for reach in reaches:
        rows, offsets = _lines(reference, cloud, pose, reach)
        # beyond a standard deviation of the reach's half a point counts less and less (Geman-McClure)
        scale = max(reach / 2, SIGMA)
        weights = (scale**2 / (scale**2 + offsets**2)) ** 2 / SIGMA**2
        information = (rows * weights[:, None]).T @ rows
        pull = rows.T @ (weights * offsets)
        if prior is not None:
            pull -= belief @ between(start, pose)
        step = np.linalg.solve(information + belief, pull)
        pose = compose(pose, step)
        if np.hypot(step[0], step[1]) < 1e-4 and abs(step[2]) < 1e-5 and reach == reaches[-1]:
            break
    covariance = np.linalg.inv(information / STRETCH + np.linalg.inv(WEAKEST)) + FLOOR
    return Alignment(pose, covariance, agreement(reference, cloud, pose))


def agreement(reference: Cloud, cloud: Cloud, pose: Array) -> float:
    """Share of the cloud's points that at `pose` (3,) lie on a parallel wall of the reference."""
    return float(np.mean(on_walls(reference, cloud, pose))) if len(cloud.points) else 0.0


def energy(reference: Cloud, cloud: Cloud, pose: Array) -> float:
    """Twice the negative logarithm of how likely the cloud's points are at `pose` (3,); lower is better.

    A point counts at most as one that is AGREE m off (Geman-McClure), as does one that meets no wall.
    """
    _, offsets = _lines(reference, cloud, pose, 2 * AGREE)
    most = (AGREE / SIGMA) ** 2
    each = (offsets / SIGMA) ** 2 / (1 + (offsets / AGREE) ** 2)
    return float((each.sum() + most * (len(cloud.points) - len(offsets))) / STRETCH)


def on_walls(reference: Cloud, cloud: Cloud, pose: Array, within: float = AGREE) -> NDArray[np.bool_]:
    """Which of the cloud's points (K,), at `pose`, are `within` m of a parallel wall of the reference."""
    distance, match = reference.tree.query(transform(pose, cloud.points), distance_upper_bound=within)
    near = np.isfinite(distance)
    match = np.minimum(match, len(reference.points) - 1)
    parallel = np.cos(reference.directions[match] - cloud.directions - pose[2]) > ALIGNED
    blank = (reference.lengths[match] == 0) | (cloud.lengths == 0)
    found: NDArray[np.bool_] = near & (parallel | blank)
    return found


def _lines(reference: Cloud, cloud: Cloud, pose: Array, reach: float) -> tuple[Array, Array]:
    """For each matched point its offset from its wall, and the first derivative by d in compose(pose, d)."""
    points = transform(pose, cloud.points)
    distance, match = reference.tree.query(points, distance_upper_bound=reach)
    match = np.minimum(match, len(reference.points) - 1)
    turned = wrap(reference.directions[match] - cloud.directions - pose[2])
    used = np.isfinite(distance) & (reference.lengths[match] > 0) & (cloud.lengths > 0)
    used &= np.cos(turned) > ALIGNED
    normal, at = reference.normals[match[used]], cloud.points[used]
    offset = np.sum(normal * (reference.points[match[used]] - points[used]), axis=1)
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    x, y = cos * normal[:, 0] + sin * normal[:, 1], cos * normal[:, 1] - sin * normal[:, 0]
    return np.column_stack([x, y, y * at[:, 0] - x * at[:, 1]]), offset
