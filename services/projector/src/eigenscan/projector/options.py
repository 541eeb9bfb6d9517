"""Options of a projector."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import Any

from eigenscan.projector.settings import PART, ProjectorSettings
from eigenscan.runtime.settings import ServiceSettings
from eigenscan.schemas.channels import DEFAULT_ROBOT, ContractError
from eigenscan.schemas.group import instance_name
from pydantic import Field, model_validator


class ProjectorOptions(ProjectorSettings, ServiceSettings):
    """Candidate poses and obstacles from one scan, by the eigenspaces of the site's regions."""

    localize_share: float = Field(
        0.2,
        ge=0,
        le=1,
        description="share of its time for queries on {site}/localize; 0: none is answered",
    )

    @model_validator(mode="before")
    @classmethod
    def _named_by_part(cls, given: Any) -> Any:
        """Names the instance by its part, so two parts of one site differ."""
        if not isinstance(given, dict) or "instance" in given:
            return given
        robot, part = str(given.get("robot", DEFAULT_ROBOT)), str(given.get("part", "1/1"))
        if part == "1/1" or not re.fullmatch(PART, part):
            return given
        with suppress(ContractError):  # the robot's own field shows what is wrong
            return given | {"instance": f"{instance_name(robot)}-{part.replace('/', 'of')}"}
        return given
