"""`eigenscan repair`: what a killed recorder left, cut and damaged files, and files that are none."""

from __future__ import annotations

import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from eigenscan.runtime.recording import RecordingError, RecordingWriter, is_complete, read, read_metadata
from eigenscan.runtime.repair import is_sound, repair
from eigenscan.schemas.channels import POSE
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

pytestmark = pytest.mark.slow

COUNT = 300
KILLS = 4


def eigenscan(*arguments: object) -> subprocess.CompletedProcess[str]:
    program = Path(sys.executable).parent / "eigenscan"
    return subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, check=False)


def stamps(path: Path) -> list[int]:
    return [record.publish_time for record in read(path) if record.envelope.channel is POSE]


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    """COUNT poses, ten in a chunk."""
    path = tmp_path / "whole.mcap"
    with RecordingWriter(path, {"recorder": {"settings": "{}"}}) as writer:
        for number in range(1, COUNT + 1):
            message = PoseEstimate(timestamp=stamp(number))
            writer.write(Envelope(POSE, {"site": "s", "robot": "r"}, message), number, number)
            if number % 10 == 0:
                writer.flush()
    return path


@pytest.mark.parametrize("seed", range(KILLS))
def test_a_recorder_killed_at_any_moment_leaves_all_that_was_on_disk(
    start_recorder: Callable[..., Any], tmp_path: Path, seed: int
) -> None:
    recorder = start_recorder("--mcap", str(tmp_path / "k.mcap"))
    address = {"site": recorder.site, "robot": "r1"}
    published: list[int] = []

    def send() -> None:
        published.append(time.time_ns())
        recorder.bus.publish(Envelope(POSE, address, PoseEstimate(timestamp=stamp(published[-1]))))
        time.sleep(0.004)

    on_disk = recorder.await_on_disk(tmp_path / "k.mcap", random.Random(seed).randint(50, 500), send)
    recorder.process.send_signal(signal.SIGKILL)
    recorder.process.wait()
    damaged = tmp_path / "k.mcap"
    assert not is_complete(damaged)
    before = damaged.read_bytes()
    done = eigenscan("repair", damaged)
    assert done.returncode == 0, done.stderr
    assert damaged.read_bytes() == before
    repaired = tmp_path / "k.repaired.mcap"
    assert is_complete(repaired)
    assert is_sound(repaired)
    kept = stamps(repaired)
    assert kept == published[: len(kept)]
    assert len(kept) >= len(on_disk)
    assert stamps(tmp_path) == kept  # of both files in the folder, the repaired one counts
    assert read_metadata(repaired)["recorder"]


def test_a_file_cut_anywhere_gives_whole_messages_of_its_start(whole: Path, tmp_path: Path) -> None:
    content = whole.read_bytes()
    most = 0
    for number, size in enumerate(range(0, len(content), 97)):
        cut, target = tmp_path / f"{number}.mcap", tmp_path / f"{number}-saved.mcap"
        cut.write_bytes(content[:size])
        try:
            found = repair(cut, target)
        except RecordingError:
            assert not target.exists()
            assert not most  # once there is a whole chunk, it is saved from all longer files
            continue
        kept = stamps(target)
        assert kept == list(range(1, len(kept) + 1))
        assert found.messages == len(kept) >= most
        assert found.cut
        most = len(kept)
    assert most == COUNT


