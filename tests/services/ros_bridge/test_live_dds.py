"""The bridge with a robot on a DDS, and between them the real zenoh-bridge-ros2dds.

Only where it is asked for, for the build takes many minutes: `pip install cyclonedds` (from PyPI), cmake and
libclang (of the system), then
`pytest -m rust tests/services/ros_bridge`. `record_dds.py` writes down what it reports.
"""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.gridmap import GridMap, write_map
from eigenscan.geometry.gridmap import to_message as to_grid
from eigenscan.geometry.pose import from_pose3, to_message
from eigenscan.ros_bridge.inbound import header_stamp, on_plane
from eigenscan.schemas.channels import MAP, ODOMETRY, POSE, RELOCATION, SCAN_RAW, TRACKS, TRANSFORM
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Relocation, Track, Tracks
from eigenscan.workbench.simulation.live import publish
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

from tests.environment import ROOT
from tests.network import free_port
from tests.services.ros_bridge.conftest import Bridge, Network, eventually, pipeline

pytestmark = pytest.mark.rust

SOURCE = Path(__file__).with_name("dds_bridge")
TARGET = ROOT / "out/rust"
TIME = 1_700_000_000_250_000_000
SECONDS = 10.0

Start = Callable[..., Bridge]


@pytest.fixture(scope="session")
def dds() -> ModuleType:
    """The robot's side; it reads its environment when it is loaded."""
    pytest.importorskip("cyclonedds", reason="pip install cyclonedds")
    from tests.services.ros_bridge import dds_robot

    os.environ["CYCLONEDDS_URI"] = dds_robot.CYCLONE
    return dds_robot


@pytest.fixture(scope="session")
def program() -> Path:
    """zenoh-bridge-ros2dds, built of its crate."""
    build = ["cargo", "build", "--release", "--target-dir", str(TARGET)]
    subprocess.run(build, cwd=SOURCE, check=True)
    return TARGET / "release/dds-bridge"


@pytest.fixture
def domain() -> int:
    return int.from_bytes(os.urandom(1), "big") % 100 + 1


