"""Options of a tracker."""

from __future__ import annotations

from pathlib import Path

from eigenscan.runtime.settings import ServiceSettings
from eigenscan.tracker.settings import TrackerSettings
from pydantic import Field


class TrackerOptions(TrackerSettings, ServiceSettings):
    """Settings of the tracker. The defaults suit indoor robots up to 2 m/s."""

    last_pose: Path | None = Field(
        None, description="folder that keeps each robot's last localized pose, to start from after a restart"
    )
    last_pose_age: float = Field(60.0, ge=0, description="s; an older last pose is not used")
