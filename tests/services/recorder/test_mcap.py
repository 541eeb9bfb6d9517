"""What a real recorder process writes of real traffic, read with nothing of ours but the file."""

from __future__ import annotations

import errno
import itertools
import resource
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
import zenoh
from eigenscan.recorder.core import RecorderCore
from eigenscan.recorder.files import Limits
from eigenscan.recorder.mcap_sink import RETRY_S, McapSink
from eigenscan.recorder.node import batch_s, make_core
from eigenscan.recorder.options import RecorderOptions
from eigenscan.runtime.errors import one_line
from eigenscan.runtime.recording import RecordingWriter, read
from eigenscan.schemas.channels import CHANNELS, HEALTH, MAP, POSE, TRACKS
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tick import tick
from eigenscan.schemas.tracking_pb2 import PoseEstimate, Tracks
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass
from mcap.reader import make_reader
from mcap.records import Schema

from tests.services.recorder.conftest import PATIENCE_S
from tests.services.recorder.traffic import Site

S = 1_000_000_000


def decoder(schema: Schema) -> type[Message]:
    """Message class of the descriptors in the file alone, in a pool that knows nothing else."""
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(schema.name))


def contents(path: Path) -> list[tuple[str, Message, Any]]:
    """Topic, message decoded by the file's own schema, and the MCAP record, in log order."""
    classes: dict[str, type[Message]] = {}
    found = []
    with path.open("rb") as file:
        for schema, channel, record in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            if schema.name not in classes:
                classes[schema.name] = decoder(schema)
            found.append((channel.topic, classes[schema.name].FromString(record.data), record))
    return found


def publish(recorder: Any, messages: list[Envelope], pause_s: float = 0.0) -> None:
    for message in messages:
        recorder.bus.publish(message)
        if pause_s:
            time.sleep(pause_s)


def only_file(folder: Path) -> Path:
    (path,) = folder.glob("*.mcap")
    return path


