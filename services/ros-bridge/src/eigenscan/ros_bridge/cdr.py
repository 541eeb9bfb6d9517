"""ROS 2 messages to and from CDR bytes, and the hashes that tell their types apart."""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

LASER_SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
PARTICLE = "nav2_msgs/msg/Particle"
PARTICLE_CLOUD = "nav2_msgs/msg/ParticleCloud"
EMPTY_SERVICE = "std_srvs/srv/Empty"

EMPTY_REPLY = bytes([0, 1, 0, 0, 0])
"""Little-endian CDR of a message without fields: IDL has no empty structures, so it holds one byte."""

_SERVICE_EVENT = "service_msgs/msg/ServiceEventInfo"


class CdrError(ValueError):
    """Bytes that are no message of the type that they were taken for."""


@cache
def _store() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg("geometry_msgs/Pose pose\nfloat64 weight\n", PARTICLE))
    store.register(
        get_types_from_msg("std_msgs/Header header\nnav2_msgs/Particle[] particles\n", PARTICLE_CLOUD)
    )
    return store


def decode(kind: str, data: bytes) -> Any:
    """The message of type `kind` in `data`. Raises CdrError."""
    try:
        return _store().deserialize_cdr(data, kind)
    except Exception as error:  # the library raises whatever it stumbles over in damaged bytes
        raise CdrError(f"{len(data)} bytes are no {kind}: {error}") from error


def encode(message: Any) -> bytes:
    """Little-endian CDR of a message that was made by `make`."""
    return bytes(_store().serialize_cdr(message, message.__msgtype__))


def make(kind: str, *fields: Any) -> Any:
    """A message of type `kind` from its fields, in order."""
    return _store().types[kind](*fields)


def dds_name(kind: str) -> str:
    """The type's name in DDS: `std_msgs/msg/String` is `std_msgs::msg::dds_::String_`."""
    package, folder, name = kind.split("/")
    return f"{package}::{folder}::dds_::{name}_"


@cache
def type_hash(kind: str) -> str:
    """REP 2011's hash of a message's type, or of an empty service's, such as `RIHS01_64c1…`."""
    if kind == EMPTY_SERVICE:
        return _empty_service_hash(kind)
    return str(_store().hash_rihs01(kind))


def _empty_service_hash(kind: str) -> str:
    """A service is hashed as a message of its request, its response and an event."""
    byte = (Nodetype.BASE, ("uint8", 0))
    request, response, event = f"{kind}_Request", f"{kind}_Response", f"{kind}_Event"

    def named(name: str) -> Any:
        return (Nodetype.NAME, name)

    def at_most_one(name: str) -> Any:
        return (Nodetype.SEQUENCE, (named(name), 1))

    types: dict[str, Any] = {
        _SERVICE_EVENT: [
            ("event_type", byte),
            ("stamp", named("builtin_interfaces/msg/Time")),
            # the library has it as char, which in ROS 2 is another name of uint8
            ("client_gid", (Nodetype.ARRAY, (byte, 16))),
            ("sequence_number", (Nodetype.BASE, ("int64", 0))),
        ],
        request: [("structure_needs_at_least_one_member", byte)],
        response: [("structure_needs_at_least_one_member", byte)],
        event: [
            ("info", named(_SERVICE_EVENT)),
            ("request", at_most_one(request)),
            ("response", at_most_one(response)),
        ],
        kind: [
            ("request_message", named(request)),
            ("response_message", named(response)),
            ("event_message", named(event)),
        ],
    }
    store = get_typestore(Stores.ROS2_HUMBLE)  # a later one refuses another _SERVICE_EVENT
    store.register({name: ([], fields) for name, fields in types.items()})
    return str(store.hash_rihs01(kind))
