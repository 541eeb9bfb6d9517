"""How poses and their covariances move between two scans."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.inner import inner
from eigenscan.geometry.symmetric import MATRICES, Column, Triangle, plus, put, triangle
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.planar import Pose
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.symmetric import ROWS, turned, wrapped
from numba import njit, types
from numpy.typing import NDArray

Array = NDArray[np.float64]

CREEP = (0.005, 0.005, 0.002)
"""m, m, rad per sqrt(s): what is never known better, however long the robot stands."""
SLIP_SHARE = 0.5
"""Sigma of an increment that failed the odometry gate, as a share of its size."""


def motion_noise(moved: Motion, settings: TrackerSettings) -> Pose:
    """Variances of an increment in the base frame: ahead, aside, turn.

    Time without odometry adds W = T^2 v_max^2 (paper, section 7).
    """
    along = settings.odometry_slip**2 * moved.way
    heading = settings.odometry_turn**2 * moved.turn + settings.odometry_veer**2 * moved.way
    slip, seconds, unknown = (SLIP_SHARE * moved.slip) ** 2, abs(moved.seconds), max(moved.unknown, 0.0)
    way = slip + (settings.v_max * unknown) ** 2
    turn = slip + (settings.turn_max * unknown) ** 2
    x, y, theta = (creep**2 * seconds for creep in CREEP)
    return along + x + way, along / 4 + y + way, heading + theta + turn


def predict(x: Array, C: Array, moved: Motion, settings: TrackerSettings) -> tuple[Array, Array]:
    """Poses (n, 3) and covariances (n, 3, 3) after a motion."""
    carried: tuple[Array, Array] = _carried(x, C, moved.delta, motion_noise(moved, settings))
    return carried


_POSES = types.Tuple((types.float64[:, ::1], types.float64[:, :, ::1]))


@inner()  # pragma: no cover - compiled
def carried(x: Array, C: Triangle, delta: Column, Q: Triangle) -> tuple[Column, Triangle]:
    """A pose (3,) after an increment, and F C F' + G Q G'.

    F holds the derivatives by the pose before, G those by the increment.
    """
    ahead, left, turn = delta
    cos, sin = np.cos(x[2]), np.sin(x[2])
    u, v = -sin * ahead - cos * left, cos * ahead - sin * left
    # F is the identity but for these two, in the heading's column; G is the rotation
    a, b, c, d, e, f = C
    of_x = a + 2 * u * c + u * u * f, b + u * e + v * c + u * v * f, c + u * f
    of_y = d + 2 * v * e + v * v * f, e + v * f
    moved = x[0] + v, x[1] - u, wrapped(x[2] + turn)
    return moved, plus((of_x[0], of_x[1], of_x[2], of_y[0], of_y[1], f), turned(Q, cos, sin))


@njit(  # pragma: no cover - compiled
    _POSES(ROWS, MATRICES, types.UniTuple(types.float64, 3), types.UniTuple(types.float64, 3)), cache=True
)
def _carried(x: Array, C: Array, delta: Pose, noise: Pose) -> tuple[Array, Array]:
    moved, out = np.empty((len(x), 3)), np.empty((len(x), 3, 3))
    Q = (noise[0], 0.0, 0.0, noise[1], 0.0, noise[2])
    for i in range(len(x)):
        pose, covariance = carried(x[i], triangle(C[i]), delta, Q)
        moved[i, 0], moved[i, 1], moved[i, 2] = pose
        put(covariance, out[i])
    return moved, out
