"""How poses and their covariances move between two scans."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.pose import compose
from eigenscan.geometry.symmetric import MATRICES, plus, put, triangle
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.planar import Pose
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.symmetric import ROWS, turned
from numba import njit, types
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
    return carry(x, C, moved.delta, motion_noise(moved, settings))


def carry(x: Array, C: Array, delta: Pose, Q: Array) -> tuple[Array, Array]:
    """Poses (n, 3) and covariances (n, 3, 3) after an increment whose noise (3, 3) is in the base frame."""
    step = np.array(delta)
    return compose(x, step), _grown(x, C, step, Q)


_GROWN = types.float64[:, :, ::1](ROWS, MATRICES, types.float64[::1], types.float64[:, ::1])


@njit(_GROWN, cache=True)  # pragma: no cover - compiled
def _grown(x: Array, C: Array, delta: Array, Q: Array) -> Array:
    """F C F' + G Q G' of each pose: F its derivatives by the pose before, G by the increment."""
    out = np.empty((len(x), 3, 3))
    for i in range(len(x)):
        cos, sin = np.cos(x[i, 2]), np.sin(x[i, 2])
        # F is the identity but for these two, in the heading's column; G is the rotation
        u, v = -sin * delta[0] - cos * delta[1], cos * delta[0] - sin * delta[1]
        a, b, c, d, e, f = triangle(C[i])
        of_x = a + 2 * u * c + u * u * f, b + u * e + v * c + u * v * f, c + u * f
        of_y = d + 2 * v * e + v * v * f, e + v * f
        put(plus((*of_x, *of_y, f), turned(triangle(Q), cos, sin)), out[i])
    return out
