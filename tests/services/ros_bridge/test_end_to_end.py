"""A simulated robot that speaks ROS 2 only is localized by `eigenscan run --ros2`, on its own /map.

It is as little as AMCL needs: odometry in tf, no topic of it, and the clock of a simulation (use_sim_time).
"""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.gridmap import from_message
from eigenscan.geometry.gridmap import to_message as to_grid
from eigenscan.geometry.pose import compose, from_pose3
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.inbound import header_stamp, on_plane
from eigenscan.ros_bridge.outbound import occupancy_grid
from eigenscan.schemas.channels import MAP, ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.simulation.live import publish
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from zenoh_ros2_sdk import get_topic_info
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

from tests.services.ros_bridge.conftest import Ear, Network, Robot, eventually, fields, pipeline
from tests.services.ros_bridge.test_core import header, scan, transform

pytestmark = pytest.mark.slow

SECONDS = 8.0
SIMULATION_STARTED = 5_000_000_000
"""ns"""
LATCHED = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1)


class RosDriver:
    """Publishes in ROS 2 what the simulated robot publishes."""

    def __init__(self, robot: Robot) -> None:
        self._scan = robot.publisher("/scan", cdr.LASER_SCAN)
        self._tf = robot.publisher("/tf", cdr.TRANSFORMS)
        self._static = robot.publisher("/tf_static", cdr.TRANSFORMS)

    def publish(self, envelope: Envelope) -> None:
        if envelope.channel is ODOMETRY:
            message = envelope.open(Odometry)
            x, y, theta = from_pose3(message.pose)
            turn = (0.0, 0.0, np.sin(theta / 2), np.cos(theta / 2))
            body = cdr.decode(cdr.TRANSFORMS, transform("odom", "base_footprint", (x, y, 0.0), turn))
            body.transforms[0].header = header("odom", nanoseconds(message.timestamp))
            self._tf.publish(**fields(body))
        elif envelope.channel is SCAN_RAW:
            raw = envelope.open(RawScan)
            mount = raw.mount
            turn = (0.0, 0.0, np.sin(mount.theta / 2), np.cos(mount.theta / 2))
            static = transform("base_footprint", "laser", (mount.x, mount.y, 0.0), turn)
            self._static.publish(**fields(cdr.decode(cdr.TRANSFORMS, static)))
            body = cdr.decode(cdr.LASER_SCAN, scan("laser", raw.ranges, nanoseconds(raw.timestamp)))
            body.angle_min, body.angle_increment = raw.angle_min, raw.angle_increment
            body.range_max = raw.range_max
            self._scan.publish(**fields(body))


@pytest.fixture
def stage() -> Stage:
    return Stage(office().render(), Scenario(seconds=SECONDS, people=2))


@pytest.fixture
def map_server(robot: Robot, stage: Stage) -> Iterator[None]:
    """Publishes the robot's map again and again: the SDK keeps nothing for who comes late."""
    publisher = robot.publisher("/map", cdr.OCCUPANCY_GRID)
    body = cdr.decode(cdr.OCCUPANCY_GRID, occupancy_grid(to_grid(stage.grid, "map")))
    ended = threading.Event()

    def send() -> None:
        while not ended.wait(0.5):
            publisher.publish(**fields(body))

    thread = threading.Thread(target=send)
    thread.start()
    yield
    ended.set()
    thread.join()


@pytest.fixture
def ear(network: Network, robot: Robot, map_server: None, tmp_path: Path) -> Iterator[Ear]:
    """What the running pipeline publishes."""
    domain = str(robot.domain)
    with pipeline(network, tmp_path / "out", "rmw_zenoh", network.endpoint, ROS_DOMAIN_ID=domain) as ear:
        yield ear


def test_a_robot_that_speaks_ros_2_only_is_localized(stage: Stage, ear: Ear, robot: Robot) -> None:
    poses = robot.subscribe("/amcl_pose", cdr.POSE_WITH_COVARIANCE, qos=LATCHED)
    tf = robot.subscribe("/tf", cdr.TRANSFORMS)

    def anchors() -> list[Any]:
        """map to odom; the robot's own transforms are on /tf as well."""
        return [item for message in tf for item in message.transforms if item.header.frame_id == "map"]

    stage.epoch = SIMULATION_STARTED
    publish(stage.messages(), RosDriver(robot).publish)
    enough = 0.5 * SECONDS * stage.scenario.lidar.rate
    eventually(lambda: len(poses) > enough and anchors(), "poses of half of the scans, and a transform")
    errors = []
    for message in poses:
        stated = message.pose.pose
        truth, pose = (
            stage.pose_at(header_stamp(message.header)),
            on_plane(stated.position, stated.orientation),
        )
        assert pose is not None
        errors.append(np.hypot(*(pose - truth)[:2]))
    assert np.median(errors) < 0.1
    assert np.max(errors) < 0.5
    # map to odom, with the robot's own odometry, leads to where it is
    item = anchors()[-1]
    move, turn = item.transform.translation, item.transform.rotation
    anchor = np.array([move.x, move.y, 2.0 * np.arctan2(turn.z, turn.w)])
    at = stage.pose_at(header_stamp(item.header) - 100_000_000)
    tick = int(np.argmin(np.abs(stage.poses[:, :2] - at[:2]).sum(axis=1)))
    assert np.hypot(*(compose(anchor, stage.odometry[tick]) - at)[:2]) < 0.2
    # the map is the robot's; the bridge does not publish it once more
    grid = from_message(ear.of(MAP, Grid)[0])
    assert np.array_equal(grid.cells, stage.grid.cells)
    asked = {"domain_id": robot.domain, "router_port": robot.port}
    info = eventually(lambda: get_topic_info("/map", **asked), "who says /map")
    assert info.publisher_count == 1
