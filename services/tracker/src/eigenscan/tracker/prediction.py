"""How poses and their covariances move between two scans."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.pose import compose
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.settings import TrackerSettings
from numpy.typing import NDArray

Array = NDArray[np.float64]

CREEP = np.array([0.005, 0.005, 0.002])
"""m, m, rad per sqrt(s): what is never known better, however long the robot stands."""
SLIP_SHARE = 0.5
"""Sigma of an increment that failed the odometry gate, as a share of its size."""


def displacement_growth(seconds: float, v_max: float, turn_max: float) -> Array:
    """W = T^2 v_max (paper, section 7): covariance (3, 3) gained in T seconds without odometry."""
    return np.diag(np.array([v_max, v_max, turn_max]) ** 2) * seconds**2


def motion_noise(moved: Motion, settings: TrackerSettings) -> Array:
    """Covariance (3, 3) of an increment in the base frame."""
    along = settings.odometry_slip**2 * moved.way
    heading = settings.odometry_turn**2 * moved.turn + settings.odometry_veer**2 * moved.way
    noise = np.diag([along, along / 4, heading]) + np.diag(CREEP**2) * abs(moved.seconds)
    noise += np.eye(3) * (SLIP_SHARE * moved.slip) ** 2
    return noise + displacement_growth(max(moved.unknown, 0.0), settings.v_max, settings.turn_max)


def predict(x: Array, C: Array, moved: Motion, settings: TrackerSettings) -> tuple[Array, Array]:
    """Poses (n, 3) and covariances (n, 3, 3) after a motion."""
    moved_x = compose(x, moved.delta)
    cos, sin = np.cos(x[:, 2]), np.sin(x[:, 2])
    F = np.tile(np.eye(3), (len(x), 1, 1))
    F[:, 0, 2] = -sin * moved.delta[0] - cos * moved.delta[1]
    F[:, 1, 2] = cos * moved.delta[0] - sin * moved.delta[1]
    G = np.zeros_like(F)
    G[:, 0, 0] = G[:, 1, 1] = cos
    G[:, 0, 1], G[:, 1, 0], G[:, 2, 2] = -sin, sin, 1.0
    Q = motion_noise(moved, settings)
    grown = F @ C @ np.swapaxes(F, 1, 2) + G @ Q @ np.swapaxes(G, 1, 2)
    return moved_x, (grown + np.swapaxes(grown, 1, 2)) / 2
