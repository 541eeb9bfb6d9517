"""Against what the real zenoh-bridge-ros2dds published, in front of a robot on Cyclone DDS (`record_dds.py`).

All bytes are Cyclone's and the bridge's own: this side's must be the same.
"""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.pose import from_pose3
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.endpoints import Role, endpoints
from eigenscan.ros_bridge.options import RosBridgeOptions
from eigenscan.ros_bridge.outbound import occupancy_grid, particle_cloud, transforms
from eigenscan.ros_bridge.ros2dds import Ros2Dds
from eigenscan.schemas.envelope import nanoseconds, stamp
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.schemas.tracking_pb2 import Track, Tracks
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion

from tests.services.ros_bridge.test_core import TIME, core, listen

RECORDED = Path(__file__).with_name("recorded_dds.json")

DATA: dict[str, Any] = json.loads(RECORDED.read_text())
KINDS = {
    "scan": cdr.LASER_SCAN,
    "odom": cdr.ODOMETRY,
    "tf": cdr.TRANSFORMS,
    "tf_static": cdr.TRANSFORMS,
    "amcl_pose": cdr.POSE_WITH_COVARIANCE,
    "particle_cloud": cdr.PARTICLE_CLOUD,
    "map": cdr.OCCUPANCY_GRID,
}
YAW = 2.0 * np.arctan2(0.6, 0.8)


def payload(key: str) -> bytes:
    return bytes.fromhex(DATA["samples"][key]["payload"])


def padded(data: bytes) -> bytes:
    """As DDS carries it: in whole words of four bytes."""
    return data + bytes(-len(data) % 4)


def test_topics_are_plain_keys_with_nothing_beside_them() -> None:
    assert DATA["samples"].keys() == KINDS.keys()
    assert {sample["attachment"] for sample in DATA["samples"].values()} == {None}


@pytest.mark.parametrize("key", KINDS)
def test_a_message_read_and_written_is_the_same_bytes(key: str) -> None:
    assert padded(cdr.encode(cdr.decode(KINDS[key], payload(key)))) == payload(key)


def test_our_tokens_are_those_of_a_bridge_with_the_same_topics() -> None:
    # floor and diagnostics are no topics of the robot's that was recorded
    options = RosBridgeOptions(dialect="ros2dds", floor="", diagnostics="")
    dialect, ends = Ros2Dds("0"), list(endpoints(options))
    topics = [end for end in ends if end.role is not Role.SERVICE and end.node != "amcl"]
    ours = {token.split("/", 3)[3] for token in list(dialect.tokens(topics))[1:]}
    theirs = {token for token in DATA["tokens"] if token[:2] in ("MP", "MS")}
    # what the robot publishes is there as well
    stated = {end.name.strip("/") for end in topics if end.role is Role.PUBLISHER}
    assert ours == {token for token in theirs if token.startswith("MS/") or token.split("/")[1] in stated}


def test_a_request_carries_its_client_and_number_beside_it() -> None:
    (request,) = DATA["requests"].values()
    assert bytes.fromhex(request["attachment"]) == b"rqh" + struct.pack("<qqB", 77, 5, 1)
    asked = cdr.decode("lifecycle_msgs/srv/GetState_Request", bytes.fromhex(request["payload"]))
    assert asked.structure_needs_at_least_one_member == 0


def test_what_the_robot_published_is_understood() -> None:
    bridge = core()
    (odometry,) = listen(bridge, "%odom", payload("odom"))
    assert from_pose3(odometry.open(Odometry).pose) == pytest.approx([1.5, -2.25, YAW])
    assert odometry.open(Odometry).pose_covariance[35] == pytest.approx(0.35)
    (moved,) = listen(bridge, "%tf", payload("tf"))
    assert from_pose3(moved.open(Odometry).pose) == pytest.approx([1.0, -2.0, YAW])
    assert listen(bridge, "%tf_static", payload("tf_static")) == []
    (output,) = listen(bridge, "%scan", payload("scan"))
    scan = output.open(RawScan)
    assert (scan.mount.x, scan.mount.y, scan.mount.theta) == pytest.approx((1.0, -2.0, YAW))
    assert list(scan.ranges) == [1.0, 2.5, np.inf, 0.0, 3.0]
    assert nanoseconds(scan.timestamp) == TIME


def test_what_we_publish_is_what_cyclone_would_have_written() -> None:
    turn = Quaternion(x=0.0, y=0.0, z=0.6, w=0.8)
    move = FrameTransform(timestamp=stamp(TIME), parent_frame_id="odom", child_frame_id="base_link")
    move.translation.x, move.translation.y, move.translation.z = 1.0, -2.0, 0.1
    move.rotation.CopyFrom(turn)
    assert transforms(move, 0) == payload("tf")
    grid = Grid(timestamp=stamp(TIME), frame_id="map", column_count=3, row_stride=3, cell_stride=1)
    grid.pose.position.x, grid.pose.position.y = 1.5, -2.25
    grid.pose.orientation.CopyFrom(turn)
    grid.cell_size.x = grid.cell_size.y = 0.05
    grid.data = bytes([0, 100, 255, 100, 0, 0])
    assert padded(occupancy_grid(grid)) == payload("map")
    at = Pose2(x=1.5, y=-2.25, theta=YAW)
    tracks = [Track(pose=at, probability=0.75), Track(pose=at, probability=0.25)]
    cloud = particle_cloud(Tracks(timestamp=stamp(TIME), frame_id="map", tracks=tracks))
    ours, theirs = (np.frombuffer(data[4 + 24 :], dtype="<f8") for data in (cloud, payload("particle_cloud")))
    assert cloud[: 4 + 24] == payload("particle_cloud")[: 4 + 24]
    assert ours == pytest.approx(theirs, abs=1e-15)  # from yaw to quaternion the last bit may go
