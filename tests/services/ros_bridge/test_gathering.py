"""What narrow sensors saw one after another becomes one scan, at known walls; also where it must not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.pose import compose
from eigenscan.geometry.transforms import MOST_FRAMES, TransformTree
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.core import RosBridgeCore
from eigenscan.ros_bridge.gathering import LIDAR, MOST_SENSORS
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.scan_pb2 import RawScan

from tests.services.ros_bridge.test_cloud import HALF, cloud
from tests.services.ros_bridge.test_core import TIME, core, header, listen, scan, transform

STEP_NS = 100_000_000
LEVEL = (0.0, 0.0, 0.0, 1.0)
LOOK = np.array([-1.0, 0.0, 1.0])
"""The three beams of `scan`."""


def bridge(**settings: Any) -> RosBridgeCore:
    """One with a sensor ahead of its base, and one behind it that looks backwards."""
    made = core(**{"gather": 3.0, "base_frame": "base_link", "scan": ["front/scan", "rear/scan"]} | settings)
    listen(made, "%tf_static", transform("base_link", "front", (0.2, 0.0, 0.3), LEVEL))
    listen(made, "%tf_static", transform("base_link", "rear", (-0.2, 0.0, 0.3), (0.0, 0.0, 1.0, 0.0)))
    return made


def drive(made: RosBridgeCore, pose: tuple[float, float, float], time: int) -> None:
    turn = cdr.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, np.sin(pose[2] / 2), np.cos(pose[2] / 2))
    move = cdr.make("geometry_msgs/msg/Vector3", pose[0], pose[1], 0.0)
    content = cdr.make("geometry_msgs/msg/Transform", move, turn)
    item = cdr.make("geometry_msgs/msg/TransformStamped", header("odom", time), "base_link", content)
    listen(made, "%tf", cdr.encode(cdr.make(cdr.TRANSFORMS, [item])))


def look(made: RosBridgeCore, sensor: str, ranges: list[float], time: int) -> list[Envelope]:
    return [
        each
        for each in listen(made, f"%{sensor}%scan", scan(sensor, ranges, time))
        if each.channel is SCAN_RAW
    ]


def points(published: list[Envelope]) -> Any:
    """The points (n, 2) of the one scan, in the base's frame, by x and y."""
    (one,) = published
    assert one.address["lidar"] == LIDAR
    raw = one.open(RawScan)
    assert raw.gathered == 3.0
    ranges = np.array(raw.ranges)
    angles = raw.angle_min + raw.angle_increment * np.arange(len(ranges))
    assert (raw.mount.x, raw.mount.y, raw.mount.theta, raw.upside_down) == (0.0, 0.0, 0.0, False)
    seen = np.stack([np.cos(angles), np.sin(angles)], axis=1) * ranges[:, None]
    seen = seen[np.isfinite(ranges)]
    return seen[np.lexsort(seen.T)]


def in_base(made_at: tuple[float, float, float], *walls: tuple[float, float]) -> Any:
    """Points of the odometry frame in the base's, by x and y."""
    off = np.array(walls) - made_at[:2]
    cos, sin = np.cos(made_at[2]), np.sin(made_at[2])
    turned = off @ np.array([[cos, -sin], [sin, cos]])
    return turned[np.lexsort(turned.T)]


NOTHING = float("inf")


def test_what_was_seen_before_a_turn_is_in_the_scan_after_it() -> None:
    made = bridge()
    drive(made, (0.0, 0.0, 0.0), TIME)
    look(made, "front", [NOTHING, 1.8, NOTHING], TIME)  # a wall at (2, 0)
    after = (0.5, 0.0, np.pi / 2)
    drive(made, after, TIME + STEP_NS)
    there = points(look(made, "front", [NOTHING, 2.8, NOTHING], TIME + STEP_NS))  # another at (0.5, 3)
    # 1 deg a beam: 2.6 cm at 3 m
    assert there == pytest.approx(in_base(after, (2.0, 0.0), (0.5, 3.0)), abs=0.03)


