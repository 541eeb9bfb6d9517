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
