"""A ROS 2 robot on a DDS, as its RMW has it: Cyclone DDS says and hears ROS 2's topics, types and services.

Types, CDR and discovery are Cyclone's own. Names are ROS 2's: `rt/` before topics, `rq/…Request` and
`rr/…Reply` around services, and who is who on `ros_discovery_info`.
"""

import time
from dataclasses import dataclass
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int8, int32, int64, sequence, uint8, uint32, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

CYCLONE = """<CycloneDDS><Domain>
  <General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
    <AllowMulticast>false</AllowMulticast></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>30</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
"""CYCLONEDDS_URI for all processes: this machine only."""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class LaserScan(IdlStruct, typename="sensor_msgs::msg::dds_::LaserScan_"):
    header: Header
    angle_min: float32
    angle_max: float32
    angle_increment: float32
    time_increment: float32
    scan_time: float32
    range_min: float32
    range_max: float32
    ranges: sequence[float32]
    intensities: sequence[float32]


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class PoseWithCovarianceStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovarianceStamped_"):
    header: Header
    pose: PoseWithCovariance


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
class MapMetaData(IdlStruct, typename="nav_msgs::msg::dds_::MapMetaData_"):
    map_load_time: Time
    resolution: float32
    width: uint32
    height: uint32
    origin: Pose


@dataclass
class OccupancyGrid(IdlStruct, typename="nav_msgs::msg::dds_::OccupancyGrid_"):
    header: Header
    info: MapMetaData
    data: sequence[int8]


@dataclass
class Particle(IdlStruct, typename="nav2_msgs::msg::dds_::Particle_"):
    pose: Pose
    weight: float64


@dataclass
class ParticleCloud(IdlStruct, typename="nav2_msgs::msg::dds_::ParticleCloud_"):
    header: Header
    particles: sequence[Particle]


@dataclass
class GetStateRequest(IdlStruct, typename="lifecycle_msgs::srv::dds_::GetState_Request_"):
    """Behind the client's id and the request's number, which Cyclone's RMW puts before all requests."""

    client: uint64
    number: int64
    structure_needs_at_least_one_member: uint8


@dataclass
class State(IdlStruct, typename="lifecycle_msgs::msg::dds_::State_"):
    id: uint8
    label: str


@dataclass
class GetStateResponse(IdlStruct, typename="lifecycle_msgs::srv::dds_::GetState_Response_"):
    client: uint64
    number: int64
    current_state: State


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data: array[uint8, 16]


@dataclass
class NodeEntitiesInfo(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[Gid]
    writer_gid_seq: sequence[Gid]


@dataclass
class ParticipantEntitiesInfo(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
    gid: Gid
    node_entities_info_seq: sequence[NodeEntitiesInfo]


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
    """One node, `robot`, on a DDS domain. Its writers and readers are told on `ros_discovery_info`."""

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
        self._tell()
        return writer

    def inputs(self, topic: str, kind: type[Any], qos: Qos = DEFAULT) -> DataReader[Any]:
        """A reader; `topic` is DDS's name."""
        reader = DataReader(self._participant, Topic(self._participant, topic, kind), qos=qos)
        self._readers[topic] = reader
        self._tell()
        return reader

    def _tell(self) -> None:
        node = NodeEntitiesInfo(
            "/",
            "robot",
            [_gid(reader) for reader in self._readers.values()],
            [_gid(writer) for writer in self._writers.values()],
        )
        self._discovery.write(ParticipantEntitiesInfo(_gid(self._participant), [node]))


def _gid(entity: Any) -> Gid:
    return Gid(list(entity.guid.bytes))


def header(frame: str, stamp: int | None = None) -> Header:
    """`stamp` in ns; without it now."""
    return Header(Time(*divmod(time.time_ns() if stamp is None else stamp, 1_000_000_000)), frame)
