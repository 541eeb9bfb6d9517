"""A robot that drives, with sensors as their covariances state, and a projector that knows the truth."""

from __future__ import annotations

import math
from collections.abc import Iterable
from random import Random

import numpy as np
from eigenscan.runtime.settings import ServiceSettings
from eigenscan.schemas.channels import HYPOTHESES, ODOMETRY, SCAN, SCAN_RAW, Channel
from eigenscan.schemas.envelope import Condition, Envelope, nanoseconds, stamp
from eigenscan.schemas.geometry_pb2 import Covariance3, Pose2
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Hypothesis
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.tracker.planar import Pose, between, compose, wrap
from eigenscan.workbench.simtest import hall
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.Pose_pb2 import Pose as Pose3
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

ALIAS_M = 60.0
"""How far away a part of the building is that looks the same as half of this one."""
CLUTTER = 4
AREA_M2 = 900.0
FITS, FITS_BADLY = (14.0, 22.0), (2.0, 6.0)
"""Log-likelihoods of the right place, and of those that a projector lists with it."""
APART = 8.0
"""Nats by which the right place fits better than its alias, where they differ."""
BEAMS, NOISE_M, RANGE_MAX_M = 120, 0.01, 50.0
BEARINGS = tuple(-math.pi + beam * 2.0 * math.pi / BEAMS for beam in range(BEAMS))
HALL_BEAMS = 360
MARGIN_M = 1.5
"""From the drive to the room's walls."""
AS_DRIVEN = (1.0, 1.0)
"""Odometry counts what the robot drives and turns."""
WORST = 2.5
"""Standard deviations that an error has at most: a claim may never exceed its protection level by chance."""


class Drive:
    """Where a robot is: on an ellipse, now and then it stands. The hall's are half as large."""

    def __init__(self, random: Random, *, in_hall: bool = False) -> None:
        self._a, self._b = random.uniform(6.0, 10.0), random.uniform(5.0, 8.0)
        self._centre = random.uniform(10.0, 20.0), random.uniform(10.0, 20.0)
        if in_hall:
            self._a, self._b = 0.5 * self._a, 0.5 * self._b
            self._centre = 0.2 * self._centre[0] + 5.0, 0.2 * self._centre[1] + 3.0
        self._phase = random.uniform(0.0, 2.0 * math.pi)
        self._speed = random.uniform(0.2, 1.0)
        self._drives, self._stands = random.uniform(10.0, 30.0), random.uniform(0.0, 10.0)

    def at(self, seconds: float) -> Pose:
        """The true pose."""
        rounds, rest = divmod(seconds, self._drives + self._stands)
        driven = (rounds * self._drives + min(rest, self._drives)) * self._speed
        angle = self._phase + driven / max(self._a, self._b)
        x, y = self._a * math.cos(angle), self._b * math.sin(angle)
        heading = math.atan2(self._b * math.cos(angle), -self._a * math.sin(angle))
        return self._centre[0] + x, self._centre[1] + y, heading

    def ranges(self, pose: Pose, random: Random) -> list[float]:
        """What a lidar sees there, m."""
        x, y, theta = pose
        (cx, cy), a, b = self._centre, self._a + MARGIN_M, self._b + MARGIN_M
        west, east, south, north = cx - a - x, cx + a - x, cy - b - y, cy + b - y
        found = []
        for bearing in BEARINGS:
            step_x, step_y = math.cos(theta + bearing), math.sin(theta + bearing)
            along_x = (east if step_x > 0.0 else west) / step_x if abs(step_x) > 1e-9 else math.inf
            along_y = (north if step_y > 0.0 else south) / step_y if abs(step_y) > 1e-9 else math.inf
            found.append(min(along_x, along_y) + random.gauss(0.0, NOISE_M))
        return found

    def is_unique(self, pose: Pose) -> bool:
        """Whether nothing looks the same as this place."""
        return pose[0] > self._centre[0]


