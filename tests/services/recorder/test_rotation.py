"""Files that follow each other: complete each, nothing lost between them, and no more of them than fit."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from eigenscan.recorder.files import Limits
from eigenscan.recorder.mcap_sink import McapSink
from eigenscan.runtime.recording import read, read_metadata
from eigenscan.schemas.channels import HEALTH, MAP, MODEL_SET, POSE
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.schemas.wire import encode
from foxglove_schemas_protobuf.Grid_pb2 import Grid

from tests.services.recorder.traffic import Site

pytestmark = pytest.mark.slow

S = 1_000_000_000
ADDRESS = {"site": "s", "robot": "r"}
COUNT = 600


class Clock:
    def __init__(self) -> None:
        self.now = 1_700_000_000 * S

    def __call__(self) -> int:
        return self.now


def fill(folder: Path, limits: Limits, count: int = COUNT) -> McapSink:
    """A map, then poses, 10 a second; noise in them that does not compress."""
    clock = Clock()
    sink = McapSink(folder, "s", clock, 0.5, {"recorder": {"settings": "{}"}}, limits)
    sink.write(Envelope(MAP, ADDRESS, Grid(frame_id="map", data=b"cells")))
    for number in range(count):
        clock.now += S // 10
        pose = PoseEstimate(timestamp=stamp(number + 1), frame_id=os.urandom(400).hex())
        sink.write(Envelope(POSE, ADDRESS, pose))
    sink.close()
    return sink


def test_a_file_that_another_recorder_writes_is_not_deleted_to_make_room(tmp_path: Path) -> None:
    clock = Clock()
    other = McapSink(tmp_path, "s", clock, 0.5, {})
    other.write(Envelope(POSE, ADDRESS, PoseEstimate(timestamp=stamp(1), frame_id="map")))
    written = other.path
    assert written is not None
    filled = fill(tmp_path, Limits(file_bytes=50_000, total_bytes=100_000))
    assert filled.counters["mcap_deleted"] > 0
    other.close()
    assert numbers(written) == [1]


def numbers(path: Path) -> list[int]:
    return [record.publish_time for record in read(path) if record.envelope.channel is POSE]


@pytest.mark.parametrize("limits", [Limits(file_bytes=50_000), Limits(file_ns=7 * S)])
def test_the_next_file_begins_when_one_is_full_and_explains_itself(tmp_path: Path, limits: Limits) -> None:
    sink = fill(tmp_path, limits)
    files = sorted(tmp_path.glob("*.mcap"))
    assert len(files) > 4
    assert sink.counters["mcap_files"] == len(files)
    for file in files:
        first = next(read(file))
        assert first.envelope.open(Grid).data == b"cells"
        if limits.file_bytes:
            assert file.stat().st_size < 2 * limits.file_bytes
    assert sorted(number for file in files for number in numbers(file)) == list(range(1, COUNT + 1))


def test_a_head_that_fills_a_file_does_not_begin_one_for_each_message(tmp_path: Path) -> None:
    """The map and the models of a large site may take more than an eighth of the budget."""
    clock = Clock()
    sink = McapSink(tmp_path, "s", clock, 0.5, {}, Limits(file_bytes=50_000))
    sink.write(Envelope(MAP, ADDRESS, Grid(frame_id="map", data=os.urandom(200_000))))
    for number in range(COUNT):
        clock.now += S // 10
        pose = PoseEstimate(timestamp=stamp(number + 1), frame_id=os.urandom(400).hex())
        sink.write(Envelope(POSE, ADDRESS, pose))
    sink.close()
    files = sorted(tmp_path.glob("*.mcap"))
    assert 2 <= len(files) <= 4
    assert numbers_of(files) == list(range(1, COUNT + 1))


def test_each_file_shows_who_ran_with_which_settings_on_which_models(tmp_path: Path) -> None:
    clock = Clock()
    sink = McapSink(tmp_path, "s", clock, 0.5, {}, Limits(file_ns=5 * S))
    entries = [ModelSet.Entry(region="hall", version="h1")]
    sink.write(Envelope(MODEL_SET, {"site": "s"}, ModelSet(version="v1", map_version="m1", entries=entries)))
    for settings in ('{"trust": 0.2}', '{"trust": 0.3}'):
        health = Health(service="tracker", instance="r17", package_version="1.2.3", settings=settings)
        address = {"site": "s", "service": "tracker", "instance": "r17"}
        for _ in range(5):
            clock.now += S
            sink.write(Envelope(HEALTH, address, health))
    sink.close()
    first, *_, last = sorted(tmp_path.glob("*.mcap"))
    for path, trust in ((first, 0.2), (last, 0.3)):
        found = read_metadata(path)
        reported = json.loads(found["services"]["tracker/r17"])
        assert (reported["version"], json.loads(reported["settings"])) == ("1.2.3", {"trust": trust})
        models = json.loads(found["models"]["s/models"])
        assert models == {"version": "v1", "map": "m1", "regions": {"hall": "h1"}}


def test_a_folder_reads_as_one_recording(tmp_path: Path) -> None:
    fill(tmp_path / "rotated", Limits(file_bytes=50_000))
    assert numbers(tmp_path / "rotated") == list(range(1, COUNT + 1))
    maps = [record for record in read(tmp_path / "rotated") if record.envelope.channel is MAP]
    assert len(maps) == 1


def test_the_oldest_files_go_and_no_others(tmp_path: Path) -> None:
    other = tmp_path / "t-20200101-000000.mcap"
    notes = tmp_path / "notes.mcap"
    for file in (other, notes):
        file.write_bytes(bytes(300_000))
        os.utime(file, ns=(1, 1))
    budget = 200_000
    sink = fill(tmp_path, Limits(file_bytes=50_000, total_bytes=budget))
    own = list(tmp_path.glob("s-*.mcap"))
    assert sum(file.stat().st_size for file in own) < budget + 2 * 50_000
    assert sink.counters["mcap_deleted"] == sink.counters["mcap_files"] - len(own) > 0
    assert other.exists()
    assert notes.exists()
    kept = numbers_of(own)
    assert kept == list(range(COUNT + 1 - len(kept), COUNT + 1))


def numbers_of(files: list[Path]) -> list[int]:
    return sorted(number for file in files for number in numbers(file))


def test_a_process_rotates_within_its_budget_and_replay_joins_its_files(
    start_recorder: Callable[..., Any], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    recorder = start_recorder("--mcap", str(out), "--rotate-minutes", "0.02")
    sent = [message for message in Site(recorder.site, seconds=4.0).messages() if message.channel is POSE]
    for message in sent:
        recorder.bus.publish(message)
        time.sleep(0.1)
    health = recorder.await_health(lambda health: health.counters.get("heard_pose", 0) == len(sent))
    # its own health goes on, once a second
    recorder.await_health(lambda health: health.counters.get("mcap_files", 0) >= 3)
    assert {"mcap_slow", "mcap_slowest_ms", "waiting"} <= set(health.counters)
    assert recorder.stop() == 0
    files = list(out.glob("*.mcap"))
    assert len(files) >= 3
    received = [encode(record.envelope.message) for record in read(out) if record.envelope.channel is POSE]
    assert received == [encode(message.message) for message in sent]
    drawn = subprocess.run(
        [Path(sys.executable).parent / "eigenscan", "view", out, "--no-open", "--rrd", tmp_path / "a.rrd"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert drawn.returncode == 0, drawn.stderr


def test_a_budget_that_holds_no_two_files_is_refused(tmp_path: Path) -> None:
    flags = ["--mcap", "x", "--budget-mb", "100", "--rotate-mb", "60"]
    done = subprocess.run(
        [sys.executable, "-m", "eigenscan.recorder.node", *flags],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "rotate_mb = 60 is more than half of budget_mb = 100" in done.stderr
