"""A folder of recordings: their verdicts, references, and what a build server reads."""

import shutil
from pathlib import Path
from xml.etree import ElementTree

import pytest
from eigenscan.runtime.recording import RecordingWriter, read, read_metadata
from eigenscan.schemas.channels import ODOMETRY, POSE, SCAN_RAW
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.schemas.wire import encode

from tests.workbench.replay.conftest import Command, Run, changed


@pytest.fixture
def folder(recording: Path, tmp_path: Path) -> Path:
    """One whole run, `whole.mcap`."""
    place = tmp_path / "incidents"
    place.mkdir()
    shutil.copy(recording, place / "whole.mcap")
    return place


def without_answers(run: Run, path: Path) -> Path:
    inputs = [
        timed
        for timed in run.messages
        if timed.envelope.channel in (SCAN_RAW, ODOMETRY) or timed.envelope.channel.qos.latched
    ]
    return run.write(path, inputs)


def test_each_recording_and_service_is_a_test(
    run: Run, folder: Path, eigenscan: Command, tmp_path: Path
) -> None:
    pose = next(timed for timed in run.messages if timed.envelope.channel is POSE)
    wrong = [
        type(t)(
            t.time, type(t.envelope)(POSE, t.envelope.address, changed(t.envelope.message, confidence=2.0))
        )
        if t is pose
        else t
        for t in run.messages
    ]
    run.write(folder / "altered.mcap", wrong)
    (folder / "broken.mcap").write_bytes(b"nothing")
    results = tmp_path / "results/junit.xml"
    ended = eigenscan("replay-test", folder, "--junit", results)
    assert ended.code == 1
    assert f"{folder}: 1 different and 1 bad of 7 tests" in ended.err
    root = ElementTree.parse(results).getroot()
    assert (root.get("tests"), root.get("failures"), root.get("errors")) == ("7", "1", "1")
    kinds = {
        (case.get("classname"), case.get("name")): case[0].tag
        for case in root.iter("testcase")
        if case[0].tag != "system-out"
    }
    assert kinds == {("altered.mcap", "tracker"): "failure", ("broken.mcap", "recording"): "error"}
    (failure,) = root.iter("failure")
    assert (failure.text or "").splitlines()[-1] == f"both sides: {folder / 'altered.tracker.rrd'}"
    assert (folder / "altered.tracker.rrd").stat().st_size > 1000
    assert failure.get("message") == "pose: 1 different, 0 missing, 0 too many"
    # two files at a time or one after another: the same, in the same order
    alone = eigenscan("replay-test", folder, "--jobs", 1)
    assert verdicts(alone.out) == verdicts(ended.out)
    assert len(verdicts(alone.out)) == 7
    assert "first difference: pose" in (failure.text or "")
    assert "confidence" in (failure.text or "")


def verdicts(out: str) -> list[str]:
    """Result, recording and service of each test."""
    return [line.partition(":")[0] for line in out.splitlines() if line and not line.startswith(" ")]


def test_all_the_same_is_zero_and_bad_input_alone_is_two(folder: Path, eigenscan: Command) -> None:
    ended = eigenscan("replay-test", folder)
    assert ended.code == 0, ended.out + ended.err
    assert "all 3 the same" in ended.out
    (folder / "empty.mcap").touch()
    ended = eigenscan("replay-test", folder, "--service", "scan-ingest")
    assert ended.code == 2
    assert "bad input  empty.mcap  recording: " in ended.out


def test_an_update_accepts_and_then_holds(run: Run, folder: Path, eigenscan: Command) -> None:
    (folder / "whole.mcap").unlink()
    raw = without_answers(run, folder / "raw.mcap")
    ended = eigenscan("replay-test", folder)
    assert ended.code == 2
    assert "--update keeps those of today" in ended.out
    assert eigenscan("replay-test", folder, "--update").code == 0
    reference = folder / "raw.reference.mcap"
    inputs = {record.envelope.channel for record in read(raw)}
    answers = [encode(t.envelope.message) for t in run.messages if t.envelope.channel is POSE]
    published = list(read(reference))
    assert [encode(r.envelope.message) for r in published if r.envelope.channel is POSE] == answers
    assert not inputs & {record.envelope.channel for record in published}
    before = reference.read_bytes()
    ended = eigenscan("replay-test", folder)
    assert ended.code == 0, ended.out
    assert "raw.mcap  pipeline" in ended.out
    assert reference.read_bytes() == before
    # a reference that states something else fails, transforms included
    alter(reference)
    ended = eigenscan("replay-test", folder)
    assert ended.code == 1
    assert "first difference: pose" in ended.out
    assert "reference made with scan-ingest " in ended.out
    assert eigenscan("replay-test", folder, "--update").code == 0
    assert eigenscan("replay-test", folder).code == 0
    # of another recording
    without_answers(Run(run.messages[:-50], run.models, run.folder), raw)
    ended = eigenscan("replay-test", folder)
    assert ended.code == 2
    assert "is of another recording than raw.mcap" in ended.out
    raw.unlink()
    run.write(folder / "other.mcap")
    ended = eigenscan("replay-test", folder)
    assert ended.code == 2
    assert "its recording is gone" in ended.err


def test_an_update_of_one_service_leaves_the_others(folder: Path, eigenscan: Command) -> None:
    reference = folder / "whole.reference.mcap"
    assert eigenscan("replay-test", folder, "--update").code == 0
    before = reference.read_bytes()
    alter(reference)
    ended = eigenscan("replay-test", folder, "--update", "--service", "scan-ingest")
    assert ended.code == 0
    assert eigenscan("replay-test", folder, "--service", "scan-ingest").code == 0
    ended = eigenscan("replay-test", folder)
    assert ended.code == 1
    assert "1 different and 0 bad of 3 tests" in ended.err
    assert eigenscan("replay-test", folder, "--update", "--service", "tracker").code == 0
    assert eigenscan("replay-test", folder).code == 0
    assert sorted(published(reference)) == sorted(published_in(before, folder))


def published(path: Path) -> list[tuple[str, bytes]]:
    return [(record.envelope.key, encode(record.envelope.message)) for record in read(path)]


def published_in(content: bytes, folder: Path) -> list[tuple[str, bytes]]:
    path = folder.with_suffix(".mcap")
    path.write_bytes(content)
    return published(path)


def alter(reference: Path) -> None:
    """Moves one pose of a reference."""
    records, metadata = list(read(reference)), read_metadata(reference)
    altered = next(r for r in records[len(records) // 2 :] if r.envelope.channel is POSE)
    with RecordingWriter(reference, metadata) as writer:
        for record in records:
            if record is altered:
                altered.envelope.open(PoseEstimate).pose.y += 1e-9
            writer.write(record.envelope, record.log_time)


def test_a_folder_that_is_none(eigenscan: Command, tmp_path: Path) -> None:
    for place, stated in ((tmp_path / "absent", "is no folder"), (tmp_path, "holds no .mcap")):
        ended = eigenscan("replay-test", place)
        assert ended.code == 2
        assert stated in ended.err
        assert ended.err.count("\n") == 1
