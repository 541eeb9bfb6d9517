"""The ROS 2 topics and services of the bridge, with their quality of service."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from eigenscan.ros_bridge.cdr import (
    BOND,
    DIAGNOSTICS,
    IMU,
    LASER_SCAN,
    OCCUPANCY_GRID,
    ODOMETRY,
    PARTICLE_CLOUD,
    POINT_CLOUD,
    POSE_WITH_COVARIANCE,
    STRING,
    TRANSFORMS,
    TRANSITION_EVENT,
)
from eigenscan.ros_bridge.service_types import (
    AVAILABLE_STATES,
    AVAILABLE_TRANSITIONS,
    CHANGE_STATE,
    DESCRIBE_PARAMETERS,
    EMPTY_SERVICE,
    GET_PARAMETER_TYPES,
    GET_PARAMETERS,
    GET_STATE,
    LIST_PARAMETERS,
    SET_INITIAL_POSE,
    SET_PARAMETERS,
)
from eigenscan.ros_bridge.settings import RosBridgeSettings, qualified

NODE = "eigenscan"
"""The bridge's own name in ROS 2's graph."""


class Role(Enum):
    """Roles of an endpoint, with ROS 2's names for them on Zenoh."""

    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"


@dataclass(frozen=True)
class Qos:
    """As in ROS 2; history is always the last `depth`."""

    depth: int
    reliable: bool = True
    transient_local: bool = False


@dataclass(frozen=True)
class Endpoint:
    """One topic or service. `name` is fully qualified, with its slash before it."""

    name: str
    kind: str
    role: Role
    qos: Qos
    node: str = NODE

    @property
    def chunk(self) -> str:
        """The name as one chunk of a key."""
        return self.name.replace("/", "%")


_SENSOR = Qos(5, reliable=False)
_LATCHED = Qos(1, transient_local=True)
_TF = Qos(100)
_COMMAND = Qos(10)
_PARAMETER = Qos(1000)
_LIFECYCLE = (
    ("get_state", GET_STATE),
    ("change_state", CHANGE_STATE),
    ("get_available_states", AVAILABLE_STATES),
    ("get_available_transitions", AVAILABLE_TRANSITIONS),
)
_PARAMETERS = (
    ("list_parameters", LIST_PARAMETERS),
    ("get_parameters", GET_PARAMETERS),
    ("get_parameter_types", GET_PARAMETER_TYPES),
    ("describe_parameters", DESCRIBE_PARAMETERS),
    ("set_parameters", SET_PARAMETERS),
)


@dataclass(frozen=True)
class Endpoints:
    """All endpoints of one bridge; None for those that are switched off."""

    scans: tuple[Endpoint, ...]
    clouds: tuple[Endpoint, ...]
    odometry: Endpoint | None
    imu: Endpoint | None
    transforms: Endpoint | None
    static_transforms: Endpoint | None
    initial_pose: Endpoint | None
    set_initial_pose: Endpoint | None
    global_localization: Endpoint | None
    nomotion_update: Endpoint | None
    lifecycle: tuple[Endpoint, ...]
    """Services of the lifecycle node that the bridge stands for."""
    parameters: tuple[Endpoint, ...]
    """Services of both nodes, the bridge's own and the lifecycle node."""
    transition: Endpoint | None
    bond: Endpoint | None
    bond_published: Endpoint | None
    pose: Endpoint | None
    map_to_odom: Endpoint | None
    particles: Endpoint | None
    floor: Endpoint | None
    diagnostics: Endpoint | None
    map: Endpoint | None

    def __iter__(self) -> Iterator[Endpoint]:
        yield from self.scans
        yield from self.clouds
        for endpoint in vars(self).values():
            if isinstance(endpoint, Endpoint):
                yield endpoint
        yield from self.lifecycle
        yield from self.parameters


def endpoints(settings: RosBridgeSettings) -> Endpoints:
    """The endpoints of `settings`."""
    node = settings.lifecycle

    def at(name: str, kind: str, role: Role, qos: Qos, of: str = NODE) -> Endpoint | None:
        return Endpoint(qualified(settings.namespace, name), kind, role, qos, of) if name else None

    def received(name: str, kind: str, qos: Qos) -> Endpoint | None:
        return at(name, kind, Role.SUBSCRIPTION, qos)

    def published(name: str, kind: str, qos: Qos) -> Endpoint | None:
        return at(name, kind, Role.PUBLISHER, qos)

    def service(name: str, kind: str) -> Endpoint | None:
        return at(name, kind, Role.SERVICE, _COMMAND)

    def bond(role: Role) -> Endpoint | None:
        return at("bond" if node else "", BOND, role, _COMMAND, node)

    lifecycle = [at(f"{node}/{name}", kind, Role.SERVICE, _COMMAND, node) for name, kind in _LIFECYCLE]
    parameters = [
        at(f"{of}/{name}", kind, Role.SERVICE, _PARAMETER, of)
        for of in dict.fromkeys((NODE, node))
        if of
        for name, kind in _PARAMETERS
    ]
    scans = [received(name, LASER_SCAN, _SENSOR) for name in settings.scan]
    clouds = [received(name, POINT_CLOUD, _SENSOR) for name in settings.points]
    return Endpoints(
        scans=tuple(scan for scan in scans if scan),
        clouds=tuple(cloud for cloud in clouds if cloud),
        odometry=received(settings.odom, ODOMETRY, _COMMAND),
        imu=received(settings.imu, IMU, _SENSOR),
        transforms=received(settings.tf, TRANSFORMS, _TF),
        static_transforms=(
            received(settings.tf_static, TRANSFORMS, Qos(100, transient_local=True))
            if settings.mounts_from_tf
            else None
        ),
        initial_pose=received(settings.initial_pose, POSE_WITH_COVARIANCE, _COMMAND),
        set_initial_pose=service(settings.set_initial_pose, SET_INITIAL_POSE),
        global_localization=service(settings.global_localization, EMPTY_SERVICE),
        nomotion_update=service(settings.nomotion_update, EMPTY_SERVICE),
        lifecycle=tuple(each for each in lifecycle if each and node),
        parameters=tuple(each for each in parameters if each),
        transition=at(f"{node}/transition_event", TRANSITION_EVENT, Role.PUBLISHER, _COMMAND, node)
        if node
        else None,
        bond=bond(Role.SUBSCRIPTION),
        bond_published=bond(Role.PUBLISHER),
        pose=published(settings.pose, POSE_WITH_COVARIANCE, _LATCHED),
        map_to_odom=published(settings.tf if settings.tf_broadcast else "", TRANSFORMS, _TF),
        particles=published(settings.particles, PARTICLE_CLOUD, _SENSOR),
        floor=published(settings.floor, STRING, _LATCHED),
        diagnostics=published(settings.diagnostics, DIAGNOSTICS, _COMMAND),
        map=published(settings.map, OCCUPANCY_GRID, _LATCHED),
    )


class Dialect(Protocol):
    """Keys, liveliness tokens and attachments of one way."""

    def key(self, endpoint: Endpoint) -> str:
        """Key of its messages, or of its queries."""
        ...

    def tokens(self, endpoints: Iterable[Endpoint]) -> Iterator[str]:
        """Keys of the liveliness tokens by which ROS 2's graph knows of the endpoints."""
        ...

    def attachment(self, endpoint: Endpoint, number: int, time: int) -> bytes | None:
        """Zenoh's attachment of message `number` (from 1), published at `time` (ns)."""
        ...

    def reply_attachment(self, request: bytes, time: int) -> bytes | None:
        """Zenoh's attachment of a reply to a request with attachment `request`."""
        ...