def test_a_damaged_chunk_costs_itself_alone(whole: Path, tmp_path: Path) -> None:
    chunks = chunks_of(whole)
    content = bytearray(whole.read_bytes())
    place = content.index(chunks[7].data)
    content[place + len(chunks[7].data) // 2] ^= 0xFF
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    with pytest.raises(RecordingError):
        list(read(damaged))
    done = eigenscan("repair", damaged, "-o", tmp_path / "saved.mcap")
    assert done.returncode == 0, done.stderr
    assert "damaged chunks, lost: 1, messages lost: 10" in done.stdout
    assert stamps(tmp_path / "saved.mcap") == [n for n in range(1, COUNT + 1) if not 70 < n <= 80]


@pytest.mark.parametrize("size", [40, 3000])
def test_a_hole_across_chunks_costs_those_that_it_touches(whole: Path, tmp_path: Path, size: int) -> None:
    """The index at the file's end still finds all that follow."""
    content = bytearray(whole.read_bytes())
    with whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    begins = [one.chunk_start_offset for one in summary.chunk_indexes]
    begin = begins[7] + 1  # the chunk's own length
    content[begin : begin + size] = b"\xff" * size
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    found = repair(damaged, tmp_path / "saved.mcap")
    touched = sum(1 for one in begins[7:] if one < begin + size)
    lost = range(71, 71 + 10 * touched)
    assert stamps(tmp_path / "saved.mcap") == [n for n in range(1, COUNT + 1) if n not in lost]
    assert (found.lost_chunks, found.cut) == (touched, False)
    assert found.lost_messages == len(lost)


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize(("first", "size"), [(7, 40), (7, 3000), (0, 3000)])
def test_a_part_that_is_gone_costs_the_chunks_that_it_touches(
    tmp_path: Path, compression: CompressionType, first: int, size: int
) -> None:
    """7 of 6742 messages were saved, for the index no longer pointed to any chunk behind the part."""
    sound = tmp_path / "sound.mcap"
    with sound.open("wb") as file:
        writer = Writer(file, chunk_size=512, compression=compression)
        writer.start()
        channel = writer.register_channel("a", "json", writer.register_schema("s", "", b""))
        for number in range(1, COUNT + 1):
            writer.add_message(channel, number, random.Random(number).randbytes(50), number)
        writer.finish()
    with sound.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    begins = [one.chunk_start_offset for one in summary.chunk_indexes]
    per_chunk = [one.message_start_time for one in summary.chunk_indexes]
    content = sound.read_bytes()
    damaged, target = tmp_path / "damaged.mcap", tmp_path / "saved.mcap"
    gone = begins[first] + 60
    damaged.write_bytes(content[:gone] + content[gone + size :])
    assert not is_sound(damaged)
    found = repair(damaged, target)
    last = next(k for k, begin in enumerate(begins) if begin >= gone + size)
    lost = range(per_chunk[first], per_chunk[last])
    with target.open("rb") as file:
        saved = [message.log_time for *_, message in make_reader(file).iter_messages()]
    assert saved == [number for number in range(1, COUNT + 1) if number not in lost]
    assert (found.lost_chunks, found.lost_messages, found.cut) == (last - first, len(lost), False)


def test_heads_of_chunks_without_end_cost_no_time(whole: Path, tmp_path: Path) -> None:
    """Each states all that follows it as its own."""
    content = whole.read_bytes()
    start, rest = content[:2000], bytearray(b"\xff" * 9)
    heads, most = 100_000, 100_000 * 57
    for number in range(heads):
        packed = most - 57 * (number + 1)
        rest += b"\x06" + (44 + packed).to_bytes(8, "little") + bytes(16) + (2**20).to_bytes(8, "little")
        rest += bytes(4) + b"\x04\0\0\0zstd" + packed.to_bytes(8, "little")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(start + rest)
    began = time.process_time()
    assert repair(damaged, tmp_path / "saved.mcap").cut
    assert time.process_time() - began < 20.0


def chunks_of(path: Path) -> list[Chunk]:
    with path.open("rb") as file:
        return [one for one in StreamReader(file, emit_chunks=True).records if isinstance(one, Chunk)]


def test_foreign_channels_and_attachments_are_saved_as_well(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_attachment(1, 2, "map.yaml", "text/yaml", b"resolution: 0.05")
        number = writer.register_channel("/camera", "json", 0)
        writer.add_message(number, 5, b"{}", 4, 3)
        writer.finish()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:-40])
    repair(cut, tmp_path / "saved.mcap")
    with (tmp_path / "saved.mcap").open("rb") as file:
        reader = make_reader(file)
        ((_, channel, message),) = reader.iter_messages()
        (attachment,) = reader.iter_attachments()
    assert (channel.topic, message.data, message.log_time, message.publish_time, message.sequence) == (
        *("/camera", b"{}", 5),
        *(4, 3),
    )
    assert (attachment.name, attachment.data) == ("map.yaml", b"resolution: 0.05")


def test_whole_files_get_none_and_nothing_is_overwritten(whole: Path, tmp_path: Path) -> None:
    done = eigenscan("repair", whole)
    assert done.returncode == 0
    assert "nothing to repair" in done.stdout
    assert list(tmp_path.iterdir()) == [whole]
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:-30])
    shutil.copy(whole, tmp_path / "there.mcap")
    done = eigenscan("repair", cut, "-o", tmp_path / "there.mcap")
    assert done.returncode == 2
    assert "is a recorder's file: name another one" in done.stderr
    assert (tmp_path / "there.mcap").read_bytes() == whole.read_bytes()


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", b"scan 1 2 3\n" * 20, bytes(500)])
def test_what_is_no_recording_is_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    done = eigenscan("repair", path)
    assert done.returncode == 2
    assert "other.mcap" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == [path]


def test_two_recordings_one_after_the_other_are_no_whole_one(whole: Path, tmp_path: Path) -> None:
    joined = tmp_path / "joined.mcap"
    joined.write_bytes(2 * whole.read_bytes())
    assert not is_sound(joined)
    found = repair(joined, tmp_path / "saved.mcap")
    assert (found.messages, found.beyond, found.cut) == (COUNT, whole.stat().st_size, False)
    assert stamps(tmp_path / "saved.mcap") == stamps(whole)
    ran = eigenscan("repair", joined, "-o", tmp_path / "again.mcap")
    assert ran.returncode == 0
    assert f"{whole.stat().st_size} bytes after its end, left out: another recording?" in ran.stdout
