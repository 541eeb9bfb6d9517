"""Single checks, of what a candidate could have published."""

from __future__ import annotations

from pathlib import Path

import pytest
from eigenscan.runtime.recording import RecordingWriter
from eigenscan.schemas.channels import HYPOTHESES, MODEL_SET, SCAN
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.workbench.conformance.check import FAILED, PASSED, SKIPPED
from eigenscan.workbench.conformance.checks import judge
from eigenscan.workbench.conformance.profiles import PROFILES
from eigenscan.workbench.conformance.receiving import Received
from eigenscan.workbench.conformance.recording import Published, judge_whole
from eigenscan.workbench.conformance.trial import Observed
from eigenscan.workbench.conformance.vectors import Vectors

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
