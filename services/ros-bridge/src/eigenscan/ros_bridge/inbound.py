"""Converts ROS 2's messages to the contract's. `body`: a message from `cdr.decode` or from a bag."""

from __future__ import annotations

import math
import re
from collections import defaultdict, deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, MapError
from eigenscan.geometry.message_floats import put_floats
from eigenscan.geometry.pose import covariance_to_message, to_message, to_pose3
from eigenscan.geometry.transforms import FARTHEST
from eigenscan.schemas.envelope import stamp
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.schemas.tracking_pb2 import Relocation
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from numpy.typing import ArrayLike

OCCUPIED_FROM, FREE_BELOW = 65, 20
"""%, as map_server's defaults (occupied_thresh 0.65, free_thresh 0.196); between them nothing is known."""
_SHORTEST = 1e-6
"""Least norm of a quaternion: some ROS nodes publish zeros for an unknown orientation."""
RECENT = 100
"""Scans: ten seconds of a usual lidar, longer than a busy machine delays all of them."""
_PLANAR = np.array([0, 1, 5])
"""x, y and yaw among ROS's x, y, z, roll, pitch, yaw."""


class Stamping:
    """Which drivers stamp a scan when they have received it, not when its first beam was measured.

    A scan can't be received before its last beam was measured. Where one was received within half a sweep of
    its stamp, the stamp is not that of the first beam: so do drivers of SICK, Hokuyo and SLAMTEC lidars
    (benchmarks/deskew.py). Clocks of two machines may differ by more; then the stamp is believed. A clock may
    be set, so only the RECENT scans of a frame count.
    """

    def __init__(self) -> None:
        self._lags: defaultdict[str, deque[int]] = defaultdict(lambda: deque(maxlen=RECENT))
        """By frame, ns from a scan's stamp to when it was received."""

    def after(self, body: Any, time: int, received: int) -> float:
        """Time, s, from the first beam of a LaserScan to its stamp, `time`; it was `received`, both in ns."""
        lags = self._lags[body.header.frame_id]
        lags.append(received - time)
        soonest = min(lags)
        sweep = (len(body.ranges) - 1) * abs(float(body.time_increment))
        return sweep if 2e-9 * abs(soonest) < sweep else 0.0


def raw_scan(
    body: Any, time: int, mount: ArrayLike, upside_down: bool, stamped_after: float = 0.0
) -> RawScan:
    """Converts a LaserScan; `mount` (3,): the sensor in the base frame; `time` in ns, the rest in s."""
    increment = float(body.angle_increment)
    if increment == 0.0 and len(body.ranges) > 1:
        increment = (float(body.angle_max) - float(body.angle_min)) / (len(body.ranges) - 1)
    scan = RawScan(
        timestamp=stamp(time),
        frame_id=frame_name(body.header.frame_id),
        mount=to_message(mount),
        upside_down=upside_down,
        angle_min=float(body.angle_min),
        angle_increment=increment,
        range_min=float(body.range_min),
        range_max=float(body.range_max),
        time_increment=float(body.time_increment),
        stamped_after=stamped_after,
    )
    put_floats(scan, RawScan.RANGES_FIELD_NUMBER, np.asarray(body.ranges, dtype=np.float32))
    return scan


def odometry(body: Any) -> Odometry | None:
    """Converts an Odometry; None if its pose is invalid."""
    pose = on_plane(body.pose.pose.position, body.pose.pose.orientation)
    if pose is None:
        return None
    linear, angular = body.twist.twist.linear, body.twist.twist.angular
    return Odometry(
        timestamp=stamp(header_stamp(body.header)),
        frame_id=frame_name(body.header.frame_id),
        body_frame_id=frame_name(body.child_frame_id),
        pose=to_pose3(pose),
        linear_velocity=Vector3(x=linear.x, y=linear.y, z=linear.z),
        angular_velocity=Vector3(x=angular.x, y=angular.y, z=angular.z),
        pose_covariance=stated_covariance(body.pose.covariance),
    )


def odometry_of_tf(item: Any) -> Odometry | None:
    """Converts a TransformStamped from the odometry frame to the robot's base; None if it is invalid."""
    pose = on_plane(item.transform.translation, item.transform.rotation)
    if pose is None:
        return None
    return Odometry(
        timestamp=stamp(header_stamp(item.header)),
        frame_id=frame_name(item.header.frame_id),
        body_frame_id=frame_name(item.child_frame_id),
        pose=to_pose3(pose),
    )


def relocation(body: Any) -> Relocation | None:
    """Converts an operator's PoseWithCovarianceStamped; None if its pose is invalid."""
    pose = on_plane(body.pose.pose.position, body.pose.pose.orientation)
    if pose is None:
        return None
    message = Relocation(
        timestamp=stamp(header_stamp(body.header)),
        frame_id=frame_name(body.header.frame_id),
        pose=to_message(pose),
    )
    stated = stated_covariance(body.pose.covariance)
    if stated:
        planar = np.reshape(stated, (6, 6))[np.ix_(_PLANAR, _PLANAR)]
        message.covariance.CopyFrom(covariance_to_message(planar))
    return message


def grid_map(body: Any) -> GridMap:
    """Converts an OccupancyGrid, by map_server's thresholds. Raises MapError if it is no map."""
    width, height, resolution = int(body.info.width), int(body.info.height), float(body.info.resolution)
    origin = on_plane(body.info.origin.position, body.info.origin.orientation)
    values = np.asarray(body.data)
    if origin is None or not 0.0 < resolution < 10.0 or width < 1 or values.size != width * height:
        raise MapError(f"{values.size} cells of {resolution:g} m for {width} x {height}: expected a map")
    # -1 is unknown
    cells = np.where(
        values >= OCCUPIED_FROM, OCCUPIED, np.where((values >= 0) & (values < FREE_BELOW), FREE, UNKNOWN)
    )
    return GridMap(cells.astype(np.uint8).reshape(height, width), resolution, np.array(origin))


def on_plane(position: Any, orientation: Any) -> tuple[float, float, float] | None:
    """x, y, yaw of a point and a quaternion, without height and tilt; None if they are invalid.

    It uses plain floats, because odometry is far more frequent than scans.
    """
    at, q = position, orientation
    norm = math.hypot(q.x, q.y, q.z, q.w)
    if not (_SHORTEST < norm < FARTHEST and math.hypot(at.x, at.y) < FARTHEST):
        return None
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z)
    return at.x, at.y, yaw


def stated_covariance(values: Any) -> list[float]:
    """All 36 numbers, row by row; none if they are all zero, which means unknown, or not finite."""
    covariance = np.asarray(values, dtype=np.float64)
    stated: list[float] = covariance.tolist() if np.isfinite(covariance).all() and covariance.any() else []
    return stated


def lidar_names(topics: Sequence[str]) -> dict[str, str]:
    """A name for each topic, one key chunk: `/front/laser/scan` is `front_laser`, `/scan` is `scan`."""
    names: dict[str, str] = {}
    for topic in topics:
        parts = [part for part in re.split(r"[/*$#?@\s]+", topic) if part]
        if len(parts) > 1 and parts[-1] in ("scan", "laser_scan", "points"):
            parts.pop()
        name = "_".join(parts) or "lidar"
        while name in names.values():
            name += "_"
        names[topic] = name
    return names


def frame_name(name: str) -> str:
    """A frame's name without the slash that old logs put before it."""
    return name.lstrip("/")


def header_stamp(header: Any) -> int:
    """Stamp, ns."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)
