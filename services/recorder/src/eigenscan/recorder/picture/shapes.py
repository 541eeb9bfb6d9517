"""Poses and scans as points, arrows and outlines in the map frame."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.pose import FARTHEST_M, Array, compose, from_message, transform
from eigenscan.schemas.scan_pb2 import Scan
from numpy.typing import ArrayLike, NDArray

Array32 = NDArray[np.float32]

MAHALANOBIS_95 = 2.4477
"""Radius of the ellipse that holds 95 % of a Gaussian on the plane: sqrt(chi2.ppf(0.95, 2))."""

BARB = 0.28
"""Length of an arrow's barb, as a share of the arrow's length."""


def is_place(values: ArrayLike) -> bool:
    """Whether all values are numbers that can be drawn."""
    return bool(np.all(np.abs(np.asarray(values, dtype=np.float64)) < FARTHEST_M))


def are_places(rows: Array) -> NDArray[np.bool_]:
    """Which rows (n, k) can be drawn, (n,)."""
    return np.asarray(np.all(np.abs(rows) < FARTHEST_M, axis=-1), dtype=np.bool_)


def lift(points: ArrayLike, height: float) -> Array32:
    """Points (n, 2) as (n, 3) at `height`, m; higher ones cover lower ones."""
    flat = np.asarray(points, dtype=np.float32).reshape(-1, 2)
    return np.column_stack([flat, np.full(len(flat), height, dtype=np.float32)])


def arrows(poses: ArrayLike, length: ArrayLike, height: float) -> Array32:
    """Strips (n, 5, 3) that draw flat arrows of `length`, m, along the headings of `poses` (n, 3).

    The viewer's own arrows are shaded, so their colours are hard to distinguish.
    """
    pose = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    along = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=-1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    reach = np.broadcast_to(np.asarray(length, dtype=np.float64), len(pose))[:, None]
    tail, tip = pose[:, :2], pose[:, :2] + reach * along
    barbs = [tip + BARB * reach * (side * across - along) for side in (1.0, -1.0)]
    strips = np.stack([tail, tip, barbs[0], tip, barbs[1]], axis=1)
    return lift(strips, height).reshape(-1, 5, 3)


def scan_points(scan: Scan, base: ArrayLike) -> Array:
    """Ends of the beams that hit something, (n, 2), map frame, for the robot's base at `base` (3,)."""
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    hit = np.abs(ranges) < FARTHEST_M
    ends = np.stack([np.cos(angles), np.sin(angles)], axis=-1)[hit] * ranges[hit, None]
    return transform(compose(base, from_message(scan.mount)), ends)


def ellipse(pose: ArrayLike, covariance: Array, corners: int = 33) -> Array:
    """Outline (corners, 2) of the 95 % ellipse of the position; a point where it is not positive."""
    centre = np.asarray(pose, dtype=np.float64)[:2]
    variance, axes = np.linalg.eigh(covariance[:2, :2])
    round_it = circle(np.zeros(2), MAHALANOBIS_95, corners)
    outline: Array = centre + (round_it * np.sqrt(np.maximum(variance, 0.0))) @ axes.T
    return outline


def circle(centre: ArrayLike, radius: float, corners: int = 33) -> Array:
    """Outline (corners, 2) of a circle about the position of `centre` (2 or 3,), m."""
    turn = np.linspace(0.0, 2.0 * np.pi, corners)
    outline: Array = np.asarray(centre, dtype=np.float64)[:2] + radius * np.stack(
        [np.cos(turn), np.sin(turn)], axis=-1
    )
    return outline
