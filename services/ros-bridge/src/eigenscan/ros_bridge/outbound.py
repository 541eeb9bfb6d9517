"""Converts the contract's messages to ROS 2's, as AMCL and a map_server publish them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from eigenscan.geometry.gridmap import UNKNOWN, from_message
from eigenscan.geometry.pose import quaternion
from eigenscan.ros_bridge.cdr import (
    OCCUPANCY_GRID,
    PARTICLE,
    PARTICLE_CLOUD,
    POSE_WITH_COVARIANCE,
    STRING,
    TRANSFORMS,
    encode,
    make,
)
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Tracks
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid


class NotFiniteError(ValueError):
    """A number of another tracker that no robot may act on."""


def pose_with_covariance(estimate: PoseEstimate) -> bytes:
    """PoseWithCovarianceStamped of a pose that is claimed. Raises NotFiniteError."""
    c = estimate.covariance
    _require_finite(c.xx, c.xy, c.xt, c.yy, c.yt, c.tt)
    covariance = np.zeros((6, 6))
    covariance[np.ix_([0, 1, 5], [0, 1, 5])] = [[c.xx, c.xy, c.xt], [c.xy, c.yy, c.yt], [c.xt, c.yt, c.tt]]
    head = header(nanoseconds(estimate.timestamp), estimate.frame_id)
    stated = make("geometry_msgs/msg/PoseWithCovariance", _pose(estimate.pose), covariance.ravel())
    return encode(make(POSE_WITH_COVARIANCE, head, stated))


def floor_name(estimate: PoseEstimate) -> bytes:
    """String: the floor of a pose that is claimed; empty while none is, or it is on no floor."""
    return encode(make(STRING, estimate.floor if estimate.state == STATE_LOCALIZED else ""))


def transforms(transform: FrameTransform, ahead: int) -> bytes:
    """TFMessage of one transform, dated `ahead` ns after its stamp. Raises NotFiniteError."""
    move, turn = transform.translation, transform.rotation
    _require_finite(move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w)
    stamped = make(
        "geometry_msgs/msg/TransformStamped",
        header(nanoseconds(transform.timestamp) + ahead, transform.parent_frame_id),
        transform.child_frame_id,
        make(
            "geometry_msgs/msg/Transform",
            make("geometry_msgs/msg/Vector3", move.x, move.y, move.z),
            make("geometry_msgs/msg/Quaternion", turn.x, turn.y, turn.z, turn.w),
        ),
    )
    return encode(make(TRANSFORMS, [stamped]))


def particle_cloud(tracks: Tracks) -> bytes:
    """ParticleCloud: one particle for each track, its probability the weight. Raises NotFiniteError."""
    _require_finite(*(track.probability for track in tracks.tracks))
    particles = [make(PARTICLE, _pose(track.pose), track.probability) for track in tracks.tracks]
    head = header(nanoseconds(tracks.timestamp), tracks.frame_id)
    return encode(make(PARTICLE_CLOUD, head, particles))


def occupancy_grid(grid: Grid) -> bytes:
    """OccupancyGrid of a map. Raises MapError if the grid is not the contract's."""
    area = from_message(grid)
    # unknown is -1 in ROS; the other values are the same
    cells = np.where(area.cells == UNKNOWN, -1, area.cells.astype(np.int16)).astype(np.int8)
    height, width = area.cells.shape
    x, y, theta = area.origin.tolist()
    head = header(nanoseconds(grid.timestamp), grid.frame_id)
    info = make(
        "nav_msgs/msg/MapMetaData",
        head.stamp,
        area.resolution,
        width,
        height,
        _pose(Pose2(x=x, y=y, theta=theta)),
    )
    return encode(make(OCCUPANCY_GRID, head, info, cells.ravel()))


def header(time: int, frame: str) -> Any:
    """A message's; `time` in ns."""
    stamp = make("builtin_interfaces/msg/Time", time // 1_000_000_000, time % 1_000_000_000)
    return make("std_msgs/msg/Header", stamp, frame)


def _require_finite(*values: float) -> None:
    if not all(map(math.isfinite, values)):
        raise NotFiniteError


def _pose(pose: Pose2) -> Any:
    _require_finite(pose.x, pose.y, pose.theta)
    turn = quaternion(pose.theta)
    return make(
        "geometry_msgs/msg/Pose",
        make("geometry_msgs/msg/Point", pose.x, pose.y, 0.0),
        make("geometry_msgs/msg/Quaternion", 0.0, 0.0, turn.z, turn.w),
    )
