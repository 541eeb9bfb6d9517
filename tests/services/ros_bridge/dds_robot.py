"""A ROS 2 robot on a DDS, as its RMW has it: Cyclone DDS has ROS 2's topics, types and services.

Types, CDR and discovery are Cyclone's own. Names are ROS 2's: `rt/` before topics, `rq/…Request` and
`rr/…Reply` around services, and who is who on `ros_discovery_info`.
"""

import time
from dataclasses import dataclass
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, types
from cyclonedds.idl.types import int64, uint8, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from tests.services.ros_bridge.ros_structs import Structs

CYCLONE = """<CycloneDDS><Domain>
  <General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
    <AllowMulticast>false</AllowMulticast></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>30</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
"""CYCLONEDDS_URI for all processes: this machine only."""


STRUCTS = Structs(IdlStruct, types)
Time, Header = STRUCTS["builtin_interfaces/msg/Time"], STRUCTS["std_msgs/msg/Header"]
LaserScan, Odometry = STRUCTS["sensor_msgs/msg/LaserScan"], STRUCTS["nav_msgs/msg/Odometry"]
MapMetaData, OccupancyGrid = STRUCTS["nav_msgs/msg/MapMetaData"], STRUCTS["nav_msgs/msg/OccupancyGrid"]
Particle, ParticleCloud = STRUCTS["nav2_msgs/msg/Particle"], STRUCTS["nav2_msgs/msg/ParticleCloud"]
TFMessage, State = STRUCTS["tf2_msgs/msg/TFMessage"], STRUCTS["lifecycle_msgs/msg/State"]
(
    Vector3,
    Point,
    Quaternion,
    Pose,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    Twist,
    TwistWithCovariance,
    Transform,
    TransformStamped,
) = (
    STRUCTS[f"geometry_msgs/msg/{name}"]
    for name in (
        "Vector3",
        "Point",
        "Quaternion",
        "Pose",
        "PoseWithCovariance",
        "PoseWithCovarianceStamped",
        "Twist",
        "TwistWithCovariance",
        "Transform",
        "TransformStamped",
    )
)
Gid, NodeEntitiesInfo, ParticipantEntitiesInfo = (
    STRUCTS[f"rmw_dds_common/msg/{name}"] for name in ("Gid", "NodeEntitiesInfo", "ParticipantEntitiesInfo")
)


@dataclass
class GetStateRequest(IdlStruct, typename="lifecycle_msgs::srv::dds_::GetState_Request_"):
    """Behind the client's id and the request's number, which Cyclone's RMW puts before all requests."""

    client: uint64
    number: int64
    structure_needs_at_least_one_member: uint8


@dataclass
class GetStateResponse(IdlStruct, typename="lifecycle_msgs::srv::dds_::GetState_Response_"):
    client: uint64
    number: int64
    current_state: State  # type: ignore[valid-type]


def quality(depth: int, reliable: bool = True, latched: bool = False) -> Qos:
    """ROS 2's, of a publisher or a subscription."""
    return Qos(
        Policy.Reliability.Reliable(duration(seconds=1)) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


SENSOR, DEFAULT, LATCHED = quality(5, reliable=False), quality(10), quality(1, latched=True)


class DdsRobot:
    """One node, `robot`, on a DDS domain. Its writers and readers are reported on `ros_discovery_info`."""

    def __init__(self, domain: int) -> None:
        self._participant = DomainParticipant(domain)
        self._writers: dict[str, DataWriter[Any]] = {}
        self._readers: dict[str, DataReader[Any]] = {}
        about = Topic(self._participant, "ros_discovery_info", ParticipantEntitiesInfo)
        self._discovery = DataWriter(self._participant, about, qos=quality(1, latched=True))

    def outputs(self, topic: str, kind: type[Any], qos: Qos = DEFAULT) -> DataWriter[Any]:
        """A writer; `topic` is DDS's name."""
        writer = DataWriter(self._participant, Topic(self._participant, topic, kind), qos=qos)
        self._writers[topic] = writer
        self._report()
        return writer

    def inputs(self, topic: str, kind: type[Any], qos: Qos = DEFAULT) -> DataReader[Any]:
        """A reader; `topic` is DDS's name."""
        reader = DataReader(self._participant, Topic(self._participant, topic, kind), qos=qos)
        self._readers[topic] = reader
        self._report()
        return reader

    def _report(self) -> None:
        node = NodeEntitiesInfo(
            "/",
            "robot",
            [_gid(reader) for reader in self._readers.values()],
            [_gid(writer) for writer in self._writers.values()],
        )
        self._discovery.write(ParticipantEntitiesInfo(_gid(self._participant), [node]))


def _gid(entity: Any) -> Any:
    return Gid(list(entity.guid.bytes))


def header(frame: str, stamp: int | None = None) -> Any:
    """`stamp` in ns; without it now."""
    return Header(Time(*divmod(time.time_ns() if stamp is None else stamp, 1_000_000_000)), frame)
