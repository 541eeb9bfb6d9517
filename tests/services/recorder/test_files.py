"""Names and order of a recorder's files, also with a clock that is set back and with a second recorder."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from eigenscan.recorder.files import Files, Limits
from eigenscan.recorder.mcap_sink import McapSink
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import POSE
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.tracking_pb2 import PoseEstimate

S = 1_000_000_000
NOON = 1_700_000_000 * S
HOUR = 3600 * S


def holding(files: Files, now: int, size: int = 1000) -> Path:
    path = files.begin(now)
    path.write_bytes(bytes(size))
    return path


def pose(number: int) -> Envelope:
    # noise that does not compress
    message = PoseEstimate(timestamp=stamp(number), frame_id=os.urandom(400).hex())
    return Envelope(POSE, {"site": "s", "robot": "r"}, message)


def test_the_oldest_is_the_one_that_began_first_not_the_one_that_was_touched_first(tmp_path: Path) -> None:
    earlier = Files(tmp_path, "s")
    first, second = holding(earlier, NOON), holding(earlier, NOON + HOUR)
    os.utime(second, ns=(0, 0))  # as after a copy from elsewhere
    assert Files(tmp_path, "s").make_room(1000) == 1
    assert not first.exists()
    assert second.exists()


def test_after_the_clock_is_set_back_the_newest_files_are_kept(tmp_path: Path) -> None:
    files = Files(tmp_path, "s")
    first, second = holding(files, NOON), holding(files, NOON + HOUR)
    third = holding(files, NOON - 5 * HOUR)
    assert files.make_room(2000) == 1
    assert [path.exists() for path in (first, second, third)] == [False, True, True]


def test_after_the_tenth_file_of_a_second_comes_the_eleventh(tmp_path: Path) -> None:
    made = [holding(Files(tmp_path, "s"), NOON) for _ in range(12)]
    assert Files(tmp_path, "s").own() == made


@pytest.mark.parametrize("target", ["", "rec.mcap"])
def test_the_name_of_a_deleted_file_is_not_used_again(tmp_path: Path, target: str) -> None:
    files = Files(tmp_path / target, "s")
    first, second = holding(files, NOON), holding(files, NOON)
    assert files.make_room(1000) == 1
    third = holding(Files(tmp_path / target, "s"), NOON)
    assert third != first
    assert Files(tmp_path / target, "s").own() == [second, third]


def test_two_recorders_that_begin_at_once_take_two_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other: list[Path] = []
    touch = Path.touch

    def late(path: Path, mode: int = 0o666, exist_ok: bool = True) -> None:
        if not other:
            other.append(path)
            holding(Files(tmp_path, "s"), NOON)  # between this one's look and its file
        touch(path, mode, exist_ok)

    monkeypatch.setattr(Path, "touch", late)
    path = Files(tmp_path, "s").begin(NOON)
    assert path not in other
    assert other[0].stat().st_size == 1000


def test_a_file_that_another_recorder_deletes_meanwhile_does_no_harm(tmp_path: Path) -> None:
    (tmp_path / "s-20200101-000000.mcap").symlink_to(tmp_path / "deleted")  # listed, and not there
    files = Files(tmp_path, "s")
    last = [holding(files, NOON) for _ in range(2)][-1]
    files.make_room(1000)
    assert files.own() == [last]


def test_two_recorders_with_a_budget_lose_nothing_of_what_they_write(tmp_path: Path) -> None:
    limits = Limits(file_bytes=20_000, total_bytes=60_000)
    sinks = [McapSink(tmp_path, "s", lambda: NOON, 0.0, {}, limits) for _ in range(2)]
    for number in range(1, 301):
        for sink in sinks:
            sink.write(pose(number))
    for sink in sinks:
        sink.close()
        assert sink.counters["mcap_lost"] == 0
    assert sum(sink.counters["mcap_deleted"] for sink in sinks) > 0
    kept = [record.publish_time for path in Files(tmp_path, "s").own() for record in read(path)]
    # each message twice, and of both recorders the newest
    assert sorted(kept)[-20:] == sorted([*range(291, 301)] * 2)


def test_what_cannot_be_deleted_does_not_end_the_recording(tmp_path: Path) -> None:
    files = Files(tmp_path, "site")
    (tmp_path / "site-20010101-000000.mcap").mkdir()
    for number in range(3):
        holding(files, NOON + number * HOUR)
    assert files.make_room(1000 + (tmp_path / "site-20010101-000000.mcap").stat().st_size) == 2
    assert len(files.own()) == 2
    assert files.stuck == [f"{tmp_path / 'site-20010101-000000.mcap'}: Is a directory"]
