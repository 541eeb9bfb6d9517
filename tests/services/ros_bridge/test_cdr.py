"""CDR byte for byte as a ROS 2 robot's bag has it, the types' hashes as ROS 2 has them, and damaged bytes."""

import contextlib
import sqlite3
import struct
from contextlib import closing

import numpy as np
import pytest
from eigenscan.geometry.pose import to_message, to_pose3
from eigenscan.ros_bridge import cdr, service_types
from eigenscan.ros_bridge.outbound import (
    occupancy_grid,
    particle_cloud,
    pose_with_covariance,
    transforms,
)
from eigenscan.schemas.envelope import stamp
from eigenscan.schemas.geometry_pb2 import Covariance3
from eigenscan.schemas.tracking_pb2 import PoseEstimate, Track, Tracks
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.environment import DATASETS

BAG = DATASETS / "olin_mac/rosbag2/macfirst_floor_take_2_0.db3"
RECEIVED = (cdr.LASER_SCAN, cdr.ODOMETRY, cdr.TRANSFORMS, cdr.POSE_WITH_COVARIANCE)
TIME = 1_700_000_000_250_000_000


def recorded(kind: str) -> list[bytes]:
    with closing(sqlite3.connect(f"{BAG.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as base:
        rows = base.execute(
            "SELECT data FROM messages JOIN topics ON topics.id = topic_id WHERE type = ?", (kind,)
        )
        return [row[0] for row in rows]


@pytest.mark.dataset
@pytest.mark.parametrize("kind", [cdr.LASER_SCAN, cdr.ODOMETRY, cdr.TRANSFORMS])
def test_every_recorded_message_is_encoded_to_its_own_bytes(kind: str) -> None:
    messages = recorded(kind)
    assert len(messages) > 300
    assert all(cdr.encode(cdr.decode(kind, data)) == data for data in messages)


def assert_is_message_or_refused(kind: str, data: bytes) -> None:
    with contextlib.suppress(cdr.CdrError):
        assert cdr.decode(kind, data).__msgtype__ == kind


@pytest.mark.dataset
@settings(max_examples=300, deadline=None)
@given(st.data())
def test_damaged_messages_are_refused_and_nothing_else(data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from((cdr.LASER_SCAN, cdr.ODOMETRY, cdr.TRANSFORMS)))
    damaged = bytearray(recorded(kind)[0])
    for _ in range(data.draw(st.integers(1, 8))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(damaged)))
    for taken_as in RECEIVED:
        assert_is_message_or_refused(taken_as, bytes(damaged[:cut]))


@given(st.sampled_from(RECEIVED), st.binary(max_size=200))
def test_any_bytes_are_a_message_or_refused(kind: str, data: bytes) -> None:
    assert_is_message_or_refused(kind, data)


# what follows is laid out by hand, field by field, as OMG's CDR has it (XTypes 7.4, version 1)
HEADER = struct.pack("<4BiI", 0, 1, 0, 0, 1_700_000_000, 250_000_000)


def text(value: str) -> bytes:
    return struct.pack("<I", len(value) + 1) + value.encode() + b"\0"


def test_a_pose_field_by_field() -> None:
    estimate = PoseEstimate(
        timestamp=stamp(TIME),
        frame_id="map",
        pose=to_message((1.5, -2.25, np.pi / 2)),
        covariance=Covariance3(xx=0.01, xy=0.002, xt=0.003, yy=0.04, yt=0.005, tt=0.06),
    )
    covariance = np.zeros((6, 6))
    covariance[0, [0, 1, 5]] = 0.01, 0.002, 0.003
    covariance[1, [0, 1, 5]] = 0.002, 0.04, 0.005
    covariance[5, [0, 1, 5]] = 0.003, 0.005, 0.06
    z, w = np.sin(np.pi / 4), np.cos(np.pi / 4)
    # the frame's 4 + 4 bytes end at 16, where the doubles may begin
    expected = HEADER + text("map") + struct.pack("<7d", 1.5, -2.25, 0.0, 0.0, 0.0, z, w)
    data = pose_with_covariance(estimate)
    assert data == expected + covariance.tobytes()


def test_a_transform_field_by_field() -> None:
    turn = to_pose3((0.0, 0.0, 1.0)).orientation
    message = FrameTransform(
        timestamp=stamp(TIME), parent_frame_id="map", child_frame_id="odom", rotation=turn
    )
    message.translation.x = 3.0
    expected = HEADER[:4] + struct.pack("<IiI", 1, 1_700_000_000, 350_000_000) + text("map") + text("odom")
    expected += b"\0" * (-(len(expected) - 4) % 8)
    expected += struct.pack("<7d", 3.0, 0.0, 0.0, 0.0, 0.0, turn.z, turn.w)
    assert transforms(message, 100_000_000) == expected


def test_particles_are_the_tracks_with_their_probabilities() -> None:
    tracks = [Track(pose=to_message((1.0, 2.0, 0.5)), probability=0.75), Track(probability=0.25)]
    data = particle_cloud(Tracks(timestamp=stamp(TIME), frame_id="map", tracks=tracks))
    body = cdr.decode(cdr.PARTICLE_CLOUD, data)
    assert body.header.frame_id == "map"
    assert [(p.pose.position.x, p.pose.position.y, p.weight) for p in body.particles] == [
        (1.0, 2.0, 0.75),
        (0.0, 0.0, 0.25),
    ]
    # header, count, then 8 doubles each, aligned to 8
    assert len(data) == 4 + 16 + 8 + 2 * 64


def test_a_map_cell_by_cell() -> None:
    grid = Grid(frame_id="map", pose=to_pose3((-1.0, 2.0, 0.0)), column_count=3, row_stride=3, cell_stride=1)
    grid.cell_size.x = grid.cell_size.y = 0.05
    grid.data = bytes([0, 100, 255, 100, 0, 0])
    body = cdr.decode(cdr.OCCUPANCY_GRID, occupancy_grid(grid))
    assert (body.info.width, body.info.height) == (3, 2)
    assert body.info.resolution == pytest.approx(0.05)
    assert (body.info.origin.position.x, body.info.origin.position.y) == (-1.0, 2.0)
    assert body.data.tolist() == [0, 100, -1, 100, 0, 0]


def test_hashes_are_those_of_ros_2() -> None:
    """Known from ROS 2 itself: std_msgs/String is in rmw_zenoh's design document."""
    string = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert cdr.type_hash("std_msgs/msg/String") == string


def test_the_hash_of_a_service_is_that_of_ros_2(monkeypatch: pytest.MonkeyPatch) -> None:
    """AddTwoInts is in rmw_zenoh's design document."""
    kind = "example_interfaces/srv/AddTwoInts"
    monkeypatch.setitem(service_types.SERVICES, kind, ("int64 a\nint64 b", "int64 sum"))
    known = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
    assert service_types.service_hash(kind) == known


def test_the_hash_of_a_service_with_other_messages_in_it_is_that_of_ros_2() -> None:
    """In the liveliness tokens of every ROS 2 node."""
    known = "RIHS01_bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc"
    assert cdr.type_hash(service_types.GET_PARAMETERS) == known


@pytest.mark.parametrize(
    "kind",
    [
        cdr.LASER_SCAN,
        cdr.POINT_CLOUD,
        cdr.ODOMETRY,
        cdr.TRANSFORMS,
        cdr.POSE_WITH_COVARIANCE,
        cdr.OCCUPANCY_GRID,
        cdr.DIAGNOSTICS,
    ],
)
def test_hashes_are_the_same_in_all_releases(kind: str) -> None:
    from rosbags.typesys import Stores, get_typestore

    releases = [store for store in Stores if store.value.startswith("ros2_")]
    assert {get_typestore(store).hash_rihs01(kind) for store in releases} == {cdr.type_hash(kind)}
