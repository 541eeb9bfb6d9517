"""What mapbuilder's answers depend on, besides what it hears."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

from pydantic import BaseModel, ConfigDict, Field

if TYPE_CHECKING:
    from eigenscan.mapbuilder.site import Plan


class MapbuilderSettings(BaseModel):
    """Settings of mapbuilder: a map in, eigenspace models out."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    frame_id: str = Field("map", min_length=1, description="name of the map frame in what is published")
    spacing: float = Field(0.5, ge=0.05, le=5.0, description="m, between positions of the grid")
    error: float = Field(
        0.0, ge=0.0, le=20.0, description="m, closer where panoramas interpolate worse; 0: nowhere"
    )
    step: float = Field(0.5, ge=0.1, le=10.0, description="deg, between beams of a panorama")
    clearance: float = Field(0.15, ge=0.0, le=5.0, description="m, of a position from the nearest wall")
    range_max: float = Field(80.0, gt=0.0, le=130.0, description="m, walls farther than this are not seen")
    range_cap: float = Field(20.0, gt=0.0, le=130.0, description="m, ranges are clipped to this for PCA")
    field_of_view: float = Field(180.0, gt=0.0, le=360.0, description="deg, of the sensor of the eigenspaces")
    share: float = Field(0.9, gt=0.0, le=1.0, description="of the variance that the eigenvectors hold")
    margin: float = Field(1.0, ge=0.0, le=10.0, description="m, that a region reaches into its neighbours")
    smallest: float = Field(4.0, ge=0.0, description="m^2, smaller regions join a neighbour")
    largest: float = Field(150.0, ge=1.0, description="m^2, larger regions are halved")
    changes: Literal["off", "propose", "publish"] | None = Field(
        None,
        description="what becomes of lasting changes that robots see: off, propose (the operator accepts) or "
        "publish; without it propose with a model folder that can be written beside, else off",
    )
    visits: int = Field(4, ge=2, le=50, description="visits in a row that must agree on a change")
    visit: float = Field(
        30.0, ge=0.1, le=1440.0, description="min, of one visit: what is seen within counts once"
    )

    @property
    def plan(self) -> Plan:
        """The same in the units of the library."""
        from eigenscan.mapbuilder.regions import Division
        from eigenscan.mapbuilder.site import Plan

        return Plan(
            spacing=self.spacing,
            error=self.error,
            step=math.radians(self.step),
            clearance=self.clearance,
            range_max=self.range_max,
            range_cap=self.range_cap,
            field_of_view=math.radians(self.field_of_view),
            share=self.share,
            frame_id=self.frame_id,
            division=Division(margin=self.margin, smallest=self.smallest, largest=self.largest),
        )
