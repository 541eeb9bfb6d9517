"""Messages from columns of numbers, against the same messages put together number by number."""

import numpy as np
import pytest
from eigenscan.projector.columns import doubles, flag, floats, messages, nested, record
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Hypothesis, Projection
from eigenscan.schemas.wire import encode


@pytest.mark.parametrize("components", [0, 3, 16, 40])
@pytest.mark.parametrize("names", [[], ["r1", "", "Gebäude 7, " * 20]])
def test_a_message_is_the_one_that_is_put_together_number_by_number(
    components: int, names: list[str]
) -> None:
    rng = np.random.default_rng(components)
    n = len(names)
    poses, energy = rng.normal(size=(n, 3)), rng.normal(size=n)
    poses[:1], energy[1:2] = 0.0, 0.0  # zeros are not written
    searched, coefficients = np.arange(n) % 2 == 0, rng.normal(size=(n, components)).astype(np.float32)
    parts = {
        "coefficients": floats(Projection.COEFFICIENTS_FIELD_NUMBER, components),
        "error_energy": doubles(Projection.ERROR_ENERGY_FIELD_NUMBER),
        "searched": flag(Projection.SEARCHED_FIELD_NUMBER),
    }
    values = {"coefficients": coefficients, "error_energy": energy[:, None], "searched": searched}
    found = Hypotheses()
    found.MergeFromString(
        messages(
            Hypotheses.PROJECTIONS_FIELD_NUMBER,
            record(**parts),
            (Projection.REGION_FIELD_NUMBER, names),
            values,
        )
    )
    pose = nested(Hypothesis.POSE_FIELD_NUMBER, *(field.number for field in Pose2.DESCRIPTOR.fields))
    region = Hypothesis.REGION_FIELD_NUMBER, names
    found.MergeFromString(
        messages(Hypotheses.HYPOTHESES_FIELD_NUMBER, record(pose=pose), region, {"pose": poses})
    )
    wanted = Hypotheses(
        projections=[
            Projection(region=name, coefficients=c, error_energy=e, searched=s)
            for name, c, e, s in zip(names, coefficients, energy, searched, strict=True)
        ],
        hypotheses=[
            Hypothesis(region=name, pose=Pose2(x=x, y=y, theta=theta))
            for name, (x, y, theta) in zip(names, poses, strict=True)
        ],
    )
    assert encode(found) == encode(wanted)
