"""A building to drive through: a loop of hallways around rooms that differ, and the scans of a drive."""

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.pose import between, compose
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.mapping.chain import Sweep
from eigenscan.mapbuilder.mapping.cloud import Outline

from tests.services.mapbuilder.floorplan import blank, box, room

BEARINGS = np.deg2rad(np.arange(-90, 90.5, 1.0))


def building() -> GridMap:
    """24 m x 16 m: hallways of 2 m around a block with niches, rooms with furniture outside."""
    grid = blank(40.0, 32.0)
    room(grid, 8.0, 8.0, 32.0, 24.0)
    box(grid, 10.0, 10.0, 30.0, 22.0, OCCUPIED)
    rng = np.random.default_rng(7)
    for left, bottom, width, height in (
        (9.0, 24.2, 5.0, 4.0),
        (15.0, 24.2, 6.5, 5.0),
        (23.0, 24.2, 7.0, 4.4),
        (9.0, 2.8, 7.0, 5.0),
        (17.5, 3.8, 5.0, 4.0),
        (24.0, 3.4, 6.0, 4.4),
    ):
        room(grid, left, bottom, left + width, bottom + height)
        door = left + rng.uniform(0.8, width - 2.0)
        low = 23.8 if bottom > 20 else 7.6
        box(grid, door, low, door + 1.1, low + 0.6, FREE)
        for _ in range(3):
            x, y = left + rng.uniform(0.3, width - 1.3), bottom + rng.uniform(0.6, height - 1.5)
            box(grid, x, y, x + rng.uniform(0.3, 0.9), y + rng.uniform(0.3, 0.7), OCCUPIED)
    for x in (12.0, 17.0, 26.5):
        box(grid, x, 10.0, x + rng.uniform(0.6, 1.6), 10.6, FREE)
    for y in (12.5, 17.0):
        box(grid, 10.0, y, 10.7, y + rng.uniform(0.8, 1.4), FREE)
        box(grid, 29.4, y + 1.5, 30.0, y + 2.4, FREE)
    return grid


def drive(turns: float = 1.25, spacing: float = 0.2) -> np.ndarray:
    """True poses (n, 3) of a drive around the block, through its hallways, `turns` times."""
    corners = np.array([[9.1, 9.0], [31.0, 9.2], [30.9, 23.0], [9.0, 22.9]])
    poses: list[list[float]] = []
    for leg in range(round(4 * turns)):
        here, there = corners[leg % 4], corners[(leg + 1) % 4]
        heading = np.arctan2(*(there - here)[::-1])
        if poses:
            bend = heading - poses[-1][2]
            bend = (bend + np.pi) % (2 * np.pi) - np.pi
            poses += [[*here, poses[-1][2] + bend * share] for share in np.linspace(0.1, 1.0, 10)]
        for share in np.arange(0, np.linalg.norm(there - here), spacing) / np.linalg.norm(there - here):
            poses.append([*(here + share * (there - here)), heading])
    return np.array(poses)


def scans(
    grid: GridMap,
    poses: np.ndarray,
    seed: int = 0,
    drift: tuple[float, float] | None = None,
    mount: tuple[float, float, float] = (0.1, 0.0, 0.0),
) -> list[Sweep]:
    """Sweeps of the poses, 5 a second; `drift`: odometry is wrong by this share of a step, and rad a m."""
    rng = np.random.default_rng(seed)
    ranges = RayCaster.of(grid).cast(compose(poses, mount), BEARINGS, 25.0).astype(float)
    ranges += rng.normal(0, 0.01, ranges.shape)
    at, odometry = np.array(mount), None if drift is None else _odometry(poses, drift, rng)
    return [
        Sweep(round(k * 0.2e9), Outline.of(own, BEARINGS), at, None if odometry is None else odometry[k])
        for k, own in enumerate(ranges)
    ]


def _odometry(poses: np.ndarray, drift: tuple[float, float], rng: np.random.Generator) -> np.ndarray:
    steps = between(poses[:-1], poses[1:])
    way = np.hypot(steps[:, 0], steps[:, 1])
    steps[:, :2] *= 1 + drift[0]
    steps[:, 2] += drift[1] * way + rng.normal(0, 0.002, len(way))
    found = [np.array([5.0, -3.0, 0.7])]
    for step in steps:
        found.append(compose(found[-1], step))
    return np.array(found)
