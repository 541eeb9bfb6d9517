"""Beams that end on the robot itself are learned as it turns, and left out."""

import numpy as np
from eigenscan.geometry.normalize import Sweep
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.robot_body import SAME_M, SHOWN, RobotBody
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.scan_pb2 import RawScan, Scan

from tests.services.scan_ingest.room import MOUNT, seen

BEARINGS = np.radians(np.arange(-120.0, 120.0))
POST = np.abs(BEARINGS - np.radians(60.0)) < np.radians(9.5)
NOISE_M = 0.01


class Robot:
    """Turns in the room, ten scans a second, with a post in its lidar's view."""

    def __init__(self, post_m: float | None = 0.3) -> None:
        self.core, self.post_m = ScanIngestCore(ScanIngestSettings()), post_m
        self._random, self._scans = np.random.default_rng(1), 0

    def turn(self, degrees: float, rate: float = 30.0) -> Scan:
        """The last scan of a turn, or of as many seconds at rest for a `rate` of 0."""
        count = round(abs(degrees) / 3.0)
        for number in range(count):
            self._scans += 1
            heading = np.radians(rate / 10.0) * (number + 1) * np.sign(degrees)
            poses = np.tile([0.5, 0.5, heading], (len(BEARINGS), 1))
            ranges = seen(poses, BEARINGS)
            if self.post_m is not None:
                ranges[POST] = self.post_m
            ranges += NOISE_M * self._random.standard_normal(len(ranges))
            raw = RawScan(
                timestamp=stamp(10**9 + self._scans * 10**8), angle_min=BEARINGS[0],
                angle_increment=np.radians(1.0), range_min=0.05, range_max=30.0, ranges=ranges,
                mount=Pose2(x=MOUNT[0], y=MOUNT[1], theta=MOUNT[2]),
            )  # fmt: skip
            address = {"site": "s", "robot": "r", "lidar": "front"}
            published = list(self.core.handle(Envelope(SCAN_RAW, address, raw)))
        return published[-1].open(Scan)


def missing(scan: Scan) -> int:
    return int(np.isnan(np.asarray(scan.ranges)).sum())


def test_after_most_of_a_turn_a_post_is_left_out_and_stated() -> None:
    robot = Robot()
    assert missing(robot.turn(180.0)) == 0
    scan = robot.turn(270.0)
    assert np.isnan(np.asarray(scan.ranges)[POST]).all()
    assert missing(scan) == POST.sum()
    condition = robot.core.condition()
    assert condition.status == Health.STATUS_OK
    assert condition.detail == (
        "lidar r/front sees the robot itself over 19°, from 0.3 m away: these beams are left out"
    )


def test_what_the_robot_no_longer_carries_is_seen_past() -> None:
    robot = Robot()
    robot.turn(300.0)
    robot.post_m = None
    assert missing(robot.turn(60.0)) == 0
    assert robot.core.condition().detail == ""


def test_a_room_is_no_robot_however_long_it_turns_to_and_fro_or_stands() -> None:
    robot = Robot(post_m=None)
    for degrees in (90.0, -90.0) * 4:
        assert missing(robot.turn(degrees)) == 0
    assert missing(robot.turn(720.0)) == 0
    still = Robot()
    assert missing(still.turn(600.0, rate=0.0)) == 0


def test_beams_without_a_return_count_neither_way_and_another_grid_begins_again() -> None:
    body, ranges = RobotBody(), np.full(8, 0.3, np.float32)
    for view in range(SHOWN):
        flickers = ranges.copy()
        flickers[1:] = view * 5.0 * SAME_M  # all but the first change
        if view == 2:
            flickers[0] = np.inf
        body.without(Sweep(flickers, 0.0, 0.1))
        body.turn(np.pi / 6.0 + 1e-9)
    assert not body.note
    assert np.isnan(body.without(Sweep(ranges, 0.0, 0.1)).ranges).tolist() == [True, *[False] * 7]
    assert not np.isnan(body.without(Sweep(ranges[:7], 0.0, 0.1)).ranges).any()