class Robot:
    """The truth of one robot, and what its sensors give."""

    def __init__(self, site: str, name: str, seed: str, *, in_hall: bool = False) -> None:
        self.site, self.name, self._seed, self._in_hall = site, name, seed, in_hall
        self.drive = Drive(Random(f"{seed} drive {name}"), in_hall=in_hall)
        self.truth: dict[int, Pose] = {}
        """Of each scan, by its stamp."""
        self._noise = Random(f"{seed} odometry {name}")
        self._last: Pose | None = None
        self._odometry: Pose = (0.0, 0.0, 0.0)
        self.slip: tuple[float, float] = AS_DRIVEN
        """How many times as far, and as much, odometry counts as the robot drives and turns."""
        self._beams = Random(f"{seed} beams {name}")
        self._lidar = {"site": site, "robot": name, "lidar": "front"}

    @property
    def slips(self) -> bool:
        """Whether odometry counts what the robot does not drive."""
        return self.slip != AS_DRIVEN

    def scan(self, seconds: float, now_ns: int) -> Envelope:
        """A scan of now, as scan-ingest gives it, but without what the projector does not need."""
        self.truth[now_ns] = self.drive.at(seconds)
        return Envelope(SCAN, self._lidar, Scan(timestamp=stamp(now_ns), frame_id="base", ranges=[1.0] * 8))

    def raw_scan(self, seconds: float, now_ns: int) -> Envelope:
        """A scan of now, as a lidar's driver gives it: of the hall, or of a room around the whole drive."""
        pose = self.truth[now_ns] = self.drive.at(seconds)
        if self._in_hall:
            bearings = -math.pi + np.arange(HALL_BEAMS) * 2.0 * math.pi / HALL_BEAMS
            ranges = hall.ranges(pose, bearings, RANGE_MAX_M, NOISE_M, self._beams)
        else:
            ranges = self.drive.ranges(pose, self._beams)
        message = RawScan(
            timestamp=stamp(now_ns),
            mount=Pose2(),
            angle_min=-math.pi,
            angle_increment=2.0 * math.pi / len(ranges),
            range_max=RANGE_MAX_M,
            ranges=ranges,
        )
        return Envelope(SCAN_RAW, self._lidar, message)

    def is_unique(self, pose: Pose) -> bool:
        """Whether nothing looks the same as this place."""
        return self._in_hall or self.drive.is_unique(pose)

    def odometry(self, seconds: float, now_ns: int) -> Envelope:
        """Odometry of now; slips a little, as the tracker's settings allow."""
        pose = self.drive.at(seconds)
        step = between(self._last, pose) if self._last is not None else (0.0, 0.0, 0.0)
        self._last = pose
        way = math.hypot(step[0], step[1])
        along, veer = (self._bounded(self._noise) * share * math.sqrt(way) for share in (0.03, 0.015))
        of_way, of_turn = self.slip
        moved = of_way * step[0] + along, of_way * step[1], of_turn * step[2] + veer
        self._odometry = compose(self._odometry, moved)
        x, y, theta = self._odometry
        message = Odometry(
            timestamp=stamp(now_ns),
            frame_id="odom",
            body_frame_id="base",
            pose=Pose3(
                position=Vector3(x=x, y=y),
                orientation=Quaternion(z=math.sin(theta / 2.0), w=math.cos(theta / 2.0)),
            ),
        )
        return Envelope(ODOMETRY, {"site": self.site, "robot": self.name}, message)

    def hypotheses(self, scan: Scan) -> Hypotheses:
        """What a projector that makes no mistakes beyond its covariances states of a scan."""
        at = nanoseconds(scan.timestamp)
        random = Random(f"{self._seed} list {self.name} {at}")
        sigma, sigma_theta = random.uniform(0.02, 0.08), random.uniform(0.01, 0.03)
        true = self.truth[at]
        pose = compose(
            true,
            (
                sigma * self._bounded(random),
                sigma * self._bounded(random),
                sigma_theta * self._bounded(random),
            ),
        )
        likelihood = random.uniform(*FITS)
        alias = likelihood - (APART if self.is_unique(true) else 0.0)
        listed = [(pose, likelihood), ((pose[0] + ALIAS_M, pose[1], pose[2]), alias)]
        for _ in range(CLUTTER):
            place = random.uniform(0.0, 90.0), random.uniform(0.0, 30.0), random.uniform(-3.0, 3.0)
            listed.append((place, random.uniform(*FITS_BADLY)))
        return Hypotheses(
            timestamp=scan.timestamp,
            frame_id="map",
            status=Hypotheses.STATUS_OK,
            searched_area_m2=AREA_M2,
            hypotheses=[
                Hypothesis(
                    pose=Pose2(x=x, y=y, theta=wrap(theta)),
                    covariance=Covariance3(xx=sigma**2, yy=sigma**2, tt=sigma_theta**2),
                    log_likelihood=value,
                )
                for (x, y, theta), value in sorted(listed, key=lambda one: -one[1])
            ],
        )

    @staticmethod
    def _bounded(random: Random) -> float:
        while abs(value := random.gauss(0.0, 1.0)) > WORST:
            pass
        return value


class SyntheticProjector:
    """In a projector's place: answers scans with lists whose truth is known."""

    inputs: tuple[Channel, ...] = (SCAN,)
    outputs: tuple[Channel, ...] = (HYPOTHESES,)

    def __init__(self, robots: dict[str, Robot], settings: ServiceSettings) -> None:
        self._robots, self._instance = robots, settings.instance
        self._answered = 0

    def start(self) -> Iterable[Envelope]:
        """Nothing."""
        return ()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        """The list of a scan."""
        scan = received.open(Scan)
        robot = self._robots[received.address["robot"]]
        if nanoseconds(scan.timestamp) in robot.truth:
            self._answered += 1
            address = {**received.address, "projector": self._instance}
            yield Envelope(HYPOTHESES, address, robot.hypotheses(scan))

    def finish(self) -> Iterable[Envelope]:
        """Nothing."""
        return ()

    def condition(self) -> Condition:
        """OK."""
        return Condition(Health.STATUS_OK, "", {"answered": self._answered})
