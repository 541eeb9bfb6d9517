"""Settings that no robot can have are refused: some ended the tracker at its first scan."""

import pytest
from eigenscan.tracker.settings import TrackerSettings
from pydantic import ValidationError

NAMES = ["v_max", "turn_max", "odometry_slip", "odometry_turn", "odometry_veer", "patience", "late"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [1e308, 1e160, float("inf")])
def test_what_overflows_is_refused(name: str, value: float) -> None:
    with pytest.raises(ValidationError, match="less than or equal to"):
        TrackerSettings.model_validate({name: value})


def test_a_claim_that_would_be_withdrawn_at_once_is_refused() -> None:
    with pytest.raises(ValidationError, match=r"released_below = 0.95 is above localized_above = 0.9"):
        TrackerSettings(released_below=0.95)
    assert TrackerSettings(released_below=0.9).localized_above == 0.9
