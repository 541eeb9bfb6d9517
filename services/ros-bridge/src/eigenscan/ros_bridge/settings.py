"""What ros-bridge's answers depend on, besides what it hears."""

from __future__ import annotations

import re

from pydantic import BaseModel, ConfigDict, Field, field_validator

_NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*")


class RosBridgeSettings(BaseModel):
    """Settings of ros-bridge: a robot's ROS 2 topics in, AMCL's out, without ROS."""

    model_config = ConfigDict(extra="forbid", frozen=True)

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


def _checked(name: str) -> str:
    if name and not _NAME.fullmatch(name):
        raise ValueError("must be a ROS name such as scan or /front/scan")
    return name
