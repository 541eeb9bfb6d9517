"""Settings of the ros-bridge process."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Literal

from eigenscan.ros_bridge.settings import RosBridgeSettings
from eigenscan.runtime.settings import ServiceSettings
from eigenscan.schemas.group import is_one
from pydantic import Field, field_validator, model_validator

ROUTER = "tcp/localhost:7447"
"""Default address of rmw_zenohd and zenoh-bridge-ros2dds."""


class _Process(ServiceSettings):
    dialect: Literal["rmw_zenoh", "rmw_zenoh_humble", "ros2dds"] = Field(
        "rmw_zenoh",
        description="rmw_zenoh (Jazzy or later), rmw_zenoh_humble, or ros2dds (zenoh-bridge-ros2dds)",
    )
    ros_zenoh: Path | None = Field(
        None,
        description="Zenoh configuration towards ROS, JSON5; default: a peer at ros_router",
    )
    ros_router: str = Field(
        ROUTER, pattern="^[a-z0-9]+/.+$", description="where the robot's rmw_zenohd or DDS bridge listens"
    )
    domain: int = Field(
        default_factory=lambda: os.environ.get("ROS_DOMAIN_ID") or "0",
        validate_default=True,
        ge=0,
        le=232,
        description="ROS domain; default: ROS_DOMAIN_ID",
    )


class RosBridgeOptions(RosBridgeSettings, _Process):
    """Settings of ros-bridge: a robot's ROS 2 topics in, AMCL's out, without ROS."""

    @field_validator("robot")
    @classmethod
    def _one_robot(cls, value: str) -> str:
        if not is_one(value):
            raise ValueError("must be one robot: start a bridge for each, with its namespace or domain")
        return value

    @model_validator(mode="before")
    @classmethod
    def _one_network(cls, given: Any) -> Any:
        if isinstance(given, dict) and given.get("ros_zenoh") and given.get("ros_router"):
            raise ValueError("give one of ros_zenoh (a file, which names the router) and ros_router")
        return given
