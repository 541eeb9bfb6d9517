"""Settings that may change ros-bridge's answers."""

from __future__ import annotations

import re

from eigenscan.schemas.settings import Settings
from pydantic import Field, field_validator, model_validator

_NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*")


class RosBridgeSettings(Settings):
    """Settings of ros-bridge: a robot's ROS 2 topics in, AMCL's out, without ROS."""

    namespace: str = Field("", description="ROS namespace of all topics without a leading slash")
    scan: list[str] = Field(
        default_factory=lambda: ["scan"],
        min_length=1,
        description='topics of LaserScan, as JSON: ["front/scan", "rear/scan"] are the lidars front and rear',
    )
    points: list[str] = Field(
        default_factory=list,
        description="topics of PointCloud2, as JSON; a level slice of each is a scan",
    )
    slice_low: float = Field(0.1, ge=-10.0, le=10.0, description="m above the base, of a slice")
    slice_high: float = Field(0.6, ge=-10.0, le=10.0, description="m above the base, of a slice")
    gather: float = Field(
        0.0,
        ge=0.0,
        le=50.0,
        description="m driven over which narrow scans are gathered, by odometry, to one; 0: not",
    )
    odom: str = Field("odom", description="topic of Odometry, while tf has none; empty: tf only")
    odom_frame: str = Field(
        "odom",
        description="odometry frame in tf; empty: the topic only",
    )
    imu: str = Field(
        "",
        description="topic of Imu, whose gyroscope replaces the wheels' turn; empty: none",
    )
    base_frame: str | None = Field(None, description="base frame in tf; default: the odometry's child")
    mounts_from_tf: bool = Field(True, description="take mounts from tf; false: from scan-ingest's settings")
    tf: str = Field("tf", description="topic of tf, for odometry, mounts and map to odom; empty: none")
    tf_broadcast: bool = Field(True, description="publish map to odom on tf")
    tf_static: str = Field("tf_static", description="topic of tf's static part")
    initial_pose: str = Field("initialpose", description="topic of an operator's pose; empty: none")
    start_known: bool = Field(False, description="start at the pose start_x, start_y, start_yaw")
    start_x: float = Field(0.0, allow_inf_nan=False, description="m in the map")
    start_y: float = Field(0.0, allow_inf_nan=False, description="m in the map")
    start_yaw: float = Field(0.0, allow_inf_nan=False, description="rad in the map")
    set_initial_pose: str = Field("set_initial_pose", description="service that accepts a pose; empty: none")
    global_localization: str = Field(
        "reinitialize_global_localization", description="service that restarts the search; empty: none"
    )
    nomotion_update: str = Field(
        "request_nomotion_update",
        description="service that is answered only; empty: none",
    )
    lifecycle: str = Field(
        "amcl",
        description="name of its lifecycle node; empty: none",
    )
    pose: str = Field("amcl_pose", description="topic of the pose; empty: none")
    particles: str = Field("particle_cloud", description="topic of the tracks; empty: none")
    floor: str = Field(
        "floor", description="topic of the name of the floor that a claimed pose is on; empty: none"
    )
    diagnostics: str = Field("/diagnostics", description="topic of health and state; empty: none")
    map: str = Field("map", description="topic of the map; empty: none, as with a map_server")
    transform_tolerance: float = Field(
        0.1,
        ge=0.0,
        le=10.0,
        description="s by which map to odom is dated ahead",
    )

    @field_validator(
        "namespace",
        "odom",
        "imu",
        "set_initial_pose",
        "nomotion_update",
        "lifecycle",
        "tf",
        "tf_static",
        "initial_pose",
        "global_localization",
        "pose",
        "particles",
        "floor",
        "diagnostics",
        "map",
    )
    @classmethod
    def _ros_name(cls, value: str) -> str:
        return _checked(value)

    @model_validator(mode="after")
    def _has_slice(self) -> RosBridgeSettings:
        if self.slice_low >= self.slice_high:
            raise ValueError(f"slice_high = {self.slice_high:g} is not above slice_low = {self.slice_low:g}")
        return self

    @model_validator(mode="after")
    def _knows_mounts(self) -> RosBridgeSettings:
        if self.gather and not self.mounts_from_tf:
            raise ValueError("gather needs mounts_from_tf")
        return self

    @model_validator(mode="after")
    def _each_once(self) -> RosBridgeSettings:
        topics = [qualified(self.namespace, name) for name in (*self.scan, *self.points)]
        for topic in topics:
            if topics.count(topic) > 1:
                raise ValueError(f"scan, points: must name each topic once; {topic} is named twice")
        return self

    @field_validator("scan", "points")
    @classmethod
    def _ros_names(cls, value: list[str]) -> list[str]:
        if not all(value):
            raise ValueError("must be names of topics")
        return [_checked(name) for name in value]


def qualified(namespace: str, name: str) -> str:
    """Full name of a topic: one without a leading slash is in the robot's namespace."""
    if name.startswith("/"):
        return name
    inside = namespace.strip("/")
    return f"/{inside}/{name}" if inside else f"/{name}"


def _checked(name: str) -> str:
    if name and not _NAME.fullmatch(name):
        raise ValueError("must be a ROS name such as scan or /front/scan")
    return name
