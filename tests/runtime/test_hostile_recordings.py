"""Files that are no recordings, or were: whatever is in them, they are read or named, and nothing else."""

import errno
import io
import os
import random
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from eigenscan.runtime.recording import (
    RecordingError,
    RecordingWriter,
    contents,
    is_complete,
    message_count,
    read,
    read_metadata,
)
from eigenscan.runtime.repair import is_sound, repair
from eigenscan.schemas.channels import CHANNELS, SCAN
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.wire import encode
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Footer
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer

COUNT = 30
FOOTER_BYTES = 37
"""With the magic behind it."""


def _repaired(path: Path) -> object:
    return repair(path, path.with_suffix(".repaired.mcap"))


WAYS: tuple[Callable[[Path], object], ...] = (
    lambda path: list(read(path)),
    lambda path: list(read(path, begin=7)),
    contents,
    message_count,
    is_complete,
    read_metadata,
    is_sound,
    _repaired,
)


def survives(content: bytes, path: Path) -> None:
    """Every way to read a file ends, and fails only as RecordingError, which names the file."""
    path.write_bytes(content)
    for way in WAYS:
        try:
            way(path)
        except RecordingError as error:
            assert path.stem in str(error)  # noqa: PT017 - it need not raise


@pytest.fixture(scope="module")
def wholes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A recording of every channel in our own form, and the same in the forms of other writers."""
    folder = tmp_path_factory.mktemp("whole")
    ours = folder / "ours.mcap"
    with RecordingWriter(ours, {"recorder": {"settings": "{}"}}) as writer:
        for number in range(COUNT):
            channel = CHANNELS[number % len(CHANNELS)]
            writer.write(Envelope(channel, dict.fromkeys(channel.fields, "x"), channel.message()), number)
            if number % 10 == 0:
                writer.flush()
    found = [ours]
    for compression in (CompressionType.NONE, CompressionType.LZ4):
        for chunked in (True, False):
            path = folder / f"{compression.name}-{chunked}.mcap"
            with path.open("wb") as file:
                other = Writer(file, compression=compression, use_chunking=chunked, enable_crcs=False)
                other.start()
                schema = other.register_schema("eigenscan.Scan", "protobuf", b"")
                topic = other.register_channel("s/robot/r/scan/l", "protobuf", schema)
                other.add_attachment(1, 2, "map.yaml", "text/yaml", b"resolution: 0.05")
                for number in range(COUNT):
                    other.add_message(topic, number, encode(Scan(sequence=number)), number)
                other.finish()
            found.append(path)
    return found


@settings(max_examples=300, deadline=None)
@given(
    which=st.integers(0, 4),
    changes=st.lists(
        st.tuples(
            st.sampled_from(["set", "cut", "drop", "repeat", "fill"]),
            st.floats(0.0, 1.0, exclude_max=True),
            st.binary(min_size=1, max_size=64),
        ),
        min_size=1,
        max_size=4,
    ),
)
def test_changed_bytes(
    wholes: list[Path],
    tmp_path_factory: pytest.TempPathFactory,
    which: int,
    changes: list[tuple[str, float, bytes]],
) -> None:
    content = wholes[which].read_bytes()
    for change, share, other in changes:
        place = int(share * len(content))
        before, after = content[:place], content[place:]
        rest = after[len(other) :]
        content = {
            "set": before + other + rest,
            "cut": before,
            "drop": before + rest,
            "repeat": before + after[: len(other)] + after,
            "fill": before + b"\xff" * len(other) + rest,  # lengths and offsets beyond everything
        }[change]
    survives(content, tmp_path_factory.mktemp("a") / "changed.mcap")


@settings(max_examples=100, deadline=None)
@given(content=st.binary(max_size=400), start=st.booleans(), end=st.booleans())
def test_any_bytes(tmp_path_factory: pytest.TempPathFactory, content: bytes, start: bool, end: bool) -> None:
    magic = b"\x89MCAP0\r\n"
    survives(magic * start + content + magic * end, tmp_path_factory.mktemp("a") / "any.mcap")


@settings(max_examples=100, deadline=None)
@given(
    topic=st.sampled_from([*(channel.key(dict.fromkeys(channel.fields, "x")) for channel in CHANNELS), "/a"]),
    schema=st.sampled_from(["", "eigenscan.Scan", "eigenscan.PoseEstimate", "foxglove.Grid", "Nothing"]),
    encoding=st.sampled_from(["protobuf", "json", "cdr", ""]),
    metadata=st.dictionaries(st.sampled_from(["contract", "channel"]), st.text(max_size=3)),
    payload=st.binary(max_size=60),
)
def test_any_schema_on_any_key(
    tmp_path_factory: pytest.TempPathFactory,
    topic: str,
    schema: str,
    encoding: str,
    metadata: dict[str, str],
    payload: bytes,
) -> None:
    path = tmp_path_factory.mktemp("a") / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        number = writer.register_schema(schema, "protobuf", b"\xff") if schema else 0
        channel = writer.register_channel(topic, encoding, number, metadata)
        writer.add_message(channel, 5, payload, 5)
        writer.finish()
    survives(path.read_bytes(), path)
    assert contents(path).messages == 1


def test_a_file_without_any_index_or_statistics_is_read_in_order(tmp_path: Path) -> None:
    path = tmp_path / "plain.mcap"
    times = list(range(20))
    random.Random(1).shuffle(times)
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False, index_types=IndexType.NONE, use_statistics=False)
        writer.start()
        schema = writer.register_schema("eigenscan.Scan", "protobuf", b"")
        topic = writer.register_channel("s/robot/r/scan/l", "protobuf", schema)
        for time in times:
            writer.add_message(topic, time, encode(Scan(sequence=time)), time)
        writer.finish()
    assert [record.envelope.open(Scan).sequence for record in read(path)] == sorted(times)
    assert [record.log_time for record in read(path, begin=12)] == list(range(12, 20))
    found = contents(path)
    assert (found.begin, found.end, found.counts[SCAN.key({"site": "s", "robot": "r", "lidar": "l"})]) == (
        *(0, 19),
        20,
    )


@pytest.mark.parametrize("reads", [_repaired, is_sound, lambda path: list(read(path))])
def test_a_failing_disk_is_named_with_what_to_do(
    wholes: list[Path], monkeypatch: pytest.MonkeyPatch, reads: Callable[[Path], object]
) -> None:
    class Failing(io.FileIO):
        def readinto(self, _: object) -> int:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(Path, "open", lambda path, _mode: io.BufferedReader(Failing(path)))
    with pytest.raises(RecordingError, match=rf"{wholes[0]}: .*does the disk fail\? Copy"):
        reads(wholes[0])


def test_a_bit_of_the_index_costs_nothing_and_is_repaired(wholes: list[Path], tmp_path: Path) -> None:
    """Else a file is damaged for its readers and whole for its repair; or a changed topic hides messages."""
    content, path = bytearray(wholes[0].read_bytes()), tmp_path / "index.mcap"
    expected = [record.envelope.key for record in read(wholes[0])]
    with wholes[0].open("rb") as file:
        footer = next(record for record in StreamReader(file).records if isinstance(record, Footer))
    for place in range(footer.summary_start, len(content) - FOOTER_BYTES, 211):
        content[place] ^= 1
        path.write_bytes(content)
        content[place] ^= 1
        found: list[str] = []
        with suppress(RecordingError):  # of its last records, behind all messages
            found.extend(record.envelope.key for record in read(path))
        assert sorted(found) == sorted(expected), place
        assert not is_sound(path), place
    saved = tmp_path / "saved.mcap"
    assert repair(path, saved).messages == COUNT
    assert is_sound(saved)


def test_a_chunk_that_is_not_as_in_its_index_is_repaired(wholes: list[Path], tmp_path: Path) -> None:
    content, path = bytearray(wholes[0].read_bytes()), tmp_path / "times.mcap"
    with wholes[0].open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary
    content[summary.chunk_indexes[1].chunk_start_offset + 9] ^= 1  # its first log time
    path.write_bytes(content)
    with pytest.raises(RecordingError, match="eigenscan repair"):
        list(read(path))
    assert not is_sound(path)
    assert repair(path, tmp_path / "saved.mcap").messages == COUNT
