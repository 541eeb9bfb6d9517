"""Settings that may change the mapbuilder's answers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Literal

from eigenscan.schemas.settings import Settings
from pydantic import Field

if TYPE_CHECKING:
    from eigenscan.mapbuilder.site import Plan


class MapbuilderSettings(Settings):
    """Settings of mapbuilder: a map in, eigenspace models out."""

    gone: ClassVar[Mapping[str, str]] = {
        "share": "components is how many are kept; their share of the variance follows"
    }

    frame_id: str = Field("map", min_length=1, description="name of the map frame in published messages")
    spacing: float = Field(0.5, ge=0.05, le=5.0, description="m between grid positions")
    error: float = Field(
        0.0,
        ge=0.0,
        le=20.0,
        description="add positions where interpolation is off by more than this many metres; 0 disables",
    )
    step: float = Field(0.5, ge=0.1, le=10.0, description="degrees between the beams of a panorama")
    clearance: float = Field(0.15, ge=0.0, le=5.0, description="m that grid positions keep from walls")
    range_max: float = Field(80.0, gt=0.0, le=130.0, description="m; walls farther away are ignored")
    embedding: Literal["ring", "range"] = Field(
        "ring", description="quantity that is analysed: ring (default), or range as in the paper"
    )
    range_cap: float | None = Field(
        None,
        gt=0.0,
        le=130.0,
        description="m; longer ranges count as this; default 12 (ring) or 15 (range)",
    )
    field_of_view: float = Field(
        180.0,
        gt=0.0,
        le=360.0,
        description="degrees that the usual lidar sees",
    )
    components: int = Field(16, ge=1, le=64, description="principal components kept for each region")
    margin: float = Field(1.0, ge=0.0, le=10.0, description="m by which neighbouring regions overlap")
    smallest: float = Field(4.0, ge=0.0, description="m^2; smaller regions are merged into a neighbour")
    largest: float = Field(150.0, ge=1.0, description="m^2; larger regions are split")
    changes: Literal["off", "propose", "publish"] | None = Field(
        None,
        description="what to do with lasting changes that robots see: off, propose (an operator accepts) "
        "or publish; by default propose where the model folder can be written",
    )
    visits: int = Field(4, ge=2, le=50, description="visits in a row that must agree before a change counts")
    visit: float = Field(
        30.0, ge=0.1, le=1440.0, description="minutes of one visit; what is seen within counts once"
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
            embedding=self.embedding,
            range_cap=self.range_cap,
            field_of_view=math.radians(self.field_of_view),
            components=self.components,
            frame_id=self.frame_id,
            division=Division(margin=self.margin, smallest=self.smallest, largest=self.largest),
        )
