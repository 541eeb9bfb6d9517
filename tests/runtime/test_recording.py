"""Recordings: self-contained, in order, and never silently damaged."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from eigenscan.runtime.recording import PROFILE, RecordingError, RecordingWriter, read, read_metadata
from eigenscan.schemas.channels import CHANNELS, MODEL_SET, POSE, SCAN
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.wire import encode
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

ADDRESS = {"site": "s", "robot": "r", "lidar": "l"}

# Knows protobuf and MCAP, and nothing of this project.
STRANGER = """
import sys
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

with open(sys.argv[1], "rb") as file:
    for schema, channel, message in make_reader(file).iter_messages():
        assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
        pool = descriptor_pool.DescriptorPool()
        for part in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
            pool.Add(part)
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
        print(channel.topic, schema.name, kind.FromString(message.data).ByteSize(), len(message.data))
assert not [name for name in sys.modules if name.startswith(("eigenscan", "foxglove"))]
"""


def _scan(number: int, lidar: str = "l") -> Envelope:
    return Envelope(SCAN, ADDRESS | {"lidar": lidar}, Scan(sequence=number, ranges=[1.5] * 50))


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "whole.mcap"
    with RecordingWriter(path, {"settings": {"seed": "1"}}) as writer:
        for number in range(200):
            writer.write(_scan(number), log_time=1000 + number, publish_time=900 + number)
            if number % 50 == 0:
                writer.flush()
    return path


def test_the_command_for_a_damaged_file_works_from_here(recording: Path) -> None:
    path = recording.parent / "the night.mcap"
    path.write_bytes(recording.read_bytes()[:60] + bytes(300) + recording.read_bytes()[360:])
    with pytest.raises(RecordingError, match=rf"eigenscan repair '{path}' saves"):
        list(read(path))
    path.write_bytes(b"#ROSBAG V2.0")
    with pytest.raises(
        RecordingError, match=rf"is a ROS 1 bag, .*: eigenscan import '{path}' makes one of it$"
    ):
        list(read(path))


def test_another_contract_is_no_damage(tmp_path: Path) -> None:
    """A repair finds nothing to repair there."""
    path = tmp_path / "later.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("eigenscan.Scan", "protobuf", b"")
        topic = writer.register_channel("s/robot/r/scan/l", "protobuf", schema, {"contract": "2"})
        writer.add_message(topic, 1, b"", 1)
        writer.finish()
    with pytest.raises(RecordingError, match=r"later.mcap: scan: .*Scan/2.*: read it with the release"):
        list(read(path))


def test_a_stranger_decodes_every_message_with_the_file_alone(tmp_path: Path) -> None:
    path = tmp_path / "all.mcap"
    output = []
    with RecordingWriter(path) as writer:
        for number, channel in enumerate(CHANNELS):
            message: Any = channel.message()
            if "timestamp" in message.DESCRIPTOR.fields_by_name:
                message.timestamp.seconds = 7
            envelope = Envelope(channel, dict.fromkeys(channel.fields, "x"), message)
            writer.write(envelope, log_time=number)
            size = len(encode(message))
            output.append(f"{envelope.key} {channel.schema_name} {size} {size}")
    ran = subprocess.run(
        [sys.executable, "-c", STRANGER, path], capture_output=True, text=True, timeout=600, check=False
    )
    assert ran.stderr == ""
    assert ran.stdout.splitlines() == output


def test_it_gives_back_what_was_written(recording: Path) -> None:
    records = list(read(recording))
    assert [record.envelope.open(Scan).sequence for record in records] == list(range(200))
    first = records[0]
    assert (first.log_time, first.publish_time) == (1000, 900)
    assert first.envelope.address == ADDRESS
    assert first.size == len(encode(_scan(0).message))
    assert read_metadata(recording) == {"settings": {"seed": "1"}}
    with recording.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == PROFILE
        (channel,) = reader.get_summary().channels.values()  # type: ignore[union-attr]
    assert channel.topic == "s/robot/r/scan/l"
    assert channel.metadata["contract"] == "1"


@pytest.mark.parametrize(
    ("begin", "expected"), [(5, ["new"]), (4, ["old", "new"]), (15, ["new"]), (3, ["old", "new"])]
)
def test_from_a_time_on_a_folder_gives_each_latched_key_once(
    tmp_path: Path, begin: int, expected: list[str]
) -> None:
    pose = Envelope(POSE, {"site": "s", "robot": "r"}, POSE.message())
    for name, versions in (("a", {1: "old"}), ("b", {3: "old", 4: "new"}), ("c", {11: "new"})):
        with RecordingWriter(tmp_path / f"{name}.mcap") as writer:
            for time, version in versions.items():
                writer.write(Envelope(MODEL_SET, {"site": "s"}, ModelSet(version=version)), log_time=time)
            writer.write(pose, log_time=max(versions) + 1)
    records = list(read(tmp_path, begin))
    sets = [
        record.envelope.open(ModelSet).version for record in records if record.envelope.channel is MODEL_SET
    ]
    assert sets == expected
    assert all(record.log_time >= begin for record in records if record.envelope.channel is POSE)


@given(times=st.lists(st.integers(0, 3), max_size=40), flush_every=st.integers(1, 12))
def test_equal_times_keep_the_order_of_writing(
    tmp_path_factory: pytest.TempPathFactory, times: list[int], flush_every: int
) -> None:
    path = tmp_path_factory.mktemp("order") / "a.mcap"
    with RecordingWriter(path) as writer:
        for number, time in enumerate(times):
            writer.write(_scan(number, lidar=f"l{number % 3}"), log_time=time)
            if number % flush_every == 0:
                writer.flush()  # ends a chunk
    expected = [number for _, number in sorted(zip(times, range(len(times)), strict=True))]
    assert [record.envelope.open(Scan).sequence for record in read(path)] == expected


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    for path, reason in ((tmp_path / "none.mcap", "No such file"), (tmp_path, "holds no .mcap")):
        for reader in (lambda path: list(read(path)), read_metadata):
            with pytest.raises(RecordingError, match=reason) as error:
                reader(path)
            assert str(path) in str(error.value)


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", b"scan 1 2 3\n", bytes(4096)])
def test_what_is_no_mcap_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"other.mcap: is no readable recording"):
        list(read(path))


def test_a_cut_file_gives_whole_messages_of_its_start_or_its_name(tmp_path: Path, recording: Path) -> None:
    whole = recording.read_bytes()
    path = tmp_path / "cut.mcap"
    got: list[int] = []
    for size in range(0, len(whole), 5):  # a chunk's head of 41 bytes is cut, too
        path.write_bytes(whole[:size])
        try:
            numbers = [record.envelope.open(Scan).sequence for record in read(path)]
        except RecordingError:
            assert not got
            continue
        assert numbers == list(range(len(numbers)))
        got.append(len(numbers))
    assert max(got) == 200


@pytest.mark.parametrize("size", [0, 7])
def test_a_file_that_was_only_begun_does_not_hide_the_others(
    tmp_path: Path, recording: Path, size: int
) -> None:
    before = len(list(read(recording)))
    (tmp_path / "z.mcap").write_bytes(recording.read_bytes()[:size])
    assert len(list(read(tmp_path))) == before == 200
    recording.unlink()
    with pytest.raises(RecordingError, match=r"holds no .mcap with messages"):
        list(read(tmp_path))


@given(data=st.data())
def test_a_damaged_file_never_gives_other_messages(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("damage") / "a.mcap"
    with RecordingWriter(path) as writer:
        for number in range(20):
            writer.write(_scan(number), log_time=number)
    content = bytearray(path.read_bytes())
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content)
    try:
        numbers = [record.envelope.open(Scan).sequence for record in read(path)]
    except RecordingError:
        return
    assert numbers == list(range(20))[: len(numbers)]


@pytest.mark.parametrize(("schema", "contract"), [("eigenscan.Scan", "2"), ("eigenscan.PoseEstimate", "1")])
def test_another_schema_or_contract_version_is_refused(tmp_path: Path, schema: str, contract: str) -> None:
    path = tmp_path / "later.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(
            "s/robot/r/scan/l",
            "protobuf",
            writer.register_schema(schema, "protobuf", b""),
            {"contract": contract},
        )
        writer.add_message(channel, 1, encode(Scan()), 1)
        writer.finish()
    with pytest.raises(RecordingError, match=rf"later.mcap: .*{schema}/{contract}.*eigenscan.Scan/1"):
        list(read(path))


def test_topics_of_others_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "mixed.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        other = writer.register_channel("/camera", "json", 0)
        ours = writer.register_channel(
            "s/robot/r/pose", "protobuf", writer.register_schema(POSE.schema_name, "protobuf", b"")
        )
        writer.add_message(other, 1, b"{}", 1)
        writer.add_message(ours, 2, encode(POSE.message()), 2)
        writer.finish()
    assert [record.envelope.key for record in read(path)] == ["s/robot/r/pose"]


def test_a_message_is_kept_as_it_came(tmp_path: Path) -> None:
    # of a later version: this one knows no field 1000
    payload = encode(_scan(7).message) + bytes([0xC0, 0x3E, 0x01])
    path = tmp_path / "later.mcap"
    with RecordingWriter(path) as writer:
        writer.write(Envelope(SCAN, ADDRESS, Scan.FromString(payload), payload=payload), log_time=1)
    with path.open("rb") as file:
        ((_, _, message),) = make_reader(file).iter_messages()
    assert message.data == payload
