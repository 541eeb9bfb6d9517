"""Settings that may change scan-ingest's answers."""

from __future__ import annotations

from eigenscan.geometry.normalize import MOST_BEAMS
from eigenscan.schemas.channels import is_chunk
from eigenscan.schemas.settings import Settings
from pydantic import ConfigDict, Field, field_validator, model_validator

EVERY_LIDAR = "*"
FARTHEST_M = 20.0
"""m from the base's origin along an axis, at most: no vehicle indoors is as long."""


class Mount(Settings):
    """Mount of a lidar on its robot."""

    model_config = ConfigDict(allow_inf_nan=False)

    x: float = Field(0.0, description="m ahead of the base's origin")
    y: float = Field(0.0, description="m to the left of it")
    yaw: float = Field(0.0, ge=-360.0, le=360.0, description="deg, counter-clockwise seen from above")
    upside_down: bool = Field(False, description="mounted head down")

    @field_validator("x", "y")
    @classmethod
    def _on_the_robot(cls, value: float) -> float:
        if abs(value) > FARTHEST_M:
            raise ValueError(f"must be within {FARTHEST_M:g} m: is it in millimetres?")
        return value


class ScanIngestSettings(Settings):
    """Settings of scan-ingest: any lidar frame in, one canonical scan out."""

    base_frame: str = Field("base_link", description="name of the robot's base frame in published scans")
    angle_step: float | None = Field(
        None,
        ge=0.05,
        le=10.0,
        description="degrees between the beams of published scans; by default the lidar's own",
    )
    range_min: float | None = Field(
        None, ge=0.0, allow_inf_nan=False, description="m, in place of the driver's limit"
    )
    range_max: float | None = Field(
        None, gt=0.0, allow_inf_nan=False, description="m, in place of the driver's limit"
    )
    mounts: dict[str, Mount] = Field(
        default_factory=dict,
        description="where each lidar (or *) sits on the robot, in place of the driver's mount; JSON, m "
        'and degrees: {"front": {"x": 0.2, "yaw": 180, "upside_down": true}}',
    )
    max_beams: int = Field(MOST_BEAMS, ge=2, le=1_000_000, description="scans with more beams are rejected")
    clock_step_scans: int = Field(
        10,
        ge=2,
        le=1000,
        description="late scans in a row after which the lidar's clock counts as set back",
    )

    @field_validator("mounts")
    @classmethod
    def _of_lidars(cls, value: dict[str, Mount]) -> dict[str, Mount]:
        for name in value:
            if name != EVERY_LIDAR and not is_chunk(name):
                raise ValueError(f"{name!r} is no lidar's name: give the last part of its key")
        return value

    @model_validator(mode="after")
    def _ordered(self) -> ScanIngestSettings:
        if self.range_min is not None and self.range_max is not None and self.range_min >= self.range_max:
            raise ValueError(f"range_min = {self.range_min} must be below range_max = {self.range_max}")
        return self