def test_every_message_is_in_the_file_and_decodes_with_the_schema_there(
    start_recorder: Callable[..., Any], tmp_path: Path
) -> None:
    before = time.time_ns()
    recorder = start_recorder("--mcap", str(tmp_path / "out"))
    sent = list(Site(recorder.site, seconds=2.0).messages())
    assert {message.channel for message in sent} == set(CHANNELS)
    publish(recorder, sent, pause_s=0.001)
    recorder.await_written(sent)
    assert recorder.stop() == 0

    path = only_file(tmp_path / "out")
    assert path.name.startswith(recorder.site)
    judged = subprocess.run(
        [sys.executable, "-m", "rerun", "mcap", "check", str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert judged.returncode == 0, judged.stdout + judged.stderr
    found = contents(path)
    times = [record.log_time for _, _, record in found]
    assert before <= times[0]
    assert times == sorted(times)
    assert times[-1] <= time.time_ns()
    for key in {message.key for message in sent}:
        expected = [message.message for message in sent if message.key == key]
        recorded = [(message, record) for topic, message, record in found if topic == key]
        if "/health/" not in key:
            assert len(recorded) == len(expected)
        for wanted, (message, record) in zip(expected, recorded, strict=False):
            assert message.SerializeToString(deterministic=True) == wanted.SerializeToString(
                deterministic=True
            )
            stamped = getattr(wanted, "timestamp", None)
            moment = nanoseconds(stamped) if stamped else 0
            assert record.publish_time == (moment or record.log_time)


def test_the_file_is_indexed_and_compressed(start_recorder: Callable[..., Any], tmp_path: Path) -> None:
    recorder = start_recorder("--mcap", str(tmp_path / "named.mcap"))
    sent = list(Site(recorder.site, seconds=1.0).messages())
    publish(recorder, sent, pause_s=0.001)
    recorder.await_written(sent)
    recorder.stop()
    with (tmp_path / "named.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count >= len(sent)
        assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
        assert summary.statistics.chunk_count == len(summary.chunk_indexes)
        (poses,) = {message.key for message in sent if message.channel == POSE}
        middle = (summary.statistics.message_start_time + summary.statistics.message_end_time) // 2
        later = [m.log_time for _, _, m in reader.iter_messages(poses, starting_at=middle)]
        everything = [m.log_time for _, _, m in reader.iter_messages(poses)]
        assert later == [moment for moment in everything if moment >= middle]
        settings = next(iter(reader.iter_metadata())).metadata["settings"]
        assert "named.mcap" in settings


def test_a_kill_leaves_all_that_was_on_disk(start_recorder: Callable[..., Any], tmp_path: Path) -> None:
    """How soon that is, is published below, where the test has the clock."""
    recorder = start_recorder("--mcap", str(tmp_path / "k.mcap"))
    address = {"site": recorder.site, "robot": "r1"}
    published = itertools.count(1)

    def send() -> None:
        for _ in range(10):
            recorder.bus.publish(Envelope(POSE, address, PoseEstimate(timestamp=stamp(next(published)))))
            time.sleep(0.005)

    # what has just come goes to the disk while the recorder is at work, not at its end
    on_disk = recorder.await_on_disk(tmp_path / "k.mcap", 200, send)
    recorder.process.send_signal(signal.SIGKILL)
    recorder.process.wait()

    kept = [record.publish_time for record in read(tmp_path / "k.mcap") if record.envelope.channel == POSE]
    assert len(kept) >= len(on_disk)
    assert kept == list(range(1, len(kept) + 1))


@pytest.mark.parametrize("flush_s", [0.1, 0.5, 2.0])
def test_a_crash_loses_no_more_than_stated_of_what_waits_or_is_written(
    tmp_path: Path, flush_s: float
) -> None:
    options = RecorderOptions(mcap=tmp_path / "a.mcap", flush_s=flush_s)
    core = make_core(options, mock.Mock(time_ns=lambda: 100 * S, perf_counter=time.perf_counter))
    row_s, every_s, handled = batch_s(options), 0.01, 0
    assert 0.0 < row_s < flush_s
    oldest = []
    for row in range(1, 100):
        while (handled + 1) * every_s <= row * row_s:
            handled += 1
            arrived = 100 * S + round(handled * every_s * S)
            pose = PoseEstimate(timestamp=stamp(arrived))
            list(core.handle(Envelope(POSE, {"site": "s", "robot": "r"}, pose, arrived)))
        lost = core.condition().counters.get("mcap_written", 0) + 1
        oldest.append((row + 1) * row_s - lost * every_s)
    list(core.finish())
    assert max(oldest) <= flush_s + 1e-9


def test_who_watches_sees_messages_sooner(tmp_path: Path) -> None:
    unseen, *watched = (
        batch_s(RecorderOptions(mcap=tmp_path, viewer_port=viewer, foxglove_port=foxglove))
        for viewer, foxglove in ((None, None), (0, None), (None, 8765))
    )
    assert all(0.0 < wait < unseen for wait in watched)


def test_what_is_not_ours_is_counted_and_harms_nothing(
    start_recorder: Callable[..., Any], tmp_path: Path
) -> None:
    recorder = start_recorder("--mcap", str(tmp_path / "out"))
    session: zenoh.Session = recorder.bus._session
    site = recorder.site
    session.put(f"{site}/robot/r1/coffee", b"hot")
    session.put(f"{site}/robot/r1/pose", b"\xff\xff\xff")
    session.put(
        f"{site}/robot/r1/tracks",
        Tracks().SerializeToString(),
        encoding=zenoh.Encoding("application/protobuf;eigenscan.Tracks/99"),
    )
    address = {"site": site, "robot": "r1"}
    recorder.bus.publish(Envelope(TRACKS, address, Tracks(timestamp=stamp(7))))
    health = recorder.await_health(
        lambda health: (
            health.counters.get("undecodable", 0) == 2
            and health.counters.get("foreign_key", 0) == 1
            and health.counters.get("heard_tracks", 0) == 1
        )
    )
    assert health.status == Health.STATUS_OK
    assert recorder.stop() == 0
    log = recorder.log.read_text()
    assert "undecodable" in log
    assert "foreign_key" in log
    topics = [topic for topic, _, _ in contents(only_file(tmp_path / "out")) if "/robot/" in topic]
    assert topics == [f"{site}/robot/r1/tracks"]


def test_a_full_disk_degrades_and_a_new_file_begins_when_there_is_space(
    start_recorder: Callable[..., Any], tmp_path: Path
) -> None:
    recorder = start_recorder("--mcap", str(tmp_path / "full.mcap"))
    address = {"site": recorder.site, "robot": "r1"}
    held = Site(recorder.site, seconds=0.2).messages()
    map_message = next(message for message in held if message.channel == MAP)
    recorder.bus.publish(map_message)
    recorder.await_health(
        lambda _: MAP in [record.envelope.channel for record in read(tmp_path / "full.mcap")]
    )
    pid = recorder.process.pid
    # a file may grow no further: what a full disk looks like, without one
    resource.prlimit(pid, resource.RLIMIT_FSIZE, ((tmp_path / "full.mcap").stat().st_size, -1))
    degraded = recorder.await_health(lambda health: health.status == Health.STATUS_DEGRADED)
    assert "full.mcap" in degraded.detail
    assert "lost" in degraded.detail
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (-1, -1))
    recorder.await_health(
        lambda health: health.status == Health.STATUS_OK and health.counters["mcap_files"] == 2
    )
    recorder.bus.publish(Envelope(POSE, address, PoseEstimate(timestamp=stamp(5))))
    recorder.await_health(lambda health: health.counters.get("heard_pose", 0) == 1)
    assert recorder.stop() == 0

    first = [record.envelope.channel for record in read(tmp_path / "full.mcap")]
    second = [record.envelope.channel for record in read(tmp_path / "full-2.mcap")]
    assert MAP in first
    assert second[0] == MAP, "the second file must explain itself"
    assert POSE in second


class Clock:
    """Wall-clock time that the test moves."""

    def __init__(self) -> None:
        self.now = 1_700_000_000 * S

    def __call__(self) -> int:
        return self.now


def pose(number: int) -> Envelope:
    return Envelope(POSE, {"site": "s", "robot": "r"}, PoseEstimate(timestamp=stamp(number)))


def test_what_is_older_than_the_flush_period_is_readable_while_recording_goes_on(tmp_path: Path) -> None:
    clock = Clock()
    sink = McapSink(tmp_path / "a.mcap", "s", clock, 0.5, {})
    for number in range(1, 101):
        clock.now += S // 100
        sink.write(pose(number))
        on_disk = [record.publish_time for record in read(tmp_path / "a.mcap")]
        assert on_disk == list(range(1, len(on_disk) + 1))
        assert number - len(on_disk) <= 50
    sink.close()


def test_the_log_time_is_that_of_the_arrival_however_late_it_is_written(tmp_path: Path) -> None:
    sink = McapSink(tmp_path / "a.mcap", "s", lambda: 100 * S, 0.5, {})
    address = {"site": "s", "robot": "r"}
    for seconds in (7, 8):
        sink.write(Envelope(POSE, address, PoseEstimate(timestamp=stamp(3 * S)), arrived=seconds * S))
    sink.write(Envelope(POSE, address, PoseEstimate(timestamp=stamp(3 * S))))
    sink.close()
    assert [record.log_time for _, _, record in contents(tmp_path / "a.mcap")] == [7 * S, 8 * S, 100 * S]


def test_what_came_before_a_pause_is_readable_during_it(tmp_path: Path) -> None:
    clock = Clock()
    sink = McapSink(tmp_path / "a.mcap", "s", clock, 0.5, {})
    core = RecorderCore([sink])
    for number in (1, 2):  # the first message is handed over at once
        clock.now += S if number == 1 else S // 10
        core.handle(pose(number))
    clock.now += S
    core.handle(tick(clock.now))
    assert [record.publish_time for record in read(tmp_path / "a.mcap")] == [1, 2]
    sink.close()


def test_a_clock_that_is_set_ahead_and_back_between_messages_delays_nothing(tmp_path: Path) -> None:
    """simtest, seed 9821872: a tick flushed by the wrong clock, and nothing was flushed until that time."""
    clock = Clock()
    sink = McapSink(tmp_path / "a.mcap", "s", clock, 0.5, {})
    sink.write(pose(1))
    clock.now += 822 * S
    sink.tick()
    clock.now -= 102 * S
    sink.write(pose(2))
    clock.now += S
    sink.write(pose(3))
    assert [record.publish_time for record in read(tmp_path / "a.mcap")] == [1, 2, 3]
    sink.close()


def test_a_clock_that_is_set_back_loses_no_message(tmp_path: Path) -> None:
    clock = Clock()
    sink = McapSink(tmp_path, "s", clock, 0.5, {}, Limits(file_ns=20 * S))
    for number in range(1, 601):
        clock.now += S // 10 - 3600 * S * (number == 300)
        sink.write(pose(number))
    clock.now += S
    sink.tick()
    meanwhile = list(read(tmp_path))
    sink.close()
    for found in (meanwhile, list(read(tmp_path))):
        assert sorted(record.publish_time for record in found) == list(range(1, 601))
        assert [record.log_time for record in found] == sorted(record.log_time for record in found)


@pytest.mark.parametrize(("back", "count"), [(5_000, 0), (2 * S, 1)])
def test_messages_that_came_at_once_are_no_clock_that_is_set_back(
    tmp_path: Path, back: int, count: int
) -> None:
    """Each is stamped by the thread that receives it, before they wait in one row."""
    sink = McapSink(tmp_path / "a.mcap", "s", lambda: 100 * S, 0.5, {})
    address = {"site": "s", "robot": "r"}
    for arrived in (100 * S, 100 * S - back):
        sink.write(Envelope(POSE, address, PoseEstimate(timestamp=stamp(S)), arrived=arrived))
    sink.close()
    assert sink.counters.get("mcap_clock_set_back", 0) == count


def test_a_deleted_file_is_reported_for_a_minute_also_where_the_clock_is_set_back(tmp_path: Path) -> None:
    clock = Clock()
    sink = McapSink(tmp_path / "a.mcap", "s", clock, 0.5, {})
    for _ in range(3):
        clock.now += S
        sink.write(pose(1))
        (tmp_path / "a.mcap").unlink(missing_ok=True)
    assert "was deleted" in sink.problem
    clock.now -= 3600 * S
    sink.write(pose(2))
    assert "was deleted" in sink.problem
    clock.now += 61 * S
    sink.write(pose(3))
    assert sink.problem == ""
    sink.close()


def test_no_recording_is_ever_overwritten(tmp_path: Path) -> None:
    clock = Clock()
    for number in (1, 2, 3):
        sink = McapSink(tmp_path / "a.mcap", "s", clock, 0.5, {})
        sink.write(pose(number))
        sink.close()
    kept = {p.name: [r.publish_time for r in read(p)] for p in tmp_path.glob("*.mcap")}
    assert kept == {"a.mcap": [1], "a-2.mcap": [2], "a-3.mcap": [3]}


def test_a_stamp_beyond_all_clocks_is_recorded_all_the_same(tmp_path: Path) -> None:
    clock = Clock()
    sink = McapSink(tmp_path / "a.mcap", "s", clock, 0.5, {})
    seconds = [-5, 2**62, -(2**62)]
    for second in seconds:
        message = PoseEstimate()
        message.timestamp.seconds = second
        sink.write(Envelope(POSE, {"site": "s", "robot": "r"}, message))
    sink.close()
    records = read(tmp_path / "a.mcap")
    assert [record.envelope.open(PoseEstimate).timestamp.seconds for record in records] == seconds


def test_while_there_is_no_file_messages_are_counted_as_lost(tmp_path: Path) -> None:
    clock = Clock()
    sink = McapSink(tmp_path / "out" / "a.mcap", "s", clock, 0.5, {})
    folder = tmp_path / "out"
    writer = sink._writer
    assert writer is not None
    writer._file.close()  # the next write fails
    writer._file = Path("/dev/full").open("wb")  # noqa: SIM115 - the sink closes it
    writer._writer._Writer__stream = writer._file  # type: ignore[attr-defined]
    clock.now += S
    sink.write(pose(1))
    assert "No space left" in sink.problem
    clock.now += int((RETRY_S - 1) * S)
    before = sink.problem
    sink.write(pose(2))
    assert sink.counters["mcap_lost"] == 2
    assert sink.problem == before, "each change is a line in the log, four a second"
    core = RecorderCore([sink])
    assert core.condition().status == Health.STATUS_DEGRADED
    clock.now += 2 * S
    sink.write(pose(3))
    assert sink.problem == ""
    reported = core.condition()
    assert reported.status == Health.STATUS_OK
    assert reported.detail == "mcap: 2 messages were lost: the disk was full, or a file deleted"
    sink.close()
    assert [record.publish_time for record in read(folder / "a-2.mcap")] == [3]


@pytest.mark.parametrize("moved", [False, True])
def test_a_file_that_is_gone_is_written_no_longer(tmp_path: Path, moved: bool) -> None:
    """All went to a file without a name, and health was OK."""
    clock, folder = Clock(), tmp_path / "out"
    sink = McapSink(folder / "a.mcap", "s", clock, 0.5, {})
    for number in (1, 2):
        clock.now += S
        sink.write(pose(number))
    assert not sink.problem
    if moved:
        folder.rename(tmp_path / "kept")
    else:
        shutil.rmtree(folder)
    for number in (3, 4, 5):
        clock.now += S
        sink.write(pose(number))
    assert ("moved" if moved else "deleted") in sink.problem
    assert sink.counters["mcap_lost"] == (0 if moved else 3)
    clock.now += 61 * S
    sink.write(pose(6))
    sink.close()
    assert not sink.problem
    kept = [record.publish_time for path in sorted(tmp_path.rglob("*.mcap")) for record in read(path)]
    assert sorted(kept) == ([1, 2, 3, 4, 5, 6] if moved else [4, 5, 6])


def test_a_disk_that_is_full_at_the_start_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flush(_writer: RecordingWriter) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(RecordingWriter, "flush", flush)
    with pytest.raises(OSError, match="No space left") as raised:
        McapSink(tmp_path / "a.mcap", "s", Clock(), 0.5, {})
    assert one_line(raised.value) == (
        f"{tmp_path / 'a.mcap'}: No space left on device: make room, or name another place"
    )
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.slow
def test_more_keys_than_a_file_can_number_begin_the_next_file(tmp_path: Path) -> None:
    clock, keys = Clock(), 2**16 + 10
    sink = McapSink(tmp_path / "a.mcap", "s", clock, 0.5, {})
    for number in range(keys):
        health = Health(service=f"made-up-{number}", instance="r17")
        sink.write(Envelope(HEALTH, {"site": "s", "service": health.service, "instance": "r17"}, health))
    sink.write(pose(1))
    sink.close()
    assert sink.counters["mcap_lost"] == 0
    assert not sink.problem
    found = {file.name: sum(1 for _ in read(file)) for file in tmp_path.glob("*.mcap")}
    assert len(found) == 2
    assert sum(found.values()) == keys + 1


def test_a_message_that_the_writer_cannot_take_costs_a_while_and_no_more(tmp_path: Path) -> None:
    clock = Clock()
    sink = McapSink(tmp_path / "a.mcap", "s", clock, 0.5, {})
    writer = sink._writer
    assert writer is not None
    writer._writer.add_message = _refuse  # type: ignore[method-assign]
    sink.write(pose(1))
    assert "struct.error" in sink.problem or "error: " in sink.problem
    assert sink.counters["mcap_lost"] == 1
    clock.now += int(RETRY_S * S) + 1
    sink.write(pose(2))
    sink.close()
    assert not sink.problem
    assert [record.publish_time for record in read(tmp_path / "a-2.mcap")] == [2]


def _refuse(*_: object, **__: object) -> None:
    raise struct.error("'H' format requires 0 <= number <= 65535")


def test_a_clock_that_is_set_back_delays_neither_flush_nor_retry(tmp_path: Path) -> None:
    clock = Clock()
    sink = McapSink(tmp_path / "a.mcap", "s", clock, 0.5, {})
    clock.now += S
    sink.write(pose(1))
    clock.now -= 60 * S
    sink.write(pose(2))
    clock.now += S
    sink.write(pose(3))
    assert {record.publish_time for record in read(tmp_path / "a.mcap")} == {1, 2, 3}
    assert sink.counters["mcap_clock_set_back"] == 1
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, most))  # no file may grow: a full disk
    try:
        clock.now += S
        sink.write(pose(4))
        assert sink.problem
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    clock.now -= 60 * S
    sink.write(pose(5))
    assert sink.problem  # it is not yet time
    clock.now += int(RETRY_S * S)
    sink.write(pose(6))
    assert sink.problem == ""
    sink.close()
    assert sink.counters["mcap_clock_set_back"] == 2
    kept = [record.publish_time for path in tmp_path.glob("*.mcap") for record in read(path)]
    assert sorted(kept) == [1, 2, 3, 6]
    assert sink.counters["mcap_lost"] == 2