@pytest.fixture
def router(dds: ModuleType, program: Path, domain: int, tmp_path: Path) -> Iterator[str]:
    """Where the real bridge listens."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = tmp_path / "bridge.json5"
    reported = {
        "mode": "router",
        "listen": {"endpoints": [endpoint]},
        "scouting": {"multicast": {"enabled": False}},
        "timestamping": {"enabled": True},
        "adminspace": {"enabled": True},
        "plugins_loading": {"enabled": True},
        "plugins": {"ros2dds": {"domain": domain}},
    }
    config.write_text(json.dumps(reported))
    with subprocess.Popen([program, config], env={**os.environ, "ROS_DISTRO": "jazzy"}) as process:
        yield endpoint
        process.terminate()


@pytest.fixture
def robot(dds: ModuleType, router: str, domain: int) -> Any:
    return dds.DdsRobot(domain)


def taken(reader: Any, until: Callable[[], None], about: str) -> Any:
    """The newest message of a reader, once there is one; `until` is done again and again before."""

    def newest() -> Any:
        until()
        time.sleep(0.05)
        messages = reader.take(100)
        return messages[-1] if messages else None

    return eventually(newest, about)


def test_a_robot_on_a_dds_in(start: Start, robot: Any, dds: ModuleType, router: str) -> None:
    static = robot.outputs("rt/tf_static", dds.TFMessage, dds.LATCHED)
    mount = dds.Transform(dds.Vector3(0.2, 0.1, 0.3), dds.Quaternion(1.0, 0.0, 0.0, 0.0))
    static.write(dds.TFMessage([dds.TransformStamped(dds.header("base_link"), "laser", mount)]))
    lidar = robot.outputs("rt/scan", dds.LaserScan, dds.SENSOR)
    tf = robot.outputs("rt/tf", dds.TFMessage, dds.quality(100))
    odom = robot.outputs("rt/odom", dds.Odometry)
    bridge = start("--dialect", "ros2dds", ros_router=router)
    here = dds.Transform(dds.Vector3(1.0, 2.0, 0.0), dds.Quaternion(0.0, 0.0, 1.0, 0.0))
    zero = dds.Vector3(0.0, 0.0, 0.0)
    pose = dds.Pose(dds.Point(5.0, 6.0, 0.0), dds.Quaternion(0.0, 0.0, 0.0, 1.0))
    stated = dds.PoseWithCovariance(pose, [0.5] + 35 * [0.0])
    moving = dds.TwistWithCovariance(dds.Twist(zero, zero), 36 * [0.0])

    def wheels() -> list[Odometry]:
        odom.write(dds.Odometry(dds.header("odom", TIME), "base_link", stated, moving))
        return bridge.ear.of(ODOMETRY, Odometry)

    first = eventually(wheels, "odometry of its topic")[0]
    assert (first.pose.position.x, first.pose_covariance[0], first.body_frame_id) == (5.0, 0.5, "base_link")

    def through() -> list[RawScan]:
        tf.write(dds.TFMessage([dds.TransformStamped(dds.header("odom", TIME), "base_link", here)]))
        lidar.write(_scan(dds, [1.0, 2.0, np.inf], "laser", TIME))
        return bridge.ear.of(SCAN_RAW, RawScan)

    scan = eventually(through, "a scan")[-1]
    assert nanoseconds(scan.timestamp) == TIME
    assert list(scan.ranges) == [1.0, 2.0, np.inf]
    assert (scan.mount.x, scan.upside_down) == (pytest.approx(0.2), True)
    moved = eventually(
        lambda: [m for m in bridge.ear.of(ODOMETRY, Odometry) if m.pose.position.x == 1.0], "odometry of tf"
    )
    assert from_pose3(moved[0].pose) == pytest.approx([1.0, 2.0, np.pi])


def test_a_robot_on_a_dds_out(start: Start, robot: Any, dds: ModuleType, router: str) -> None:
    poses = robot.inputs("rt/amcl_pose", dds.PoseWithCovarianceStamped, dds.LATCHED)
    tf = robot.inputs("rt/tf", dds.TFMessage, dds.quality(100))
    clouds = robot.inputs("rt/particle_cloud", dds.ParticleCloud, dds.SENSOR)
    bridge = start("--dialect", "ros2dds", ros_router=router)
    address = {"site": bridge.site, "robot": "robot"}
    estimate = PoseEstimate(timestamp=stamp(TIME), frame_id="map", state=STATE_LOCALIZED)
    estimate.pose.CopyFrom(to_message((1.5, -2.0, 0.7)))
    estimate.covariance.xx, estimate.covariance.yt = 0.04, 0.003
    move = FrameTransform(timestamp=stamp(TIME), parent_frame_id="map", child_frame_id="odom")
    move.translation.x, move.rotation.w = 3.0, 1.0
    tracks = Tracks(timestamp=stamp(TIME), frame_id="map", tracks=[Track(probability=0.9)])

    def send(channel: Any, message: Any) -> Callable[[], None]:
        return lambda: bridge.ear.bus.publish(Envelope(channel, address, message))

    body = taken(poses, send(POSE, estimate), "/amcl_pose")
    assert (body.header.frame_id, header_stamp(body.header)) == ("map", TIME)
    assert (body.pose.pose.position.x, body.pose.pose.position.y) == (1.5, -2.0)
    assert (body.pose.covariance[0], body.pose.covariance[11]) == (0.04, 0.003)
    (item,) = taken(tf, send(TRANSFORM, move), "/tf").transforms
    assert (item.header.frame_id, item.child_frame_id) == ("map", "odom")
    assert item.transform.translation.x == 3.0
    assert taken(clouds, send(TRACKS, tracks), "/particle_cloud").particles[0].weight == 0.9
    # its own transform must not come back from the DDS
    time.sleep(1.0)
    assert bridge.counter("heard_ros_heard") == 0


def test_who_comes_late_to_a_dds_gets_map_and_pose(
    start: Start, robot: Any, dds: ModuleType, router: str
) -> None:
    bridge = start("--dialect", "ros2dds", ros_router=router)
    cells = np.zeros((4, 6), dtype=np.uint8)
    cells[1, 2], cells[3, 5] = 100, 255
    grid = GridMap(cells, 0.05, np.array([-1.0, 2.0, 0.0]))
    estimate = PoseEstimate(timestamp=stamp(TIME), frame_id="map", state=STATE_LOCALIZED)
    estimate.pose.CopyFrom(to_message((1.5, -2.0, 0.7)))
    bridge.ear.bus.offer([MAP], {"site": bridge.site})
    bridge.ear.bus.publish(Envelope(MAP, {"site": bridge.site}, to_grid(grid, "map")))
    bridge.ear.bus.publish(Envelope(POSE, {"site": bridge.site, "robot": "robot"}, estimate))
    eventually(lambda: bridge.counter("said_ros_said") == 2, "map and pose to be said")
    map_reader = robot.inputs("rt/map", dds.OccupancyGrid, dds.LATCHED)
    received = taken(map_reader, lambda: None, "the map")
    assert np.array(received.data).reshape(4, 6)[[1, 3], [2, 5]].tolist() == [100, -1]
    pose_reader = robot.inputs("rt/amcl_pose", dds.PoseWithCovarianceStamped, dds.LATCHED)
    assert taken(pose_reader, lambda: None, "the pose").pose.pose.position.x == 1.5


def test_services_and_clicks_of_a_dds(start: Start, robot: Any, dds: ModuleType, router: str) -> None:
    bridge = start("--dialect", "ros2dds", ros_router=router)
    requests = robot.outputs("rq/amcl/get_stateRequest", dds.GetStateRequest)
    responses = robot.inputs("rr/amcl/get_stateReply", dds.GetStateResponse)
    asked = iter(range(1, 10_000))
    response = taken(responses, lambda: requests.write(dds.GetStateRequest(77, next(asked), 0)), "the state")
    assert (response.client, response.current_state.label) == (77, "active")
    clicks = robot.outputs("rt/initialpose", dds.PoseWithCovarianceStamped)
    pose = dds.Pose(dds.Point(4.0, 5.0, 0.0), dds.Quaternion(0.0, 0.0, 0.0, 1.0))
    clicked = dds.PoseWithCovarianceStamped(dds.header("map"), dds.PoseWithCovariance(pose, 36 * [0.0]))

    def reported() -> list[Relocation]:
        clicks.write(clicked)
        return bridge.ear.of(RELOCATION, Relocation)

    assert eventually(reported, "the click")[0].pose.x == 4.0


class DdsDriver:
    """Publishes on the DDS what the simulated robot does: odometry in tf, its lidar upside down or not."""

    def __init__(self, robot: Any, dds: ModuleType) -> None:
        self._dds = dds
        self._scan = robot.outputs("rt/scan", dds.LaserScan, dds.SENSOR)
        self._tf = robot.outputs("rt/tf", dds.TFMessage, dds.quality(100))
        self._static = robot.outputs("rt/tf_static", dds.TFMessage, dds.LATCHED)
        self._mounted = False

    def publish(self, envelope: Envelope) -> None:
        if envelope.channel is ODOMETRY:
            message = envelope.open(Odometry)
            at = from_pose3(message.pose)
            self._tf.write(self._transform("odom", "base_footprint", at, nanoseconds(message.timestamp)))
        elif envelope.channel is SCAN_RAW:
            raw = envelope.open(RawScan)
            if not self._mounted:
                at = np.array([raw.mount.x, raw.mount.y, raw.mount.theta])
                self._static.write(self._transform("base_footprint", "laser", at, 0))
                self._mounted = True
            body = _scan(self._dds, list(raw.ranges), "laser", nanoseconds(raw.timestamp))
            body.angle_min, body.angle_increment = raw.angle_min, raw.angle_increment
            body.range_max = raw.range_max
            self._scan.write(body)

    def _transform(self, parent: str, child: str, at: Any, time: int) -> Any:
        dds, (x, y, theta) = self._dds, at
        turn = dds.Quaternion(0.0, 0.0, float(np.sin(theta / 2)), float(np.cos(theta / 2)))
        move = dds.Transform(dds.Vector3(float(x), float(y), 0.0), turn)
        return dds.TFMessage([dds.TransformStamped(dds.header(parent, time), child, move)])


def _scan(dds: ModuleType, ranges: list[float], frame: str, time: int) -> Any:
    return dds.LaserScan(dds.header(frame, time), -1.0, 1.0, 1.0, 0.0, 0.1, 0.05, 30.0, ranges, [])


def test_a_robot_on_a_dds_is_localized(
    network: Network, robot: Any, dds: ModuleType, router: str, tmp_path: Path
) -> None:
    stage = Stage(office().render(), Scenario(seconds=SECONDS, people=2))
    write_map(stage.grid, tmp_path / "map.yaml")
    poses = robot.inputs("rt/amcl_pose", dds.PoseWithCovarianceStamped, dds.quality(1000, latched=True))
    tf = robot.inputs("rt/tf", dds.TFMessage, dds.quality(1000))
    driver = DdsDriver(robot, dds)
    with pipeline(network, tmp_path / "out", "ros2dds", router, "--map", tmp_path / "map.yaml"):
        stage.epoch = time.time_ns()
        publish(stage.messages(), driver.publish)
        received = poses.take(2000)
        anchors = [
            item for message in tf.take(5000) for item in message.transforms if item.child_frame_id == "odom"
        ]
    errors = [
        np.hypot(*(np.array(on_plane(m.pose.pose.position, m.pose.pose.orientation)) - at)[:2])
        for m in received
        if (at := stage.pose_at(header_stamp(m.header))) is not None
    ]
    print(f"{len(errors)} poses, median error {np.median(errors):.3f} m, worst {max(errors):.3f} m")
    assert len(errors) > 0.5 * SECONDS * stage.scenario.lidar.rate
    assert np.median(errors) < 0.1
    assert max(errors) < 0.5
    assert {item.header.frame_id for item in anchors} == {"map"}
