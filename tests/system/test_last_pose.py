"""A tracker that is killed begins again where it was, and the recording shows it."""

import time

import pytest
from eigenscan.schemas.channels import POSE, RELOCATION
from eigenscan.schemas.envelope import nanoseconds, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Relocation

from tests.system.house import House
from tests.system.robot import Robot

pytestmark = pytest.mark.slow


def test_a_restarted_tracker_begins_at_the_last_pose_unless_that_is_old(house: House) -> None:
    robot, folder = Robot(house.site, house.config), house.logs / "last"
    flags = ("--last-pose", folder, "--last-pose-age", 600)
    house.start("mapbuilder", "--map", robot.write_map(house.logs), "--step", "1.0")
    for service in ("projector", "scan-ingest"):
        house.start(service)
    house.start("tracker", *flags)

    def sure(count: int) -> list[PoseEstimate]:
        poses = [pose for pose in house.ear.of(POSE, PoseEstimate) if pose.state == STATE_LOCALIZED]
        return poses if len(poses) >= count else []

    with robot:
        house.ear.wait_for(lambda _: sure(15), "claims")
        house.kill("tracker")
        known = len(sure(1))
        house.start("tracker", *flags)
        house.until("tracker", lambda health: health.counters["relocated"] == 1, "began at the last pose")
        house.ear.wait_for(lambda _: len(sure(1)) >= known + 5, "claims again")
    (word,) = house.ear.of(RELOCATION, Relocation)
    received = [envelope.message for envelope in house.ear.received]
    *_, last = (pose for pose in sure(1) if received.index(pose) < received.index(word))
    assert abs(nanoseconds(last.timestamp) - nanoseconds(word.timestamp)) < 2_000_000_000
    true = robot.stage.pose_at(nanoseconds(word.timestamp))
    assert abs(word.pose.x - true[0]) < 0.5
    assert abs(word.pose.y - true[1]) < 0.5
    # it may have driven 2 m/s since
    assert word.covariance.xx > 0.1

    house.kill("tracker")
    (path,) = folder.iterdir()
    old = Relocation.FromString(path.read_bytes())
    old.timestamp.CopyFrom(stamp(time.time_ns() - 36_000 * 1_000_000_000))
    path.write_bytes(old.SerializeToString())
    house.start("tracker", *flags)
    house.until("tracker", lambda health: health.status == Health.STATUS_WAITING, "is there")
    assert len(house.ear.of(RELOCATION, Relocation)) == 1
