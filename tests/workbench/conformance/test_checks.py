"""Single checks, of what a candidate could have published."""

from __future__ import annotations

import pytest
from eigenscan.schemas.channels import HYPOTHESES, MODEL_SET
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.workbench.conformance.check import FAILED, PASSED
from eigenscan.workbench.conformance.checks import judge
from eigenscan.workbench.conformance.profiles import PROFILES
from eigenscan.workbench.conformance.receiving import Received
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
