"""Simulates a 2D lidar: walls, people, noise, and missing beams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.pose import Array, compose
from eigenscan.geometry.raycast import RayCaster
from eigenscan.workbench.simulation.people import RADIUS


@dataclass(frozen=True)
class Lidar:
    """A sensor and its faults. The default is the paper's, but for a shorter reach."""

    beams: int = 361
    fov: float = np.pi  # rad, from the first beam to the last
    rate: float = 10.0  # Hz
    range_min: float = 0.04  # m
    range_max: float = 30.0  # m
    noise: float = 0.015  # m, standard deviation
    missing: float = 0.01  # share of the beams that are lost
    mount: tuple[float, float, float] = (0.1, 0.0, 0.0)  # m, m, rad in the robot's base frame
    sweep: float = 0.0  # s from the first beam to the last

    @property
    def angle_increment(self) -> float:
        """Step from beam to beam, rad."""
        return self.fov / (self.beams - 1)

    @property
    def time_increment(self) -> float:
        """Time from beam to beam, s."""
        return self.sweep / (self.beams - 1)

    @property
    def bearings(self) -> Array:
        """Direction of each beam (B,) in the sensor's frame, rad."""
        return np.arange(self.beams, dtype=np.float64) * self.angle_increment - self.fov / 2

    def measure(self, walls: RayCaster, bases: Array, people: Array, random: np.random.Generator) -> Array:
        """Ranges (B,), m, among `people` (n, 2): +inf: no return, NaN: missing.

        `bases`: the base's pose (3,), or its poses (k, 3) at equal times from the first beam to the last.
        """
        sensors = compose(np.atleast_2d(bases), self.mount)
        nearest = np.rint(np.arange(self.beams) * ((len(sensors) - 1) / (self.beams - 1)))
        parts = np.split(self.bearings, np.flatnonzero(np.diff(nearest)) + 1)
        ranges = np.concatenate(
            [self._seen(walls, *part, people) for part in zip(sensors, parts, strict=True)]
        )
        # as many draws in every scan, so that one scan's beams do not shift the next one's noise
        ranges = ranges + self.noise * random.standard_normal(self.beams)
        lost = random.random(self.beams) < self.missing
        ranges[ranges > self.range_max] = np.inf
        ranges[lost | (ranges < self.range_min)] = np.nan
        return ranges

    def _seen(self, walls: RayCaster, sensor: Array, bearings: Array, people: Array) -> Array:
        to_walls = walls.cast(sensor, bearings, self.range_max)[0].astype(np.float64)
        seen: Array = np.minimum(to_walls, to_discs(sensor, bearings, people, RADIUS))
        return seen


LIDARS = {
    "generic": Lidar(),
    "sick-lms200": Lidar(361, np.pi, 10.0, 0.04, 30.0, 0.015),
    "sick-tim571": Lidar(811, np.deg2rad(270.0), 15.0, 0.05, 25.0, 0.02, sweep=0.05),
    "hokuyo-urg-04lx": Lidar(683, np.deg2rad(240.0), 10.0, 0.06, 4.0, 0.01, sweep=0.067),
    "hokuyo-utm-30lx": Lidar(1081, np.deg2rad(270.0), 40.0, 0.1, 30.0, 0.01, sweep=0.019),
    "rplidar-a1": Lidar(360, np.deg2rad(359.0), 5.5, 0.15, 12.0, 0.02, 0.05, sweep=0.181),
    "rplidar-a2": Lidar(400, np.deg2rad(359.1), 10.0, 0.2, 12.0, 0.02, 0.03, sweep=0.1),
}
"""Lidars by name: beams, angles, rates and limits as their makers state them, noise about so.

They sweep as long as their angle's share of a turn takes. The LMS 200's mirror turns 75 times a second.
"""


def to_discs(sensor: Array, bearings: Array, centres: Array, radius: float) -> Array:
    """Distance (B,) along each beam to the first disc, +inf if there is none.

    `sensor` (3,) and `centres` (n, 2) in one frame. A disc around the sensor itself is not seen.
    """
    angles = sensor[2] + bearings
    directions = np.stack([np.cos(angles), np.sin(angles)])
    offset = centres - sensor[:2]
    along = offset @ directions
    squared = np.sum(offset**2, axis=1, keepdims=True)
    half_chord = radius**2 - (squared - along**2)
    near_side = along - np.sqrt(np.maximum(half_chord, 0.0))
    hit = (half_chord > 0) & (near_side > 0) & (squared > radius**2)
    nearest: Array = np.min(np.where(hit, near_side, np.inf), axis=0, initial=np.inf)
    return nearest
