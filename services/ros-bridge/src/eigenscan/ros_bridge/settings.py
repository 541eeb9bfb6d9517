"""What ros-bridge can be told."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any, Literal

from eigenscan.runtime.settings import ServiceSettings
from eigenscan.schemas.group import is_one
from pydantic import Field, field_validator, model_validator

_NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*")
ROUTER = "tcp/localhost:7447"
"""Where rmw_zenohd and zenoh-bridge-ros2dds listen."""


class RosBridgeSettings(ServiceSettings):
    """Settings of ros-bridge: a robot's ROS 2 topics in, AMCL's out, without ROS."""

    dialect: Literal["rmw_zenoh", "rmw_zenoh_humble", "ros2dds"] = Field(
        "rmw_zenoh",
        description="rmw_zenoh: the robot runs RMW_IMPLEMENTATION=rmw_zenoh_cpp, rmw_zenoh_humble: that of "
        "ROS 2 Humble; ros2dds: it runs a DDS, with a zenoh-bridge-ros2dds beside it",
    )
    ros_zenoh: Path | None = Field(
        None,
        description="Zenoh configuration, JSON5, of the side towards ROS; without it a peer at ros_router",
    )
    ros_router: str = Field(
        ROUTER, pattern="^[a-z0-9]+/.+$", description="where the robot's rmw_zenohd or DDS bridge listens"
    )
    domain: int = Field(
        default_factory=lambda: os.environ.get("ROS_DOMAIN_ID") or "0",
        validate_default=True,
        ge=0,
        le=232,
        description="ROS domain; ROS_DOMAIN_ID without it",
    )
    namespace: str = Field(
        "", description="ROS namespace of the robot: of all topics without a leading slash"
    )
    scan: list[str] = Field(
        default_factory=lambda: ["scan"],
        min_length=1,
        description='topics of LaserScan, as JSON: ["front/scan", "rear/scan"] are the lidars front and rear',
    )
    odom: str = Field(
        "odom", description="topic of Odometry, taken for as long as tf tells no odometry; empty: tf's only"
    )
    odom_frame: str = Field(
        "odom",
        description="frame in tf whose child is the robot's base: AMCL's odometry; empty: the topic's only",
    )
    base_frame: str | None = Field(
        None, description="the robot's base in tf; without it the odometry's child"
    )
    mounts_from_tf: bool = Field(
        True, description="a lidar's place on the robot is tf's; false: scan-ingest is told its mounts"
    )
    tf: str = Field(
        "tf", description="topic of tf, heard for odometry and mounts, said map to odom; empty: neither"
    )
    tf_broadcast: bool = Field(True, description="map to odom is said on tf")
    tf_static: str = Field("tf_static", description="topic of tf's static part")
    initial_pose: str = Field(
        "initialpose", description="topic of a pose that an operator clicks; empty: none"
    )
    set_initial_pose: str = Field(
        "set_initial_pose", description="service that takes a pose as initial_pose does; empty: none"
    )
    global_localization: str = Field(
        "reinitialize_global_localization", description="service that makes it search anew; empty: none"
    )
    nomotion_update: str = Field(
        "request_nomotion_update",
        description="service that is answered; every scan counts anyhow; empty: none",
    )
    lifecycle: str = Field(
        "amcl",
        description="lifecycle node that it stands for: a lifecycle manager brings it up and keeps a bond "
        "with it; empty: none",
    )
    pose: str = Field("amcl_pose", description="topic of the pose; empty: not said")
    particles: str = Field("particle_cloud", description="topic of the hypotheses; empty: not said")
    map: str = Field("map", description="topic of the map; empty: not said, a map_server does")
    transform_tolerance: float = Field(
        0.1,
        ge=0.0,
        le=10.0,
        description="s that map to odom is dated ahead, as AMCL's, so that it covers now",
    )

    @field_validator(
        "namespace",
        "odom",
        "set_initial_pose",
        "nomotion_update",
        "lifecycle",
        "tf",
        "tf_static",
        "initial_pose",
        "global_localization",
        "pose",
        "particles",
        "map",
    )
    @classmethod
    def _ros_name(cls, value: str) -> str:
        return _checked(value)

    @field_validator("scan")
    @classmethod
    def _ros_names(cls, value: list[str]) -> list[str]:
        if not all(value) or len(set(value)) < len(value):
            raise ValueError("must be names of topics, each once")
        return [_checked(name) for name in value]

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


def _checked(name: str) -> str:
    if name and not _NAME.fullmatch(name):
        raise ValueError("must be a ROS name such as scan or /front/scan")
    return name
