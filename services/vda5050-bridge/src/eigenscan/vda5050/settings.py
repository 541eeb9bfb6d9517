"""Settings that may change the bridge's answers."""

from __future__ import annotations

import re
from typing import Any, Literal

from eigenscan.schemas.settings import Settings
from pydantic import Field, field_validator

SERIAL_NUMBER = re.compile(r"[A-Za-z0-9_.:-]+")
"""Characters that the standard allows."""
_TOPIC_LEVEL = re.compile(r"[^/+#$\s]+")

Version = Literal["2.1.0", "3.0.0"]


class Vda5050Settings(Settings):
    """Settings of vda5050-bridge: a robot's pose for fleet managers that speak VDA 5050."""

    version: Version = Field("3.0.0", description="of VDA 5050: 2.1.0 or 3.0.0")
    manufacturer: str = Field("eigenscan", description="the robot's manufacturer")
    serial_number: str = Field("", description="default: the robot's name")
    map_id: str = Field("map", min_length=1, description="mapId of a site without floors")
    state_interval: float = Field(1.0, ge=1.0, le=30.0, description="s between two states at most")
    visualization_hz: float = Field(5.0, ge=0.0, le=50.0, description="messages a second; 0: none")
    only_visualization: bool = Field(False, description="beside another VDA 5050 client of the robot")
    operating_mode: Literal["AUTOMATIC", "SEMIAUTOMATIC", "MANUAL", "SERVICE"] = Field(
        "MANUAL", description="operatingMode in the state"
    )
    stale_s: int = Field(2, ge=1, description="s without a pose after which the robot is not localized")
    position_s: int = Field(
        30,
        ge=2,
        description="s that an action may take to set the position",
    )
    factsheet: dict[str, Any] = Field(
        default_factory=dict,
        description="sections of the factsheet, as JSON",
    )

    @property
    def major(self) -> int:
        """2 or 3."""
        return int(self.version[0])

    @field_validator("manufacturer")
    @classmethod
    def _one_level(cls, value: str) -> str:
        if not _TOPIC_LEVEL.fullmatch(value):
            raise ValueError("must be one level of a topic: not empty, no blanks, none of / + # $")
        return value

    @field_validator("serial_number")
    @classmethod
    def _allowed(cls, value: str) -> str:
        if value and not SERIAL_NUMBER.fullmatch(value):
            raise ValueError("must consist of A-Z a-z 0-9 _ . : -")
        return value
