"""The settings of mapbuilder."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.runtime.settings import ServiceSettings
from pydantic import Field, model_validator

if TYPE_CHECKING:
    from eigenscan.mapbuilder.site import Plan


class _Process(ServiceSettings):
    robot: str = Field("*", description="robot whose scans keep the map true; * is every robot")
    behind_after: float = Field(math.inf, ge=0, description="s; no robot waits for its answer")
    map: Path | None = Field(None, description="map_server yaml to build models from")
    model: Path | None = Field(
        None,
        description="folder of models; with map: built from it at the first start and kept true",
    )
    threads: int = Field(1, ge=1, le=256, description="threads for building; the result is the same")


class MapbuilderOptions(MapbuilderSettings, _Process):
    """Settings of mapbuilder: a map in, eigenspace models out."""

    @model_validator(mode="after")
    def _one_source(self) -> MapbuilderOptions:
        if self.map is None and self.model is None:
            raise ValueError("give map (a map_server yaml), model (a folder of models), or both")
        if self.changes in ("propose", "publish") and self.model is None:
            raise ValueError(
                "changes needs model, a folder for new versions: give one beside map, "
                "or build it with eigenscan build"
            )
        return self

    @property
    def plan(self) -> Plan:
        """The same in the units of the library."""
        return replace(super().plan, threads=self.threads)
