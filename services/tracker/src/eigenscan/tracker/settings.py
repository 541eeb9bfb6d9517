"""What a tracker's answers depend on, besides what it hears."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class TrackerSettings(BaseModel):
    """Settings of the tracker. The defaults suit indoor robots up to 2 m/s."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    method: Literal["mixture", "paper"] = Field(
        "mixture",
        description="mixture: with mass for 'none of these'; paper: section 7 alone, which assumes that "
        "one of its sequences is right",
    )
    v_max: float = Field(2.0, gt=0, description="m/s, fastest the robot moves")
    turn_max: float = Field(3.0, gt=0, description="rad/s, fastest the robot turns")
    grid_spacing: float = Field(
        0.25, gt=0, description="m, sigma of x and y for a hypothesis without a usable covariance (Cp)"
    )
    grid_step: float = Field(
        0.0175, gt=0, description="rad, sigma of heading for a hypothesis without a usable covariance (Cp)"
    )
    odometry_slip: float = Field(
        0.1, ge=0, description="m per sqrt(m), random error of odometry along the way; half of it sideways"
    )
    odometry_turn: float = Field(
        0.1, ge=0, description="rad per sqrt(rad), random error of odometry's heading while turning"
    )
    odometry_veer: float = Field(
        0.05, ge=0, description="rad per sqrt(m), random error of odometry's heading while driving"
    )
    patience: float = Field(
        0.2, ge=0, description="s, by the scans' stamps, that hypotheses wait for odometry of their time"
    )
    late: float = Field(0.5, ge=0, description="s, hypotheses later than this are set aside")
    independence_m: float = Field(
        0.5, gt=0, description="m of way after which a scan counts as new evidence of its own"
    )
    independence_rad: float = Field(
        0.5, gt=0, description="rad of turn after which a scan counts as new evidence of its own"
    )
    memory: float = Field(
        0.5, gt=0, description="s over which the evidence of scans from one place is averaged"
    )
    kidnap_rate: float = Field(
        0.001, ge=0, description="1/s, how often a robot is carried away or its track is wrong"
    )
    trust: float = Field(
        1.0,
        gt=0,
        le=1,
        description="exponent on likelihoods; below 1 for a projector that is too sure of itself",
    )
    gate_probability: float = Field(
        0.999, gt=0, lt=1, description="share of right hypotheses that the validation gate lets through"
    )
    prune_below: float = Field(1e-9, gt=0, description="probability below which a track ends")
    max_tracks: int = Field(64, ge=1, description="tracks kept, most probable first")
    localized_above: float = Field(
        0.9, gt=0, le=1, description="confidence at which a pose is claimed as localized"
    )
    released_below: float = Field(0.7, ge=0, le=1, description="confidence at which the claim is withdrawn")
    history: int = Field(100, ge=0, description="poses kept of each track's trajectory")
