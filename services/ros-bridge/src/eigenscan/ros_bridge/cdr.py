"""Converts ROS 2 messages to and from CDR bytes, and holds their type hashes."""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

from eigenscan.ros_bridge.service_types import SERVICES, request_and_response, service_hash
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

LASER_SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
PARTICLE = "nav2_msgs/msg/Particle"
PARTICLE_CLOUD = "nav2_msgs/msg/ParticleCloud"
TRANSITION_EVENT = "lifecycle_msgs/msg/TransitionEvent"
BOND = "bond/msg/Status"
STRING = "std_msgs/msg/String"
IMU = "sensor_msgs/msg/Imu"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"

EMPTY_RESPONSE = bytes([0, 1, 0, 0, 0])
"""Little-endian CDR of a message without fields: one byte stands in for them."""

_TEXTS = {
    PARTICLE: "geometry_msgs/Pose pose\nfloat64 weight\n",
    PARTICLE_CLOUD: "std_msgs/Header header\nnav2_msgs/Particle[] particles\n",
    BOND: "std_msgs/Header header\nstring id\nstring instance_id\nbool active\n"
    "float32 heartbeat_timeout\nfloat32 heartbeat_period\n",
}
"""Those that the library lacks."""


class CdrError(ValueError):
    """Bytes that are no message of the type that they were taken for, or a message that has no bytes."""


@cache
def _store() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _TEXTS.items():
        store.register(get_types_from_msg(text, name))
    for kind in SERVICES:
        store.register(request_and_response(kind))
    return store


def decode(kind: str, data: bytes) -> Any:
    """The message of type `kind` in `data`. Raises CdrError."""
    try:
        return _store().deserialize_cdr(data, kind)
    except Exception as error:  # the library raises many errors for damaged bytes
        raise CdrError(f"{len(data)} bytes are no {kind}: {error}") from error


def encode(message: Any) -> bytes:
    """Little-endian CDR of a message that was made by `make`. Raises CdrError."""
    try:
        return bytes(_store().serialize_cdr(message, message.__msgtype__))
    except struct.error as error:  # a number that its field cannot hold, such as a stamp after 2038
        raise CdrError(f"cannot be a {message.__msgtype__}: {error}") from error


def make(kind: str, *fields: Any) -> Any:
    """A message of type `kind` from its fields, in order."""
    return _store().types[kind](*fields)


def dds_name(kind: str) -> str:
    """The type's name in DDS: `std_msgs/msg/String` is `std_msgs::msg::dds_::String_`."""
    package, folder, name = kind.split("/")
    return f"{package}::{folder}::dds_::{name}_"


@cache
def type_hash(kind: str) -> str:
    """REP 2011's hash of a message's or a service's type, such as `RIHS01_64c1…`."""
    return service_hash(kind) if kind in SERVICES else str(_store().hash_rihs01(kind))
