"""How a map becomes models."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from eigenscan.eigenspace.panorama import Sensor
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
    range_cap: float = 20.0
    field_of_view: float = float(np.pi)
    share: float = 0.9
    frame_id: str = "map"
    division: Division = field(default_factory=Division)
    threads: int = 1

    @property
    def sensor(self) -> Sensor:
        """The sensor that the published eigenspaces are for."""
        return Sensor.facing(self.field_of_view, TURN / self.turn, self.range_cap)

    @property
    def turn(self) -> int:
        """Beams of a panorama: the step is rounded to a whole part of a turn."""
        return round(TURN / self.step)
