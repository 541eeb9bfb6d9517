"""The bridge without its shell: ROS 2's messages become the contract's, and the contract's become ROS 2's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator

from eigenscan.geometry.gridmap import MapError
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.channels import ROS_HEARD, ROS_SAID
from eigenscan.ros_bridge.endpoints import Endpoint, endpoints
from eigenscan.ros_bridge.inbound import frame_name, header_stamp, lidar_names, odometry, raw_scan, relocation
from eigenscan.ros_bridge.mounts import MountError, Mounts
from eigenscan.ros_bridge.outbound import occupancy_grid, particle_cloud, pose_with_covariance, transforms
from eigenscan.ros_bridge.settings import RosBridgeSettings
from eigenscan.schemas.channels import (
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
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Relocation, Tracks
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from google.protobuf.wrappers_pb2 import BytesValue

Hearer = Callable[[bytes], Iterator[Envelope]]


class RosBridgeCore:
    """One robot's bridge. What it hears of ROS and says to it are CDR bytes, by endpoint."""

    hears: tuple[Channel, ...] = (ROS_HEARD, POSE, TRACKS, TRANSFORM, MAP)
    says: tuple[Channel, ...] = (ROS_SAID, SCAN_RAW, ODOMETRY, RELOCATION)

    def __init__(self, settings: RosBridgeSettings) -> None:
        self._address = {"site": settings.site, "robot": settings.robot}
        self._ahead = round(settings.transform_tolerance * 1e9)
        self._ends = endpoints(settings)
        self._mounts = Mounts(settings.base_frame, settings.mounts_from_tf, self._ends.odometry is not None)
        self._counts: Counter[str] = Counter()
        self._lacks = "no scan yet on " + ", ".join(scan.name for scan in self._ends.scans)
        self._hearers = dict(self._make_hearers())

    def start(self) -> Iterable[Envelope]:
        """Nothing is said unasked."""
        return ()

    def handle(self, heard: Envelope) -> Iterable[Envelope]:
        """What the message is on the other side; one that is none there is counted."""
        try:
            if heard.channel is ROS_HEARD:
                data = heard.open(BytesValue).value
                return list(self._hearers[heard.address["endpoint"]](data))
            return list(self._tell_ros(heard))
        except cdr.CdrError:
            self._counts["set_aside_not_cdr"] += 1
        except MapError:
            self._counts["set_aside_not_a_map"] += 1
        return ()

    def finish(self) -> Iterable[Envelope]:
        """Nothing is held back."""
        return ()

    def condition(self) -> Condition:
        """Waiting until scans come through, with what they lack."""
        status = Health.STATUS_WAITING if self._lacks else Health.STATUS_OK
        return Condition(status, self._lacks, dict(self._counts))

    def _make_hearers(self) -> Iterator[tuple[str, Hearer]]:
        names = lidar_names([scan.name for scan in self._ends.scans])
        for scan in self._ends.scans:
            yield scan.chunk, self._scan_hearer(scan, names[scan.name])
        for endpoint, hearer in (
            (self._ends.odometry, self._hear_odometry),
            (self._ends.transforms, self._hear_transforms),
            (self._ends.static_transforms, self._hear_transforms),
            (self._ends.initial_pose, self._hear_initial_pose),
            (self._ends.global_localization, self._hear_global_localization),
        ):
            if endpoint:
                yield endpoint.chunk, hearer

    def _scan_hearer(self, endpoint: Endpoint, lidar: str) -> Hearer:
        def hear(data: bytes) -> Iterator[Envelope]:
            body = cdr.decode(cdr.LASER_SCAN, data)
            try:
                mount, upside_down = self._mounts.of(frame_name(body.header.frame_id))
            except MountError as error:
                self._counts[f"set_aside_{error.reason}"] += 1
                self._lacks = f"{endpoint.name}: {error}"
                return
            self._lacks = ""
            message = raw_scan(body, header_stamp(body.header), mount, upside_down)
            yield Envelope(SCAN_RAW, {**self._address, "lidar": lidar}, message)

        return hear

    def _hear_odometry(self, data: bytes) -> Iterator[Envelope]:
        message = odometry(cdr.decode(cdr.ODOMETRY, data))
        if message is None:
            self._counts["set_aside_odometry_not_a_pose"] += 1
            return
        self._mounts.hear_base(message.body_frame_id)
        yield Envelope(ODOMETRY, self._address, message)

    def _hear_transforms(self, data: bytes) -> Iterator[Envelope]:
        self._mounts.hear(cdr.decode(cdr.TRANSFORMS, data).transforms)
        yield from ()

    def _hear_initial_pose(self, data: bytes) -> Iterator[Envelope]:
        message = relocation(cdr.decode(cdr.POSE_WITH_COVARIANCE, data))
        if message is None:
            self._counts["set_aside_initial_pose_not_a_pose"] += 1
            return
        yield Envelope(RELOCATION, self._address, message)

    def _hear_global_localization(self, _data: bytes) -> Iterator[Envelope]:
        yield Envelope(RELOCATION, self._address, Relocation())

    def _tell_ros(self, heard: Envelope) -> Iterator[Envelope]:
        ends = self._ends
        if heard.channel is POSE and ends.pose:
            estimate = heard.open(PoseEstimate)
            if estimate.state == STATE_LOCALIZED:
                yield _said(ends.pose, pose_with_covariance(estimate))
        elif heard.channel is TRANSFORM and ends.map_to_odom:
            yield _said(ends.map_to_odom, transforms(heard.open(FrameTransform), self._ahead))
        elif heard.channel is TRACKS and ends.particles:
            yield _said(ends.particles, particle_cloud(heard.open(Tracks)))
        elif heard.channel is MAP and ends.map:
            yield _said(ends.map, occupancy_grid(heard.open(Grid)))


def _said(endpoint: Endpoint, data: bytes) -> Envelope:
    return Envelope(ROS_SAID, {"endpoint": endpoint.chunk}, BytesValue(value=data))
