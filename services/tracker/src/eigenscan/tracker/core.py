"""The tracker without its shell: hypotheses and odometry in; pose, tracks and transform out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite, isnan

import numpy as np
from eigenscan.geometry.pose import (
    covariance_to_message,
    quaternion,
    to_message,
    yaw,
)
from eigenscan.schemas.channels import (
    HEADING,
    HYPOTHESES,
    IN_PLAY,
    MODEL_SET,
    ODOMETRY,
    POSE,
    RELOCATION,
    SCAN_MOTION,
    SEARCH,
    TRACKS,
    TRANSFORM,
    Channel,
)
from eigenscan.schemas.envelope import Condition, Envelope, nanoseconds, stamp
from eigenscan.schemas.geometry_pb2 import Covariance3
from eigenscan.schemas.heading_pb2 import Heading
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import SEARCH_LOCAL, SEARCH_WHOLE, Hypotheses, SearchRequest
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.recently_used import RecentlyUsed
from eigenscan.schemas.scan_pb2 import ScanMotion
from eigenscan.schemas.tracking_pb2 import PoseEstimate, Relocation, Tracks
from eigenscan.tracker.agreement import ScanInterval
from eigenscan.tracker.floors import Building
from eigenscan.tracker.observation import SIGMA_LIMITS, observe
from eigenscan.tracker.planar import IDENTITY, Pose
from eigenscan.tracker.relocation import hint_of
from eigenscan.tracker.robot import Estimate, RobotTracker
from eigenscan.tracker.search import Request
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.velocity_gate import is_possible
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

DEFAULT_BODY_FRAME = "base_link"
DEFAULT_ODOM_FRAME = "odom"
NO_BUILDING = Building()
EARLY = 0.1
"""Of the time between two messages, by which one may come early: stamps jitter."""


class _Pace:
    """Keeps messages apart, by their stamps."""

    def __init__(self, rate_hz: float) -> None:
        self._apart = (1.0 - EARLY) * 1e9 / rate_hz
        self._last: int | None = None

    def is_due(self, stamp: int) -> bool:
        """Whether a message of `stamp`, ns, may follow the last one; also where the clock was set back."""
        return self._last is None or not 0 <= stamp - self._last < self._apart

    def note(self, stamp: int) -> None:
        """One was published."""
        self._last = stamp


@dataclass
class _Tracked:
    """A robot and the names of its frames."""

    tracker: RobotTracker
    transforms: _Pace
    tracks: _Pace
    odom_frame: str = DEFAULT_ODOM_FRAME
    body_frame: str = DEFAULT_BODY_FRAME
    map_frame: str = "map"


class TrackerCore:
    """Hypotheses become one honest pose (paper, section 7); one state per robot."""

    inputs: tuple[Channel, ...] = (HYPOTHESES, ODOMETRY, HEADING, SCAN_MOTION, RELOCATION, MODEL_SET)
    outputs: tuple[Channel, ...] = (POSE, TRACKS, TRANSFORM, SEARCH)

    def __init__(self, settings: TrackerSettings, *, believes_stamps: bool = False) -> None:
        """`believes_stamps`: all come from one program; else one far ahead has to be confirmed."""
        self._settings, self._believes_stamps = settings, believes_stamps
        self._counts: Counter[str] = Counter()
        self._robots: RecentlyUsed[tuple[str, str], _Tracked] = RecentlyUsed()
        self._buildings: dict[str, Building] = {}

    def start(self) -> Iterable[Envelope]:
        """Publishes nothing: a tracker without input knows nothing."""
        return ()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        """Poses and tracks for each hypotheses message whose time has come; a transform for odometry."""
        if received.channel is MODEL_SET:
            building = Building.of(received.open(ModelSet), self._counts)
            self._buildings[received.address["site"]] = building
            return ()
        address = {"site": received.address["site"], "robot": received.address["robot"]}
        robot = self._robot(address)
        if received.channel is ODOMETRY:
            return self._receive_odometry(robot, address, received.open(Odometry))
        if received.channel is HEADING:
            heading = received.open(Heading)
            since, until = nanoseconds(heading.since), nanoseconds(heading.timestamp)
            estimates = robot.tracker.receive_heading(since, until, heading.heading)
            return list(self._publish(address, robot, estimates))
        if received.channel is RELOCATION:
            self._relocate(robot, received.open(Relocation))
            return ()
        if received.channel is SCAN_MOTION:
            self._receive_motion(robot, received.address["lidar"], received.open(ScanMotion))
            return ()
        message = received.open(Hypotheses)
        if message.HasField("motion"):
            self._receive_motion(robot, received.address["lidar"], message.motion)
        seen = observe(message, received.address, self._settings, self._counts)
        self._counts["hypotheses_heard"] += 1
        return list(self._publish(address, robot, robot.tracker.receive(seen)))

    def finish(self) -> Iterable[Envelope]:
        """Estimates for the hypotheses that still waited for odometry."""
        published: list[Envelope] = []
        for (site, name), robot in self._robots.items():
            published.extend(self._publish({"site": site, "robot": name}, robot, robot.tracker.finish()))
        return published

    def condition(self) -> Condition:
        """Waiting until hypotheses come; counters of what was received, published and set aside.

        What is wrong degrades; what is made up for is told.
        """
        if not self._counts["hypotheses_heard"]:
            return Condition(Health.STATUS_WAITING, "no hypotheses", dict(self._counts))
        faults = [
            f"{name}: {robot.tracker.fault}"
            for (_, name), robot in self._robots.items()
            if robot.tracker.fault
        ]
        if faults:
            return Condition(Health.STATUS_DEGRADED, "; ".join(faults[:3]), dict(self._counts))
        notes = [
            f"{name}: {robot.tracker.note}" for (_, name), robot in self._robots.items() if robot.tracker.note
        ]
        return Condition(Health.STATUS_OK, "; ".join(notes[:3]), dict(self._counts))

    def _robot(self, address: Mapping[str, str]) -> _Tracked:
        robot = self._robots.use(
            (address["site"], address["robot"]),
            lambda: _Tracked(
                RobotTracker(self._settings, self._counts, believes_stamps=self._believes_stamps),
                _Pace(self._settings.transform_hz),
                _Pace(self._settings.tracks_hz),
            ),
        )
        robot.tracker.building = self._buildings.get(address["site"], NO_BUILDING)
        return robot

    def _relocate(self, robot: _Tracked, message: Relocation) -> None:
        try:
            robot.tracker.relocate(hint_of(message))
            self._counts["relocated"] += 1
        except ValueError:
            self._counts["relocation_not_a_pose"] += 1

    def _receive_motion(self, robot: _Tracked, lidar: str, message: ScanMotion) -> None:
        c = message.covariance
        moved: Pose | None = None
        since, until = nanoseconds(message.since), nanoseconds(message.timestamp)
        if message.HasField("motion"):
            moved = message.motion.x, message.motion.y, message.motion.theta
            if not (since < until and all(map(isfinite, moved)) and _is_spread(c)):
                self._counts["scan_motion_not_possible"] += 1
                return
            limits = self._settings.v_max, self._settings.turn_max
            if not is_possible(moved, (until - since) / 1e9, *limits):
                self._counts["scan_motion_too_fast"] += 1
                moved = None  # scans of two places, which happen to fit each other somehow
        spread, longest = (c.xx, c.xy, c.yy), message.longest_step
        # who does not state how much is explained states that the scans fit
        explained = message.explained or 1.0
        interval = ScanInterval(
            lidar, since, until, moved, spread, c.tt, message.repeats, longest, message.watched, explained
        )
        robot.tracker.receive_motion(interval)

    def _receive_odometry(
        self, robot: _Tracked, address: Mapping[str, str], message: Odometry
    ) -> list[Envelope]:
        robot.odom_frame = message.frame_id or DEFAULT_ODOM_FRAME
        robot.body_frame = message.body_frame_id or DEFAULT_BODY_FRAME
        at, position = nanoseconds(message.timestamp), message.pose.position
        pose = position.x, position.y, yaw(message.pose.orientation)
        published = list(self._publish(address, robot, robot.tracker.receive_odometry(at, pose)))
        transform = robot.tracker.map_to_odom() if robot.transforms.is_due(at) else None
        if transform is not None:
            robot.transforms.note(at)
            x, y, theta = transform
            moved = FrameTransform(
                timestamp=message.timestamp,
                parent_frame_id=robot.map_frame,
                child_frame_id=robot.odom_frame,
                translation=Vector3(x=x, y=y),
                rotation=quaternion(theta),
            )
            published.append(Envelope(TRANSFORM, address, moved))
        return published

    def _publish(
        self, address: Mapping[str, str], robot: _Tracked, estimates: Iterable[Estimate]
    ) -> Iterator[Envelope]:
        for estimate in estimates:
            robot.map_frame = estimate.frame
            message = _pose_message(estimate, robot.body_frame, self._settings.protection_risk)
            robot.tracker.building.locate(message)
            yield Envelope(POSE, address, message)
            if estimate.request is not None:
                lidar = {**address, "lidar": estimate.request.lidar}
                yield Envelope(SEARCH, lidar, _search_message(estimate.request, self._settings))
            if robot.tracks.is_due(estimate.stamp):
                robot.tracks.note(estimate.stamp)
                yield Envelope(TRACKS, address, _tracks_message(estimate))


def _is_spread(c: Covariance3) -> bool:
    """Whether way and turn have a covariance within a pose's limits; 0 is one."""
    x, y, turn = SIGMA_LIMITS[:, 1] ** 2
    within = 0.0 <= c.xx <= x and 0.0 <= c.yy <= y and 0.0 <= c.tt <= turn
    return bool(within and c.xy * c.xy <= c.xx * c.yy * (1.0 + 1e-6))  # ** raises an error for 1e200


