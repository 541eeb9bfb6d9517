"""Single checks, of what a candidate could have published."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import zenoh
from eigenscan.eigenspace.model import NO_WALL, RegionModel
from eigenscan.runtime.recording import RecordingWriter
from eigenscan.schemas.channels import HYPOTHESES, MAP, MODEL, MODEL_SET, ODOMETRY, SCAN
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.model_pb2 import RegionModel as RegionModelMessage
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import Track, Tracks
from eigenscan.schemas.wire import encode
from eigenscan.workbench.conformance import vectors
from eigenscan.workbench.conformance.agreement import model_numbers
from eigenscan.workbench.conformance.check import FAILED, PASSED, SKIPPED, Check
from eigenscan.workbench.conformance.checks import judge
from eigenscan.workbench.conformance.profiles import PROFILES
from eigenscan.workbench.conformance.receiving import Received
from eigenscan.workbench.conformance.recording import Published, judge_whole
from eigenscan.workbench.conformance.report import junit
from eigenscan.workbench.conformance.trial import Observed, Terms, Trial
from eigenscan.workbench.conformance.values import faults
from eigenscan.workbench.conformance.vectors import Vectors
from eigenscan.workbench.simulation.stage import Timed
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

ADDRESS = {"site": "s", "robot": "r"}


@pytest.mark.parametrize(
    ("versions", "knows"),
    [(["before", "newer"], True), (["newer"], False), (["its own"], False), ([], False)],
)
def test_a_late_projector_answers_by_the_models_from_before_its_start(
    versions: list[str], knows: bool
) -> None:
    models = Envelope(MODEL_SET, {"site": "s"}, ModelSet(version="before"))
    seen = Observed(PROFILES["projector"], Vectors((models,), (), ()), ADDRESS, "one", other_set="newer")
    seen.received = [
        Received(
            "", "", "", False, False, HYPOTHESES, ADDRESS | {"lidar": "front", "projector": "one"},
            Hypotheses(model_version=version), "", 0.0,
        )
        for version in versions
    ]  # fmt: skip
    (found,) = (each for each in judge(seen, 0.2) if each.name == "late join")
    assert found.result == (PASSED if knows else FAILED)


def test_a_recorder_that_keeps_what_does_not_decode_is_judged_and_fails(tmp_path: Path) -> None:
    scan = Envelope(SCAN, ADDRESS | {"lidar": "front"}, Scan(timestamp=stamp(5), frame_id="laser"))
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        writer.write(scan, 1_000, 5)
        writer.write_bytes(SCAN, scan.key, b"\xff", 1_001)
    checks = {check.name: check for check in judge_whole(tmp_path, [Published(scan, 1_000)])}
    assert "do not decode" in checks["form"].words
    found = {name: check.result for name, check in checks.items()}
    assert found == dict.fromkeys(("recording", "kept", "times"), PASSED) | {
        "form": FAILED,
        "rotation": SKIPPED,
    }


def test_of_a_recorder_that_loses_one_message_one_is_reported_lost(tmp_path: Path) -> None:
    key = {"site": "s", "robot": "r"}
    drive = [
        Envelope(ODOMETRY, key, Odometry(timestamp=stamp(number), frame_id="o")) for number in range(1, 9)
    ]
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        for number, one in enumerate(drive[1:], 2):
            writer.write(one, number)
    checks = judge_whole(tmp_path, [Published(one, one.stamp) for one in drive])
    (kept,) = (check for check in checks if check.name == "kept")
    assert kept.words == f"{drive[0].key}: of 8 messages, 1 are lost, changed or out of order"


class _Dying:
    """A candidate that ends with the first message."""

    obituary, last_lines = "it ended with code 3", ()

    def __init__(self, seen: Observed) -> None:
        self._seen = seen

    @property
    def lives(self) -> bool:
        return not self._seen.published


def test_a_recorder_that_ends_in_the_drive_does_not_end_by_bad_input() -> None:
    first = Timed(1, Envelope(ODOMETRY, ADDRESS, Odometry(timestamp=stamp(1))))
    seen = Observed(PROFILES["recorder"], Vectors((), (first,), ()), ADDRESS, "one")
    at_once = Terms(start_s=0.001, settle_s=0.001, patience=0.001)
    alone = zenoh.Config.from_json5("{scouting: {multicast: {enabled: false}}, listen: {endpoints: []}}")
    with zenoh.open(alone) as session:
        Trial(session, Path(), seen, at_once).run(_Dying(seen))  # type: ignore[arg-type]
    assert seen.ended_early == "it ended with code 3 (during the first part of the drive)"


def test_each_probability_of_tracks_is_one() -> None:
    negative = Tracks(none_probability=0.0, tracks=[Track(probability=1.5), Track(probability=-0.5)])
    assert [fault for fault in faults(negative) if "probability" in fault] == [
        "tracks[0].probability is 1.5, not in [0, 1]",
        "tracks[1].probability is -0.5, not in [0, 1]",
    ]


def test_who_is_gone_before_the_newer_set_does_not_take_it() -> None:
    seen = Observed(PROFILES["projector"], Vectors((), (), ()), ADDRESS, "one", ended_early="it ended")
    seen.received = [
        _received(Envelope(HYPOTHESES, ADDRESS | {"lidar": "l", "projector": "p"}, Hypotheses()))
    ]
    (found,) = (each for each in judge(seen, 0.2) if each.name == "other models")
    assert found.result == FAILED


@pytest.mark.parametrize("name", ["tracker", "recorder"])
def test_who_never_starts_fails_once(name: str) -> None:
    """Ten lines of FAILED hid the cause."""
    seen = Observed(PROFILES[name], Vectors((), (), ()), ADDRESS, "one", ended_early="it ended with code 1")
    first, *others = judge(seen, 0.2)
    assert (first.name, first.result) == ("presence", FAILED)
    assert "it ended with code 1" in first.words
    assert {one.result for one in others} == {SKIPPED}


def test_a_skipped_check_is_no_test_that_passed() -> None:
    seen = Observed(PROFILES["tracker"], Vectors((), (), ()), ADDRESS, "one")
    checks = [Check(result, "Keys", result, "words") for result in (PASSED, FAILED, SKIPPED)]
    cases = ElementTree.fromstring(junit(seen, checks)).iter("testcase")
    assert [case.get("name") for case in cases] == [PASSED, FAILED]


@pytest.fixture(scope="module")
def built() -> Vectors:
    profile = PROFILES["mapbuilder"]
    return vectors.load(profile.file, (), profile.outputs, ADDRESS)


def _received(one: Envelope) -> Received:
    return Received(one.key, "", "", False, False, one.channel, one.address, one.message, "", 0.0)


def _late(built: Vectors, joined: Sequence[tuple[Envelope, bytes]]) -> Check:
    """The check of a mapbuilder of whose messages a late subscriber received these bytes."""
    seen = Observed(PROFILES["mapbuilder"], built, ADDRESS, "one")
    seen.received = [_received(one) for one in built.reference]
    seen.tokens = {f"s/latched/{one.channel.name}/x": (0.0, None) for one in built.reference}
    seen.joined = {one.key: (one.channel, payload) for one, payload in joined}
    (found,) = (each for each in judge(seen, 0.2) if each.name == "late join")
    return found


def test_who_comes_late_gets_each_model_in_any_order_of_fields(built: Vectors) -> None:
    whole = [(one, encode(one.message)) for one in built.reference]
    assert _late(built, whole).result == PASSED
    first = next(one for one, _ in whole if one.channel is MODEL)
    missing = _late(built, [one for one in whole if one[0] is not first])
    assert missing.words == f"{first.key}: a late subscriber does not receive it"
    grid = next(one for one in built.reference if one.channel is MAP)
    plain = grid.open(Grid)
    halves = Grid(frame_id=plain.frame_id), deepcopy(plain)
    halves[1].ClearField("frame_id")
    other = b"".join(half.SerializeToString() for half in reversed(halves))
    assert other != encode(plain)
    assert _late(built, [(one, other if one is grid else p) for one, p in whole]).result == PASSED


def test_a_map_or_model_without_sense_is_a_fault_of_the_builder(built: Vectors) -> None:
    """The judge ended with an error of its own."""
    whole = [_received(one) for one in built.reference]
    assert model_numbers(whole, built)[0] == []
    for one in whole:
        if isinstance(one.message, Grid):
            grid = deepcopy(one.message)
            grid.cell_stride = 2
            odd = replace(one, message=grid)
            break
    others = [each for each in whole if each.channel is not MAP]
    assert "expected one byte a cell" in model_numbers([odd, *others], built)[0][0]
    model = next(each for each in whole if isinstance(each.message, RegionModelMessage))
    assert isinstance(model.message, RegionModelMessage)
    read = RegionModel.from_message(model.message)
    blind = replace(read, ranges=np.full_like(read.ranges, NO_WALL)).to_message()
    blinded = [replace(each, message=blind) if each is model else each for each in whole]
    assert any("of its ranges are what the map shows" in fault for fault in model_numbers(blinded, built)[0])
