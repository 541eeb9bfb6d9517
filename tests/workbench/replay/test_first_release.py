"""What the first release recorded decodes and replays without end."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from pathlib import Path

import pytest
from eigenscan.geometry.pose import from_pose3
from eigenscan.runtime.recording import is_complete, read, read_metadata
from eigenscan.schemas.channels import POSE, TRUTH, Channel
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.evolution import breaks, contract
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.schemas.wire import encode
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.unknown_fields import UnknownFieldSet
from mcap.reader import make_reader

from tests.workbench.replay.conftest import Command

DEPOT = Path(__file__).parent / "first_release/depot.mcap"
SHA256 = "482c3f97dccd5b5695b62914ee2a9c519f09ac9fddadf1347917953bac7fc773"
SCANS = 20
HELD = {
    **dict.fromkeys(("scan_raw", "scan", "truth", "hypotheses", "obstacles", "pose", "tracks"), SCANS),
    **{"odometry": 200, "transform": 198, "map": 1, "model": 4, "model_set": 1},
}
WRONG_M, WRONG_RAD = 0.5, math.radians(10.0)


def test_it_is_the_file_that_was_recorded_then() -> None:
    assert hashlib.sha256(DEPOT.read_bytes()).hexdigest() == SHA256, "it is never made anew"


def test_every_message_decodes_to_the_same_fields() -> None:
    assert is_complete(DEPOT)
    assert "settings" in read_metadata(DEPOT)["recorder"]
    counts: Counter[str] = Counter()
    with DEPOT.open("rb") as file:
        written = {
            (channel.topic, record.sequence): record.data
            for _, channel, record in make_reader(file).iter_messages()
        }
    bytes_then = sorted(written.values())
    decoded = [record.envelope for record in read(DEPOT)]
    for envelope in decoded:
        counts[envelope.channel.name] += 1
        assert not len(UnknownFieldSet(envelope.message)), envelope.key
    assert sorted(encode(envelope.message) for envelope in decoded) == bytes_then
    assert counts.pop("health") > 10
    assert counts == HELD


def test_no_field_of_then_was_changed_or_taken_away() -> None:
    with DEPOT.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    files = {
        part.name: part
        for schema in summary.schemas.values()
        for part in FileDescriptorSet.FromString(schema.data).file
        if part.package == "eigenscan"
    }
    assert len(files) >= 6
    assert breaks(FileDescriptorSet(file=files.values()), contract()) == []


@pytest.mark.parametrize("service", ["scan-ingest", "projector", "tracker", "pipeline"])
def test_it_replays_into_the_services_of_today(service: str, eigenscan: Command, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    ended = eigenscan("replay", DEPOT, "--service", service, "--out", out)
    assert ended.code == 0, ended.out + ended.err
    assert "settings as recorded" in ended.out
    if service not in ("tracker", "pipeline"):
        return
    poses = [one for one in published(out, POSE) if isinstance(one, PoseEstimate)]
    assert len(poses) == SCANS
    truth = {
        nanoseconds(one.timestamp): one for one in published(DEPOT, TRUTH) if isinstance(one, PoseInFrame)
    }
    claimed = [pose for pose in poses if pose.state == STATE_LOCALIZED]
    assert len(claimed) >= SCANS // 2
    for pose in claimed:
        x, y, theta = from_pose3(truth[nanoseconds(pose.timestamp)].pose).tolist()
        assert math.hypot(pose.pose.x - x, pose.pose.y - y) < WRONG_M
        assert abs(math.remainder(pose.pose.theta - theta, math.tau)) < WRONG_RAD


def published(path: Path, channel: Channel) -> list[object]:
    return [record.envelope.message for record in read(path) if record.envelope.channel is channel]