def _pose_message(estimate: Estimate, body: str, risk: float) -> PoseEstimate:
    message = PoseEstimate(
        timestamp=stamp(estimate.stamp),
        frame_id=estimate.frame,
        child_frame_id=body,
        state=estimate.state,
        confidence=estimate.verdict.stated,
        none_probability=estimate.none_probability,
        has_odometry=estimate.map_to_odom is not None,
        model_version=estimate.model_version,
        extrapolated=estimate.extrapolated,
    )
    if estimate.protection is not None:
        message.protection_radius = estimate.protection.radius
        message.protection_angle = estimate.protection.angle
        message.protection_risk = risk
    best = estimate.verdict.track
    if best >= 0:
        message.pose.CopyFrom(to_message(estimate.tracks.x[best]))
        message.covariance.CopyFrom(covariance_to_message(estimate.tracks.C[best]))
        message.track_id = int(estimate.tracks.id[best])
    if estimate.map_to_odom is not None:
        message.map_to_odom.CopyFrom(to_message(estimate.map_to_odom))
    return message


def _search_message(request: Request, settings: TrackerSettings) -> SearchRequest:
    message = SearchRequest(timestamp=stamp(request.stamp), frame_id=request.frame, search=SEARCH_WHOLE)
    for x, y, theta in request.places.tolist():
        message.places.add(x=x, y=y, theta=theta)
    if request.velocity != IDENTITY:
        message.velocity.CopyFrom(to_message(request.velocity))
    if request.local and request.covariance is not None:
        message.search = SEARCH_LOCAL
        message.pose.CopyFrom(to_message(request.pose))
        message.covariance.CopyFrom(covariance_to_message(request.covariance))
        message.least_log_likelihood = request.least / settings.trust
    return message