def test_a_file_that_cannot_be_closed_is_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """No health comes after the end, which could tell it."""
    clock = Clock()
    sink = McapSink(tmp_path / "a.mcap", "s", clock, 0.5, {})
    sink.write(pose(1))
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, most))  # no file may grow: a full disk
    try:
        sink.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    (logged,) = caplog.records
    assert logged.message == "mcap_not_closed"
    context = vars(logged)["context"]
    assert "a.mcap: File too large: free space" in context["detail"]
    assert context["lost"] == 1


def test_on_a_full_disk_each_message_is_in_a_file_or_counted_and_no_empty_files_pile_up(
    tmp_path: Path,
) -> None:
    clock, published = Clock(), 0
    sink = McapSink(tmp_path, "s", clock, 0.5, {})

    def write(seconds: int) -> None:
        nonlocal published
        for _ in range(10 * seconds):
            clock.now += S // 10
            published += 1
            sink.write(pose(published))

    write(3)
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, most))  # no file may grow: a full disk
    try:
        write(60)
        assert "lost" in sink.problem
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    write(15)
    assert sink.problem == ""
    sink.close()
    files = sorted(tmp_path.glob("*.mcap"))
    assert len(files) == sink.counters["mcap_files"] == 2
    kept = [record.publish_time for path in files for record in read(path)]
    assert len(kept) == len(set(kept)) == sink.counters["mcap_written"]
    assert sink.counters["mcap_written"] + sink.counters["mcap_lost"] == published
    assert set(range(1, 25)) <= set(kept)
    assert published in kept


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ([], ["mcap", "rrd", "viewer_port"]),
        (["--mcap", "{file}/out"], ["{file}/out"]),
        (["--rrd", "{file}/x.rrd"], ["{file}"]),
        (["--viewer-port", "{taken}"], ["viewer_port", "{taken}"]),
        (["--viewer-port", "0", "--data-port", "{taken}"], ["data_port", "{taken}"]),
        (["--mcap", "x", "--viewer-memory", "lots"], ["viewer-memory", "256MB"]),
        (["--mcap", "x", "--flush-s", "0"], ["flush-s"]),
    ],
)
def test_settings_that_cannot_hold_end_it_with_one_line(
    flags: list[str], words: list[str], tmp_path: Path
) -> None:
    import socket

    file = tmp_path / "file"
    file.touch()
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken = str(server.getsockname()[1])
        fill = {"file": str(file), "taken": taken}
        result = subprocess.run(
            [sys.executable, "-m", "eigenscan.recorder.node", *(flag.format(**fill) for flag in flags)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    for word in words:
        assert word.format(**fill) in result.stderr
