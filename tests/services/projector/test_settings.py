"""Numbers that no memory holds are refused: they ended the projector at its first scan."""

import pytest
from eigenscan.projector.settings import ProjectorSettings
from pydantic import ValidationError


@pytest.mark.parametrize("name", ["candidates", "refined"])
def test_numbers_that_no_memory_holds(name: str) -> None:
    with pytest.raises(ValidationError, match="less than or equal to 1000000"):
        ProjectorSettings.model_validate({name: 10**30})
