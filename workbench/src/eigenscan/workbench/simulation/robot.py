"""The robot's motion, and the odometry of its wheels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.pose import Array, between, compose
from eigenscan.workbench.simulation.route import Planner
from numpy.typing import NDArray

TICKS_PER_S = 100
PERIOD = 1.0 / TICKS_PER_S
"""s, step of the motion."""

LOOK_AHEAD = 0.4
"""m along the route to the point that the robot steers for."""

KIDNAP_DISTANCE = 5.0
"""m, a kidnapped robot is put down at least so far away."""


@dataclass(frozen=True)
class Drive:
    """Limits of the robot."""

    speed: float = 0.5  # m/s
    turn_rate: float = 1.0  # rad/s
    radius: float = 0.25  # m


@dataclass(frozen=True)
class OdometryNoise:
    """A random walk: the variance grows with the way, so it does not depend on the odometry's rate."""

    distance: float = 0.02  # m per sqrt(m) travelled
    heading_travel: float = 0.01  # rad per sqrt(m) travelled
    heading_turn: float = 0.02  # rad per sqrt(rad) turned
    scale: float = 0.01  # standard deviation of a wheel's wrong radius, drawn once: m per m


def drive_route(
    planner: Planner,
    start: Array,
    ticks: int,
    drive: Drive,
    random: np.random.Generator,
    goals: Sequence[tuple[float, float]] = (),
) -> Array:
    """Poses (ticks, 3), PERIOD apart, on a drive from `start` (2,) to `goals`, then to random ones."""
    ahead = iter(goals)
    here = planner.points(np.array([planner.cell(start)]))[0]
    poses = np.empty((0, 3))
    heading = float(random.uniform(-np.pi, np.pi))
    while len(poses) < ticks:
        given = next(ahead, None)
        goal = planner.draw_goal(random, here, KIDNAP_DISTANCE) if given is None else np.array(given)
        way = planner.way(here, goal)
        leg = _follow(way, heading, ticks - len(poses), drive)
        poses = np.concatenate([poses, leg])
        here, heading = poses[-1, :2], float(poses[-1, 2])
    return poses


def _follow(way: Array, heading: float, ticks: int, drive: Drive) -> Array:
    """Poses until the end of `way` (n, 2) is reached, at most `ticks`, at least one."""
    ahead = max(1, round(LOOK_AHEAD / max(1e-6, float(np.hypot(*(way[1] - way[0]))))))
    x, y, theta = float(way[0, 0]), float(way[0, 1]), heading
    poses = np.empty((ticks, 3))
    nearest = 0
    for tick in range(ticks):
        poses[tick] = x, y, theta
        window = way[nearest : nearest + 2 * ahead]
        nearest += int(np.argmin(np.hypot(window[:, 0] - x, window[:, 1] - y)))
        if nearest >= len(way) - 1:
            return poses[: tick + 1]
        target_x, target_y = way[min(nearest + ahead, len(way) - 1)]
        error = float(wrap(np.arctan2(target_y - y, target_x - x) - theta))
        turn = max(-drive.turn_rate, min(drive.turn_rate, 3.0 * error))
        # turns on the spot towards a target behind it, slows down in bends
        speed = drive.speed * max(0.0, np.cos(error)) ** 3 if abs(error) < 1.2 else 0.0
        theta += turn * PERIOD
        x += speed * PERIOD * np.cos(theta)
        y += speed * PERIOD * np.sin(theta)
    return poses


def odometry(
    poses: Array, jumps: NDArray[np.int64], noise: OdometryNoise, random: np.random.Generator
) -> Array:
    """Odometry (n, 3) of a drive over `poses` (n, 3), in the frame of its first pose.

    At the indices `jumps` the robot was kidnapped: the wheels did not turn.
    """
    steps = between(poses[:-1], poses[1:])
    steps[jumps - 1] = 0.0
    distance, turn = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    count = len(steps)
    steps[:, 0] *= 1.0 + noise.scale * random.standard_normal()
    steps[:, 0] += noise.distance * np.sqrt(distance) * random.standard_normal(count)
    steps[:, 2] += noise.heading_travel * np.sqrt(distance) * random.standard_normal(count)
    steps[:, 2] += noise.heading_turn * np.sqrt(turn) * random.standard_normal(count)
    return _chain(steps)


def _chain(steps: Array) -> Array:
    """Poses (n + 1, 3) that `steps` (n, 3) lead to, from the identity."""
    headings = np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    cos, sin = np.cos(headings[:-1]), np.sin(headings[:-1])
    x = np.cumsum(cos * steps[:, 0] - sin * steps[:, 1])
    y = np.cumsum(sin * steps[:, 0] + cos * steps[:, 1])
    positions = np.concatenate([np.zeros((1, 2)), np.stack([x, y], axis=1)])
    return compose(np.zeros(3), np.column_stack([positions, headings]))
