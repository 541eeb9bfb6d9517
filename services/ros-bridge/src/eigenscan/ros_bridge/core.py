"""The bridge without its shell: ROS 2's messages become the contract's, and the contract's become ROS 2's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

from eigenscan.geometry.gridmap import MapError
from eigenscan.geometry.normalize import FAULTS, ScanError
from eigenscan.geometry.pose import to_message
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.channels import ROS_ANSWERED, ROS_ASKED, ROS_PUBLISHED, ROS_RECEIVED
from eigenscan.ros_bridge.cloud import CloudError, Slice
from eigenscan.ros_bridge.diagnostics import diagnostics
from eigenscan.ros_bridge.endpoints import NODE, Endpoint, endpoints
from eigenscan.ros_bridge.gathering import LIDAR, Gathering
from eigenscan.ros_bridge.gyroscope import HeadingSum
from eigenscan.ros_bridge.inbound import (
    Stamping,
    frame_name,
    header_stamp,
    lidar_names,
    odometry,
    odometry_of_tf,
    raw_scan,
    relocation,
)
from eigenscan.ros_bridge.lifecycle import Lifecycle
from eigenscan.ros_bridge.mounts import MountError, Mounts
from eigenscan.ros_bridge.outbound import (
    NotFiniteError,
    floor_name,
    occupancy_grid,
    particle_cloud,
    pose_with_covariance,
    transforms,
)
from eigenscan.ros_bridge.parameters import LiveSettings, Parameters
from eigenscan.ros_bridge.service_types import CHANGE_STATE, SET_INITIAL_POSE
from eigenscan.ros_bridge.settings import RosBridgeSettings
from eigenscan.schemas.channels import (
    DEFAULT_ROBOT,
    DEFAULT_SITE,
    HEADING,
    HEALTH,
    MAP,
    ODOMETRY,
    POSE,
    RELOCATION,
    SCAN_RAW,
    TRACKS,
    TRANSFORM,
    Channel,
)
from eigenscan.schemas.envelope import Condition, Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Relocation, Tracks
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from google.protobuf.wrappers_pb2 import BytesValue

ALL = ""
"""Stands for all topics of scans, where what they lack is one thing."""

Receiver = Callable[[bytes], Iterable[Envelope]]
Answerer = Callable[[bytes], tuple[bytes, Iterable[Envelope]]]
"""Function from a request to its response, and the messages to publish."""


class RosBridgeCore:
    """The bridge of one robot. Its messages from and to ROS are CDR bytes, by endpoint."""

    inputs: tuple[Channel, ...] = (ROS_RECEIVED, ROS_ASKED, POSE, TRACKS, TRANSFORM, MAP, HEALTH)
    outputs: tuple[Channel, ...] = (ROS_PUBLISHED, ROS_ANSWERED, SCAN_RAW, ODOMETRY, HEADING, RELOCATION)

    def __init__(
        self, settings: RosBridgeSettings, site: str = DEFAULT_SITE, robot: str = DEFAULT_ROBOT
    ) -> None:
        """`site` and `robot`: names for the contract's keys."""
        self._address = {"site": site, "robot": robot}
        self._settings = LiveSettings(settings)
        self._counts: Counter[str] = Counter()
        self._ends = endpoints(settings)
        self._odom_frame = frame_name(settings.odom_frame) if settings.tf else ""
        self._odometry_in_tf = False
        has_odometry = self._ends.odometry is not None or self._odom_frame != ""
        base_frame = frame_name(settings.base_frame or "") or None
        self._mounts = Mounts(base_frame, settings.mounts_from_tf, has_odometry)
        self._odom_child = ""  # the frame that odometry in tf moves
        self._lifecycle = Lifecycle(settings.lifecycle)
        self._parameters = {
            settings.lifecycle: Parameters.of_amcl(self._settings),
            NODE: Parameters.of_bridge(self._settings),
        }
        self._map_frames: set[str] = set()
        self._tracker_is_there = False
        self._not_taken = self._no_imu = ""
        self._heading = HeadingSum(self._counts)
        self._floor = floor_name(PoseEstimate())
        self._slice = Slice(settings.slice_low, settings.slice_high)
        self._gathering = Gathering(settings.gather) if settings.gather else None
        self._estimate: PoseEstimate | None = None  # since the tracker's last health
        sources = (*self._ends.scans, *self._ends.clouds)
        self._silent = [source.name for source in sources]
        """Topics of which no scan was received."""
        self._spare = [source.name for source in self._ends.scans if settings.points]
        """Those that need not come: beside clouds, for the setting scan always has a topic."""
        self._lacks: dict[str, str] = {}
        """By topic, why its last scan was set aside."""
        self._received, self._stamping = 0, Stamping()
        self._receivers = dict(self._make_receivers())
        self._answerers = dict(self._make_answerers())

    def start(self) -> Iterable[Envelope]:
        """Publishes nothing."""
        return ()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        """Converts a message to the other side; counts one without a counterpart."""
        try:
            if received.channel is ROS_RECEIVED:
                self._received = received.arrived
                data = received.open(BytesValue).value
                return list(self._receivers[received.address["endpoint"]](data))
            if received.channel is ROS_ASKED:
                return self._answer(received)
            return list(self._report_to_ros(received))
        except cdr.CdrError:
            self._counts["set_aside_not_cdr"] += 1
        except MapError:
            self._counts["set_aside_not_a_map"] += 1
        except NotFiniteError:
            self._counts["set_aside_not_finite"] += 1
        return ()

    def finish(self) -> Iterable[Envelope]:
        """Nothing is held back."""
        return ()

    def condition(self) -> Condition:
        """WAITING until scans arrive, with the missing parts, and while a lifecycle manager pauses it."""
        silent = [f"no scan yet on {', '.join(self._silent)}"] if self._silent else []
        lacks = "; ".join([*silent, *self._lacks.values()])
        if not self._lifecycle.active:
            lacks = f"publishes no pose: a lifecycle manager has it {self._lifecycle.state}"
        status = Health.STATUS_WAITING if lacks else Health.STATUS_OK
        return Condition(status, lacks or self._not_taken or self._no_imu, dict(self._counts))

    def _make_receivers(self) -> Iterator[tuple[str, Receiver]]:
        sources = (*self._ends.scans, *self._ends.clouds)
        names = lidar_names([source.name for source in sources])
        for source in sources:
            take = self._scan if source in self._ends.scans else self._scan_of_cloud
            yield source.chunk, self._scan_receiver(source, names[source.name], take)
        for endpoint, receiver in (
            (self._ends.odometry, self._receive_odometry),
            (self._ends.imu, self._receive_imu),
            (self._ends.transforms, self._receive_transforms),
            (self._ends.static_transforms, self._receive_transforms),
            (self._ends.initial_pose, self._receive_initial_pose),
            (self._ends.bond, self._receive_bond),
        ):
            if endpoint:
                yield endpoint.chunk, receiver

    def _make_answerers(self) -> Iterator[tuple[str, Answerer]]:
        ends = self._ends
        if ends.set_initial_pose:
            yield ends.set_initial_pose.chunk, self._set_initial_pose
        if ends.global_localization:
            anywhere = Envelope(RELOCATION, self._address, Relocation())
            yield ends.global_localization.chunk, lambda _request: (cdr.EMPTY_RESPONSE, [anywhere])
        if ends.nomotion_update:
            yield ends.nomotion_update.chunk, lambda _request: (cdr.EMPTY_RESPONSE, [])
        for end in ends.lifecycle:
            yield end.chunk, partial(self._answer_lifecycle, end.kind)
        for end in ends.parameters:
            yield end.chunk, partial(self._answer_parameters, self._parameters[end.node], end.kind)

    def _scan_receiver(self, endpoint: Endpoint, lidar: str, take: Callable[[Any], RawScan]) -> Receiver:
        def receive(data: bytes) -> Iterator[Envelope]:
            self._silent = [
                name for name in self._silent if name != endpoint.name and name not in self._spare
            ]
            try:
                body = cdr.decode(endpoint.kind, data)
            except cdr.CdrError:
                self._lacks[endpoint.name] = (
                    f"{endpoint.name}: its messages are no {endpoint.kind}: name a topic of that type"
                )
                raise
            self._lacks.pop(ALL, None)
            try:
                message = take(body)
            except (MountError, CloudError) as error:
                self._counts[f"set_aside_{error.reason}"] += 1
                self._lacks[endpoint.name] = f"{endpoint.name}: {error}"
                return
            self._lacks.pop(endpoint.name, None)
            if self._gathering is None:
                yield Envelope(SCAN_RAW, {**self._address, "lidar": lidar}, message)
            else:
                yield from self._gathered(self._gathering, endpoint.name, message)

        return receive

    def _gathered(self, gathering: Gathering, topic: str, message: RawScan) -> Iterator[Envelope]:
        if not gathering.knows(message):
            self._counts["set_aside_no_odometry"] += 1
            self._lacks[ALL] = "no odometry of the scans' time yet, to gather them by"
            return
        try:
            gathered = gathering.gather(message)
        except ScanError as error:
            self._counts[f"set_aside_{error.reason}"] += 1
            self._lacks[topic] = f"{topic}: {FAULTS[error.reason]}"
            return
        if gathered is not None:
            yield Envelope(SCAN_RAW, {**self._address, "lidar": LIDAR}, gathered)

    def _scan(self, body: Any) -> RawScan:
        mount, upside_down = self._mounts.of(frame_name(body.header.frame_id))
        time = header_stamp(body.header)
        after = self._stamping.after(body, time, self._received)
        return raw_scan(body, time, mount, upside_down, after)

    def _scan_of_cloud(self, body: Any) -> RawScan:
        matrix = self._mounts.matrix(frame_name(body.header.frame_id))
        message, not_finite = self._slice.scan(body, header_stamp(body.header), matrix)
        self._counts["cloud_points_not_finite"] += not_finite
        return message

    def _receive_odometry(self, data: bytes) -> Iterator[Envelope]:
        if self._odometry_in_tf:  # two tellers of one odometry need not agree
            return
        message = odometry(cdr.decode(cdr.ODOMETRY, data))
        if message is None:
            self._counts["set_aside_odometry_not_a_pose"] += 1
            return
        yield self._moved(message)

    def _receive_imu(self, data: bytes) -> Iterator[Envelope]:
        body = cdr.decode(cdr.IMU, data)
        try:
            matrix = self._mounts.matrix(frame_name(body.header.frame_id))
        except MountError as error:
            self._counts[f"set_aside_imu_{error.reason}"] += 1
            self._no_imu = f"{self._ends.imu.name if self._ends.imu else ''}: {error}"
            return
        self._no_imu = ""
        heading = self._heading.take(body, matrix)
        if heading is not None:
            yield Envelope(HEADING, self._address, heading)

    def _receive_transforms(self, data: bytes) -> Iterator[Envelope]:
        for item in cdr.decode(cdr.TRANSFORMS, data).transforms:
            if not self._odom_frame or frame_name(item.header.frame_id) != self._odom_frame:
                self._mounts.receive(item)
                continue
            message = odometry_of_tf(item)
            if message is None:
                self._counts["set_aside_odometry_not_a_pose"] += 1
            elif not self._is_base(message.body_frame_id):
                self._counts["set_aside_odometry_of_another_frame"] += 1
            else:
                self._odometry_in_tf = True
                yield self._moved(message)

    def _is_base(self, child: str) -> bool:
        """Whether that child of the odometry frame is the robot: a dock or a marker may be one too.

        The first one is, until another one shows that it carries the base or the sensors.
        """
        known = self._odom_child
        if not known or (child != known and self._mounts.carries(child) and not self._mounts.carries(known)):
            self._odom_child = child
        return child == self._odom_child

    def _moved(self, message: Odometry) -> Envelope:
        self._mounts.receive_base(message.body_frame_id)
        if self._gathering is not None:
            self._gathering.receive_odometry(message)
        return Envelope(ODOMETRY, self._address, message)

    def _receive_initial_pose(self, data: bytes) -> Iterable[Envelope]:
        return self._relocated(cdr.decode(cdr.POSE_WITH_COVARIANCE, data))

    def _relocated(self, pose: Any) -> list[Envelope]:
        message = relocation(pose)
        if message is None:
            self._counts["set_aside_initial_pose_not_a_pose"] += 1
            return []
        frame = message.frame_id
        if frame and self._map_frames and frame not in self._map_frames:  # as AMCL does
            self._counts["set_aside_initial_pose_in_another_frame"] += 1
            ours = ", ".join(sorted(self._map_frames))
            self._not_taken = f"a pose in frame {frame} is refused: publish it in {ours} (RViz: Fixed Frame)"
            return []
        self._not_taken = ""
        return [Envelope(RELOCATION, self._address, message)]

    def _receive_bond(self, data: bytes) -> Iterator[Envelope]:
        beat = self._lifecycle.beat(data)
        if beat and self._ends.bond_published:
            yield _published(self._ends.bond_published, beat)

    def _answer(self, asked: Envelope) -> list[Envelope]:
        """Answers every request, because a client would wait without end."""
        answerer = self._answerers[asked.address["endpoint"]]
        because: Iterable[Envelope] = ()
        try:
            response, because = answerer(asked.open(BytesValue).value)
        except cdr.CdrError:
            self._counts["set_aside_not_cdr"] += 1
            response = b""
        return [Envelope(ROS_ANSWERED, asked.address, BytesValue(value=response)), *because]

    def _set_initial_pose(self, request: bytes) -> tuple[bytes, Iterable[Envelope]]:
        body = cdr.decode(f"{SET_INITIAL_POSE}_Request", request)
        return cdr.EMPTY_RESPONSE, self._relocated(body.pose)

    def _answer_lifecycle(self, kind: str, request: bytes) -> tuple[bytes, Iterable[Envelope]]:
        if kind != CHANGE_STATE:
            return self._lifecycle.answer(kind), ()
        was_active = self._lifecycle.active
        response, events = self._lifecycle.change(request)
        end = self._ends.transition
        because = [_published(end, event) for event in events] if end else []
        if self._lifecycle.active and not was_active:
            because += self._start_pose()
        return response, because

    def _start_pose(self) -> list[Envelope]:
        """The pose at the start, if it is known: once the tracker is there, and when AMCL would take it."""
        settings = self._settings.now
        if not (settings.start_known and self._tracker_is_there and self._lifecycle.active):
            return []
        pose = to_message((settings.start_x, settings.start_y, settings.start_yaw))
        return [Envelope(RELOCATION, self._address, Relocation(pose=pose))]

    def _answer_parameters(
        self, parameters: Parameters, kind: str, request: bytes
    ) -> tuple[bytes, Iterable[Envelope]]:
        return parameters.answer(kind, request), ()

    def _report_to_ros(self, received: Envelope) -> Iterator[Envelope]:
        ends = self._ends
        if received.channel is MAP:
            grid = received.open(Grid)
            self._map_frames.add(grid.frame_id)
            if ends.map:
                yield _published(ends.map, occupancy_grid(grid))
            return
        if received.channel is HEALTH:
            health = received.open(Health)
            if self._is_its_tracker(health):
                yield from self._meet_tracker()
            yield from self._diagnose(health)
        elif received.channel is POSE:
            self._estimate = received.open(PoseEstimate)
            yield from self._meet_tracker()  # one of many robots has no robot's name
        if not self._lifecycle.active:
            return
        if received.channel is POSE:
            estimate = received.open(PoseEstimate)
            if ends.pose and estimate.state == STATE_LOCALIZED:
                yield _published(ends.pose, pose_with_covariance(estimate))
            floor = floor_name(estimate)
            if ends.floor and floor != self._floor:
                self._floor = floor
                yield _published(ends.floor, floor)
        elif received.channel is TRANSFORM and ends.map_to_odom and self._settings.now.tf_broadcast:
            ahead = round(self._settings.now.transform_tolerance * 1e9)
            yield _published(ends.map_to_odom, transforms(received.open(FrameTransform), ahead))
        elif received.channel is TRACKS and ends.particles:
            yield _published(ends.particles, particle_cloud(received.open(Tracks)))

    def _meet_tracker(self) -> list[Envelope]:
        """The pose at the start, at the first message of the robot's tracker."""
        if self._tracker_is_there:
            return []
        self._tracker_is_there = True
        return self._start_pose()

    def _is_its_tracker(self, health: Health) -> bool:
        return health.service == "tracker" and health.instance == self._address["robot"]

    def _diagnose(self, health: Health) -> Iterator[Envelope]:
        if not self._ends.diagnostics or health.instance != self._address["robot"]:
            return
        estimate = self._estimate
        if health.service == "tracker":
            self._estimate = None
        yield _published(self._ends.diagnostics, diagnostics(health, estimate))


def _published(endpoint: Endpoint, data: bytes) -> Envelope:
    return Envelope(ROS_PUBLISHED, {"endpoint": endpoint.chunk}, BytesValue(value=data))
