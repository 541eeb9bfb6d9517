"""What a recording holds, and reading it from some moment on: one file or a folder, whole or cut."""

from pathlib import Path

import pytest
from eigenscan.runtime.recording import RecordingWriter, contents, read
from eigenscan.schemas.channels import MODEL_SET, SCAN
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.scan_pb2 import Scan
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer


def scan(number: int, robot: str = "r") -> Envelope:
    return Envelope(SCAN, {"site": "s", "robot": robot, "lidar": "l"}, Scan(sequence=number))


def model_set(version: int) -> Envelope:
    return Envelope(MODEL_SET, {"site": "s"}, ModelSet(version=str(version)))


def reported(path: Path, begin: int) -> list[tuple[int, str]]:
    """Log time, and what it is, of all that is read."""
    return [(record.log_time, record.envelope.channel.name) for record in read(path, begin)]


@pytest.fixture(params=["closed", "killed"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Scans at 10 to 29 s, a new set of models at 12 and at 20 s."""
    path = tmp_path / "a.mcap"
    writer = RecordingWriter(path)
    for second in range(10, 30):
        if second in {12, 20}:
            writer.write(model_set(second), second)
        writer.write(scan(second), second)
    writer.flush()
    if request.param == "closed":
        writer.close()
    else:
        writer.abandon()
    return path


def test_it_begins_with_the_models_that_held_then(path: Path) -> None:
    assert reported(path, 25) == [(20, "model_set"), *((second, "scan") for second in range(25, 30))]
    assert reported(path, 13)[:3] == [(12, "model_set"), (13, "scan"), (14, "scan")]
    assert reported(path, 11)[:3] == [(11, "scan"), (12, "model_set"), (12, "scan")]
    assert reported(path, 99) == [(20, "model_set")]


def test_contents_are_reported(path: Path) -> None:
    found = contents(path)
    assert (found.begin, found.end, found.messages) == (10, 29, 22)
    assert found.counts == {"s/models": 2, "s/robot/r/scan/l": 20}
    assert found.keys_of(SCAN) == ["s/robot/r/scan/l"]


def test_what_is_not_ours_is_counted_apart(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_message(writer.register_channel("/camera", "json", 0), 1, b"{}", 1)
        writer.finish()
    found = contents(path)
    assert (found.counts, found.foreign) == ({}, {"/camera": 1})
    assert list(read(path)) == []


@settings(max_examples=60, deadline=None)
@given(
    files=st.lists(st.lists(st.integers(1, 40), min_size=1, max_size=8), min_size=1, max_size=5),
    begin=st.integers(0, 45),
)
def test_a_folder_is_one_recording_in_order_of_time(
    tmp_path_factory: pytest.TempPathFactory, files: list[list[int]], begin: int
) -> None:
    folder = tmp_path_factory.mktemp("folder")
    for number, times in enumerate(files):
        with RecordingWriter(folder / f"{number}.mcap") as writer:
            for time in sorted(times):
                writer.write(scan(time, f"r{number}"), time)
    wanted = sorted(time for times in files for time in times)
    assert [record.log_time for record in read(folder, begin)] == [t for t in wanted if t >= begin]
    found = contents(folder)
    assert (found.begin, found.end, found.messages) == (wanted[0], wanted[-1], len(wanted))


def test_hidden_files_are_no_part_of_a_folder(tmp_path: Path) -> None:
    """macOS puts one beside each file that it copies to a stick."""
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        writer.write(scan(1), 1)
    (tmp_path / "._a.mcap").write_bytes(bytes(4096))
    assert contents(tmp_path).messages == len(list(read(tmp_path))) == 1
