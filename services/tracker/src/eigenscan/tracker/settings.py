"""What a tracker's answers depend on, besides its inputs."""

from __future__ import annotations

from typing import Literal

from eigenscan.schemas.settings import Settings
from pydantic import Field, model_validator


class TrackerSettings(Settings):
    """Settings of the tracker. The defaults suit indoor robots up to 2 m/s."""

    method: Literal["mixture", "paper"] = Field(
        "mixture",
        description="mixture (default) allows for 'none of these places'; paper follows section 7 of the "
        "paper and assumes that one hypothesis is right",
    )
    v_max: float = Field(2.0, gt=0, le=1000, description="m/s, the robot's greatest speed")
    turn_max: float = Field(3.0, gt=0, le=1000, description="rad/s, the robot's greatest turn rate")
    grid_spacing: float = Field(
        0.25, gt=0, description="m, sigma of x and y for a hypothesis whose covariance cannot be used"
    )
    grid_step: float = Field(
        0.0175, gt=0, description="rad, sigma of heading for a hypothesis whose covariance cannot be used"
    )
    odometry_slip: float = Field(
        0.1,
        ge=0,
        le=1000,
        description="m per sqrt(m), random error of odometry along the path; sideways half of it",
    )
    odometry_turn: float = Field(
        0.1, ge=0, le=1000, description="rad per sqrt(rad), random heading error of odometry while turning"
    )
    odometry_veer: float = Field(
        0.05, ge=0, le=1000, description="rad per sqrt(m), random heading error of odometry while driving"
    )
    odometry_by_scans: bool = Field(
        False,
        description="odometry is made of the same scans, so it proves no mount: a claim then has a "
        "confidence of 0.9 at most, and no protection level",
    )
    patience: float = Field(
        0.2, ge=0, le=3600, description="s, by stamps, that hypotheses wait for odometry of the same time"
    )
    at_once: bool = Field(True, description="publish poses before odometry of their time comes")
    local_fits: bool = Field(
        True,
        description="while localized, fit most scans around the pose",
    )
    late: float = Field(
        0.5,
        ge=0,
        le=3600,
        description="s; later hypotheses are rejected, and odometry set back by more ends claims",
    )
    independence_m: float = Field(
        0.5, gt=0, description="m driven after which a scan counts as independent evidence"
    )
    independence_rad: float = Field(
        0.5, gt=0, description="rad turned after which a scan counts as independent evidence"
    )
    memory: float = Field(0.5, gt=0, description="s over which evidence from one place is averaged")
    kidnap_rate: float = Field(
        0.001, ge=0, description="1/s, how often a robot is kidnapped or its track is wrong"
    )
    trust: float = Field(
        1.0,
        gt=0,
        le=1,
        description="exponent on likelihoods; below 1 for a projector that is overconfident",
    )
    gate_probability: float = Field(
        0.999, gt=0, lt=1, description="share of right hypotheses that the validation gate accepts"
    )
    prune_below: float = Field(1e-9, gt=0, description="tracks below this probability are removed")
    max_tracks: int = Field(64, ge=1, description="most tracks kept, the most probable ones")
    localized_above: float = Field(
        0.9, gt=0, le=1, description="confidence from which a pose is claimed as localized"
    )
    released_below: float = Field(
        0.5, ge=0, le=1, description="confidence below which the claim is withdrawn"
    )
    protection_risk: float = Field(
        1e-3, gt=0, lt=0.5, description="probability with which a claim's protection level may be exceeded"
    )
    transform_hz: float = Field(20.0, gt=0, description="most transforms a second; inf: at each odometry")
    tracks_hz: float = Field(10.0, gt=0, description="most tracks messages a second; inf: at each pose")
    history: int = Field(100, ge=0, description="past poses published of each track, from 1 % on")

    @model_validator(mode="after")
    def _ordered(self) -> TrackerSettings:
        if self.released_below > self.localized_above:
            raise ValueError(
                f"released_below = {self.released_below:g} is above localized_above = "
                f"{self.localized_above:g}: a claim would be withdrawn at once: lower released_below"
            )
        return self
