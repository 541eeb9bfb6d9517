from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.pose import from_message, from_pose3
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import stamp
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.logs import open_log
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import Message
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

S = 1_000_000_000
AHEAD = Quaternion(w=1.0)


def write(path: Path, published: list[tuple[str, int, Message]]) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels: dict[str, int] = {}
        for topic, time, message in published:
            if topic not in channels:
                name = message.DESCRIPTOR.full_name
                schema = writer.register_schema(name, SchemaEncoding.Protobuf, b"")
                channels[topic] = writer.register_channel(topic, MessageEncoding.Protobuf, schema)
            writer.add_message(channels[topic], time, message.SerializeToString(), time)
        writer.finish()
    return path


def mount(parent: str, child: str, x: float, time: int) -> FrameTransform:
    return FrameTransform(
        timestamp=stamp(time),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=Vector3(x=x),
        rotation=AHEAD,
    )


def scan(time: int, **fields: object) -> LaserScan:
    given: dict[str, object] = {
        "start_angle": -1.0,
        "end_angle": 1.0,
        "ranges": [1.0, 2.0, 3.0, math.inf, 5.0],
        "pose": Pose(orientation=AHEAD),
    }
    return LaserScan(timestamp=stamp(time), frame_id="laser", **(given | fields))  # type: ignore[arg-type]


def test_scans_mounts_and_odometry(tmp_path: Path) -> None:
    published: list[tuple[str, int, Message]] = []
    for number in range(10):
        time = (number + 1) * S
        pose = Pose(position=Vector3(x=number), orientation=AHEAD)
        published += [
            ("/tf", time, FrameTransforms(transforms=[mount("base", "laser", 0.25, time)])),
            ("/odometry", time, Odometry(timestamp=stamp(time), body_frame_id="base", pose=pose)),
            ("/scan", time, scan(time)),
        ]
    log = open_log(write(tmp_path / "a.mcap", published))
    received = list(log.envelopes())
    scans = [e.open(RawScan) for e in received if e.channel is SCAN_RAW]
    moved = [from_pose3(e.open(Odometry).pose)[0] for e in received if e.channel is ODOMETRY]
    assert len(scans) == 10
    assert moved == list(range(10))
    assert received[0].stamp == S
    np.testing.assert_allclose(from_message(scans[3].mount), [0.25, 0, 0])
    assert (scans[3].angle_min, scans[3].angle_increment, scans[3].range_max) == (-1.0, 0.5, 0.0)
    assert list(scans[3].ranges) == [1, 2, 3, math.inf, 5]


@pytest.mark.parametrize("single", [True, False])
def test_odometry_may_be_a_transform(tmp_path: Path, single: bool) -> None:
    published: list[tuple[str, int, Message]] = []
    for number in range(10):
        time = (number + 1) * S
        items = [mount("odom", "base_link", number, time), mount("base_link", "laser", 0.25, time)]
        published += [("/tf", time, FrameTransforms(transforms=items))] if not single else []
        published += [(f"/tf/{item.child_frame_id}", time, item) for item in items] if single else []
        published.append(("/scan", time, scan(time)))
    received = list(open_log(write(tmp_path / "a.mcap", published)).envelopes())
    moved = [from_pose3(e.open(Odometry).pose)[0] for e in received if e.channel is ODOMETRY]
    assert moved == list(range(10))
    np.testing.assert_allclose(from_message(received[1].open(RawScan).mount), [0.25, 0, 0])


def test_a_scan_away_from_its_frame_is_counted(tmp_path: Path) -> None:
    off = Pose(position=Vector3(x=1.0), orientation=AHEAD)
    published: list[tuple[str, int, Message]] = [
        ("/scan", S, scan(S)),
        ("/scan", 2 * S, scan(2 * S, pose=off)),
    ]
    log = open_log(write(tmp_path / "a.mcap", published))
    assert sum(e.channel is SCAN_RAW for e in log.envelopes()) == 1
    assert log.counters["undecodable_message"] == 1