def test_two_sensors_make_one_scan() -> None:
    made = bridge()
    drive(made, (0.0, 0.0, 0.0), TIME)
    assert len(look(made, "rear", [NOTHING, 2.8, NOTHING], TIME)) == 1
    drive(made, (0.0, 0.0, 0.0), TIME + STEP_NS)
    both = points(look(made, "front", [NOTHING, 1.8, NOTHING], TIME + STEP_NS))
    assert both == pytest.approx(in_base((0.0, 0.0, 0.0), (2.0, 0.0), (-3.0, 0.0)), abs=0.03)


def test_several_clouds_and_a_lidar_make_one_scan() -> None:
    """Two depth cameras, ahead and to the left, each with a floor below the slice; a lidar behind."""
    made = bridge(scan=["rear/scan"], points=["front/points", "left/points"])
    listen(made, "%tf_static", transform("base_link", "left", (0.0, 0.2, 0.3), (0.0, 0.0, HALF, HALF)))
    drive(made, (0.0, 0.0, 0.0), TIME)
    for number, sensor in enumerate(("front", "left")):
        time = TIME + number * STEP_NS
        drive(made, (0.0, 0.0, 0.0), time)
        seen = cloud([(1.8, 0.0, 0.2), (0.5, 0.0, -0.3)], sensor, header=header(sensor, time))
        listen(made, f"%{sensor}%points", seen)
    drive(made, (0.0, 0.0, 0.0), TIME + 2 * STEP_NS)
    every = points(look(made, "rear", [NOTHING, 2.8, NOTHING], TIME + 2 * STEP_NS))
    walls = in_base((0.0, 0.0, 0.0), (2.0, 0.0), (0.0, 2.0), (-3.0, 0.0))
    assert every == pytest.approx(walls, abs=0.03)


