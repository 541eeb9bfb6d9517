"""How a map becomes models."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from eigenscan.eigenspace.analysis import COMPONENTS, Analysis, beams_of
from eigenscan.eigenspace.embedding import Embedding, Kind
from eigenscan.geometry.circle import TURN
from eigenscan.mapbuilder.regions import Division


@dataclass(frozen=True)
class Plan:
    """How a map becomes models. Lengths in m, angles in rad."""

    spacing: float = 0.5
    error: float = 0.0
    """Closer than `spacing` where panoramas cannot be interpolated so well, m, rms; 0: nowhere."""
    step: float = float(np.deg2rad(0.5))
    clearance: float = 0.15
    range_max: float = 80.0
    embedding: Kind = "ring"
    range_cap: float | None = None
    """None: the usual one of the embedding."""
    field_of_view: float = float(np.pi)
    """Of the declared lidar, for which eigenspaces are published."""
    components: int = COMPONENTS
    frame_id: str = "map"
    division: Division = field(default_factory=Division)
    threads: int = 1

    @property
    def analysis(self) -> Analysis:
        """The analysis that makes eigenspaces of panoramas."""
        embedding = Embedding.of(self.embedding, self.range_cap)
        return Analysis(embedding, beams_of(self.field_of_view), self.components)

    @property
    def turn(self) -> int:
        """Beams of a panorama: the step is rounded to a whole part of a turn."""
        return round(TURN / self.step)
