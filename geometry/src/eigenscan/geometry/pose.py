"""Poses on the plane, SE(2): arrays (..., 3) of x [m], y [m], theta [rad], theta in [-pi, pi)."""

from __future__ import annotations

from math import atan2, cos, sin

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.schemas.geometry_pb2 import Covariance3, Pose2
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

FARTHEST_M = 1e7
"""m from a frame's origin, at most: the farthest that grid coordinates of the Earth (UTM) reach. Beyond it a
number is an overflow, not a place."""


def compose(a: ArrayLike, b: ArrayLike) -> Array:
    """Pose `b`, given in the frame of `a`, in the frame that `a` is given in; shapes broadcast."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + c * b[..., 0] - s * b[..., 1]
    y = a[..., 1] + s * b[..., 0] + c * b[..., 1]
    return _side_by_side(x, y, wrap(a[..., 2] + b[..., 2]))


def inverse(a: ArrayLike) -> Array:
    """Poses that compose with `a` to the identity; same shape."""
    a = np.asarray(a, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = -c * a[..., 0] - s * a[..., 1]
    y = s * a[..., 0] - c * a[..., 1]
    return _side_by_side(x, y, wrap(-a[..., 2]))


def _side_by_side(*parts: Array) -> Array:
    """Arrays of one shape along a new last axis: np.stack in a third of its time."""
    out = np.empty((*np.shape(parts[0]), len(parts)))
    for i, part in enumerate(parts):
        out[..., i] = part
    return out


def between(a: ArrayLike, b: ArrayLike) -> Array:
    """Pose `b` seen from `a`, so that composing `a` with it gives `b`; shapes broadcast."""
    return compose(inverse(a), b)


def transform(pose: ArrayLike, points: ArrayLike) -> Array:
    """Points (..., 2), given in the frame of `pose` (3,), in the frame that `pose` is given in."""
    x, y, theta = np.asarray(pose, dtype=np.float64)
    array = np.asarray(points, dtype=np.float64)
    # element by element: a matrix product may round a point differently among other points
    ahead = np.cos(theta) * array[..., 0] - np.sin(theta) * array[..., 1]
    aside = np.sin(theta) * array[..., 0] + np.cos(theta) * array[..., 1]
    return _side_by_side(ahead + x, aside + y)


def from_message(message: Pose2) -> Array:
    """Array (3,) of a Pose2."""
    return np.array([message.x, message.y, message.theta])


def to_message(pose: ArrayLike) -> Pose2:
    """Pose2 of an array (3,)."""
    x, y, theta = np.asarray(pose, dtype=np.float64).tolist()
    return Pose2(x=x, y=y, theta=theta)


def covariance_from_message(message: Covariance3) -> Array:
    """Symmetric matrix (3, 3) of a Covariance3."""
    m = message
    return np.array([[m.xx, m.xy, m.xt], [m.xy, m.yy, m.yt], [m.xt, m.yt, m.tt]])


def covariance_to_message(covariance: ArrayLike) -> Covariance3:
    """Covariance3 of a symmetric matrix (3, 3)."""
    c = np.asarray(covariance, dtype=np.float64)
    return Covariance3(
        xx=float(c[0, 0]),
        xy=float(c[0, 1]),
        xt=float(c[0, 2]),
        yy=float(c[1, 1]),
        yt=float(c[1, 2]),
        tt=float(c[2, 2]),
    )


def quaternion(theta: float) -> Quaternion:
    """Rotation by `theta` about z."""
    return Quaternion(z=sin(theta / 2), w=cos(theta / 2))


def yaw(rotation: Quaternion) -> float:
    """Turn about z, rad, of any rotation (REP 103)."""
    q = rotation
    # with each odometry message: numpy takes several times as long for a single number
    return atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))


def to_pose3(pose: ArrayLike) -> Pose:
    """foxglove.Pose of a pose (3,), in the plane z = 0."""
    x, y, theta = np.asarray(pose, dtype=np.float64).tolist()
    return Pose(position=Vector3(x=x, y=y), orientation=quaternion(theta))


def from_pose3(message: Pose) -> Array:
    """Array (3,) of a foxglove.Pose, height and tilt left out."""
    return np.array([message.position.x, message.position.y, yaw(message.orientation)])
