"""Walking people, seen by the lidar but not on the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.pose import Array
from eigenscan.workbench.simulation.route import Planner

RADIUS = 0.22
"""m, of a body at the lidar's height."""

PERSONAL_SPACE = 1.0
"""Distance of the robot's centre at which people step aside, m."""


@dataclass(frozen=True)
class Walker:
    """Someone on the way along `way` (n, 2), about 5 cm a point, and back, again and again."""

    way: Array
    speed: float  # m/s
    offset: float  # m along the way at time 0

    def at(self, time: float) -> Array:
        """Position (2,) at `time` s."""
        spacing = float(np.hypot(*(self.way[1] - self.way[0])))
        length = spacing * (len(self.way) - 1)
        along = (self.offset + self.speed * time) % (2 * length)
        place = min(along, 2 * length - along) / spacing
        index = np.arange(len(self.way))
        return np.array([np.interp(place, index, self.way[:, axis]) for axis in (0, 1)])


def draw_walkers(planner: Planner, count: int, random: np.random.Generator) -> list[Walker]:
    """People between random places of the map, at a stroll."""
    walkers = []
    for _ in range(count):
        start = planner.draw_goal(random, np.zeros(2), 0.0)
        way = planner.way(start, planner.draw_goal(random, start, 8.0))
        walkers.append(Walker(way, float(random.uniform(0.6, 1.2)), float(random.uniform(0.0, 50.0))))
    return walkers


def stander(place: tuple[float, float]) -> Walker:
    """A person who stands at `place`, m, map frame, and steps aside for the robot."""
    return Walker(np.array([place, (place[0] + 1e-6, place[1])]), speed=0.0, offset=0.0)


def positions(walkers: list[Walker], time: float, robot: Array) -> Array:
    """Positions (n, 2) at `time`, out of the way of the robot at (2,)."""
    if not walkers:
        return np.empty((0, 2))
    places = np.stack([walker.at(time) for walker in walkers])
    apart = places - robot
    distance = np.hypot(apart[:, 0], apart[:, 1])
    near = distance < PERSONAL_SPACE
    direction = np.where(distance[:, None] > 1e-9, apart / np.maximum(distance, 1e-9)[:, None], [1.0, 0.0])
    places[near] = robot + PERSONAL_SPACE * direction[near]
    return places