def _tracks_message(estimate: Estimate) -> Tracks:
    message = Tracks(
        timestamp=stamp(estimate.stamp),
        frame_id=estimate.frame,
        none_probability=estimate.none_probability,
        state=estimate.state,
    )
    tracks = estimate.tracks
    rows = list(
        zip(
            tracks.id.tolist(),
            tracks.parent.tolist(),
            tracks.x.tolist(),
            tracks.C.tolist(),
            np.exp(tracks.log_weight).tolist(),
            tracks.observations.tolist(),
            tracks.born.tolist(),
            tracks.nis.tolist(),
            strict=True,
        )
    )
    for row in np.argsort(-tracks.log_weight, kind="stable").tolist():
        id_, parent, (x, y, theta), C, probability, observations, born, nis = rows[row]
        # filled in place: messages put together from messages take three times as long
        track = message.tracks.add()
        if probability >= IN_PLAY:
            track.CopyFrom(estimate.histories[id_])
        track.id, track.parent_id, track.probability = id_, parent, probability
        track.observations, track.age = observations, (estimate.stamp - born) * 1e-9
        if not isnan(nis):
            track.nis = nis
        track.pose.x, track.pose.y, track.pose.theta = x, y, theta
        (xx, xy, xt), (_, yy, yt), (_, _, tt) = C
        c = track.covariance
        c.xx, c.xy, c.xt, c.yy, c.yt, c.tt = xx, xy, xt, yy, yt, tt
    return message