def test_sensors_that_follow_each_other_at_once_are_not_two_scans() -> None:
    made = bridge()
    drive(made, (0.0, 0.0, 0.0), TIME)
    assert len(look(made, "front", [1.0, 1.0, 1.0], TIME)) == 1
    assert look(made, "rear", [1.0, 1.0, 1.0], TIME + STEP_NS // 10) == []


def test_the_nearest_of_a_direction_counts() -> None:
    made = bridge()
    drive(made, (0.0, 0.0, 0.0), TIME)
    look(made, "front", [NOTHING, 3.8, NOTHING], TIME)
    drive(made, (0.0, 0.0, 0.0), TIME + STEP_NS)
    now = points(look(made, "front", [NOTHING, 1.8, NOTHING], TIME + STEP_NS))  # a door was closed
    assert now == pytest.approx(np.array([[2.0, 0.0]]), abs=0.03)


@pytest.mark.parametrize("jump", [False, True])
def test_what_was_seen_is_forgotten_after_the_way_and_after_a_jump(jump: bool) -> None:
    made = bridge()
    drive(made, (0.0, 0.0, 0.0), TIME)
    look(made, "front", [NOTHING, 1.8, NOTHING], TIME)
    steps = [1.5] if jump else [0.8 * k for k in range(1, 5)]  # 3.2 m, and the way is 3 m
    for k, x in enumerate(steps, start=1):
        drive(made, (x, 0.0, 0.0), TIME + k * STEP_NS)
    end = TIME + len(steps) * STEP_NS
    left = points(look(made, "front", [NOTHING, NOTHING, 2.0], end))
    ahead = compose([0.2, 0.0, 0.0], [2.0 * np.cos(LOOK[2]), 2.0 * np.sin(LOOK[2]), 0.0])[:2]
    assert left == pytest.approx(ahead[None], abs=0.03)


def test_the_base_is_found_between_and_a_little_beyond_odometry() -> None:
    made = bridge()
    drive(made, (0.0, 0.0, 0.0), TIME)
    drive(made, (0.1, 0.0, 0.0), TIME + STEP_NS)
    look(made, "front", [NOTHING, 1.8, NOTHING], TIME + STEP_NS // 2)  # from 0.05: a wall at (2.05, 0)
    beyond = points(look(made, "front", [2.0, NOTHING, NOTHING], TIME + 2 * STEP_NS))  # from 0.2
    assert beyond[-1] == pytest.approx([2.05 - 0.2, 0.0], abs=0.03)


def test_without_odometry_of_its_time_a_scan_is_counted_and_named() -> None:
    made = bridge()
    assert look(made, "front", [1.0, 1.0, 1.0], TIME) == []
    drive(made, (0.0, 0.0, 0.0), TIME)
    assert look(made, "front", [1.0, 1.0, 1.0], TIME + 20 * STEP_NS) == []
    assert made.condition().counters["set_aside_no_odometry"] == 2
    assert "no odometry" in made.condition().detail
    drive(made, (0.0, 0.0, 0.0), TIME + 20 * STEP_NS)
    assert len(look(made, "front", [1.0, 1.0, 1.0], TIME + 20 * STEP_NS)) == 1
    assert made.condition().detail == "no scan yet on /rear/scan"


def test_a_scan_that_is_none_is_counted_and_the_next_one_counts() -> None:
    made = bridge()
    drive(made, (0.0, 0.0, 0.0), TIME)
    none = cdr.decode(cdr.LASER_SCAN, scan("front", [1.0, 1.0, 1.0], TIME))
    none.angle_increment = float("nan")
    assert listen(made, "%front%scan", cdr.encode(none)) == []
    assert made.condition().counters["set_aside_angles_not_finite"] == 1
    assert len(look(made, "front", [float("nan"), 1.0, 1.0], TIME)) == 1


def test_a_lidar_whose_scans_are_none_is_named() -> None:
    made = bridge(scan=["front/scan"])
    drive(made, (0.0, 0.0, 0.0), TIME)
    none = np.zeros(0, dtype=np.float32)
    limits = -1.0, 1.0, 1.0, 0.0, 0.1, 30.0, 0.05
    body = cdr.make(cdr.LASER_SCAN, header("front", TIME), *limits, np.ones(3, dtype=np.float32), none)
    assert listen(made, "%front%scan", cdr.encode(body)) == []
    condition = made.condition()
    assert condition.status == Health.STATUS_WAITING
    assert condition.detail.startswith("/front/scan: range_min, range_max: contradict each other")
    look(made, "front", [1.0, 2.0, 3.0], TIME + STEP_NS)
    assert made.condition().status == Health.STATUS_OK


def test_it_needs_the_mounts() -> None:
    with pytest.raises(ValueError, match="gather needs mounts_from_tf"):
        core(gather=3.0, mounts_from_tf=False)


def test_a_robot_that_stands_for_long_keeps_little() -> None:
    made = bridge()
    for k in range(50):
        drive(made, (0.0, 0.0, 0.0), TIME + k * STEP_NS)
        look(made, "front", [1.0, 1.0, 1.0], TIME + k * STEP_NS)
    assert made._gathering is not None
    assert sum(map(len, made._gathering._views.values())) <= 2


def test_invented_frames_are_bounded() -> None:
    """Each stayed for ever, and made each scan slower."""
    made = bridge()
    assert made._gathering is not None
    drive(made, (0.0, 0.0, 0.0), TIME)
    for number in range(100):
        listen(made, "%tf_static", transform("base_link", f"front{number}", (0.2, 0.0, 0.3), LEVEL))
        listen(made, "%front%scan", scan(f"front{number}", [1.0, 1.0, 1.0], TIME))
    assert len(made._gathering._views) == MOST_SENSORS
    tree = TransformTree()
    for number in range(MOST_FRAMES + 100):
        tree.receive("base_link", f"frame{number}", (0.0, 0.0, 0.0), LEVEL)
    assert len(tree.frames()) == MOST_FRAMES + 1
