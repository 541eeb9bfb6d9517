"""Converts foxglove's protobuf messages of an MCAP to the equivalent ROS messages."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from eigenscan.workbench.logs.bag import LASER_SCAN, ODOMETRY_MESSAGE, TRANSFORMS, Decoder
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry


def _header(timestamp: Any, frame: str) -> SimpleNamespace:
    return SimpleNamespace(
        stamp=SimpleNamespace(sec=timestamp.seconds, nanosec=timestamp.nanos), frame_id=frame
    )


def _scan(data: bytes) -> SimpleNamespace:
    """Raises ValueError if the scan has a pose within its frame."""
    scan = LaserScan.FromString(data)
    pose = scan.pose
    turned = (pose.orientation.x, pose.orientation.y, pose.orientation.z)
    if any((pose.position.x, pose.position.y, pose.position.z, *turned)):
        raise ValueError("a laser scan away from its frame's origin")
    beams = max(len(scan.ranges) - 1, 1)
    return SimpleNamespace(
        header=_header(scan.timestamp, scan.frame_id),
        angle_min=scan.start_angle,
        angle_max=scan.end_angle,
        angle_increment=(scan.end_angle - scan.start_angle) / beams,
        range_min=0.0,
        range_max=0.0,
        time_increment=0.0,
        ranges=scan.ranges[:],
    )


def _odometry(data: bytes) -> SimpleNamespace:
    odometry = Odometry.FromString(data)
    return SimpleNamespace(
        header=_header(odometry.timestamp, odometry.frame_id),
        child_frame_id=odometry.body_frame_id,
        pose=SimpleNamespace(pose=odometry.pose, covariance=odometry.pose_covariance[:]),
    )


def _transform(item: FrameTransform) -> SimpleNamespace:
    return SimpleNamespace(
        header=_header(item.timestamp, item.parent_frame_id),
        child_frame_id=item.child_frame_id,
        transform=item,
    )


FOXGLOVE: dict[str, tuple[str, Decoder]] = {
    "foxglove.LaserScan": (LASER_SCAN, _scan),
    "foxglove.Odometry": (ODOMETRY_MESSAGE, _odometry),
    "foxglove.FrameTransform": (
        TRANSFORMS,
        lambda data: SimpleNamespace(transforms=[_transform(FrameTransform.FromString(data))]),
    ),
    "foxglove.FrameTransforms": (
        TRANSFORMS,
        lambda data: SimpleNamespace(
            transforms=[_transform(item) for item in FrameTransforms.FromString(data).transforms]
        ),
    ),
}
"""Kind and decoder by schema name."""
