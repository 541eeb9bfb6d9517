"""Made-up office floors of any size: hallways with rooms on both sides, no two of them alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.geometry.pose import to_message as pose_message
from eigenscan.geometry.raycast import RayCaster
from eigenscan.schemas.envelope import stamp
from eigenscan.schemas.scan_pb2 import Scan
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

RESOLUTION = 0.05
WALL, HALLWAY, DOOR = 0.1, 2.0, 1.0
DEPTH = (4.0, 6.5)
ROOM = (2.6, 7.5)
FIRE_DOORS = (15.0, 30.0)
_OPEN_SHARE = 0.88
"""Of the area between the outer walls, what is free in the end."""


@dataclass
class _Canvas:
    cells: NDArray[np.uint8]

    def box(self, x0: float, y0: float, x1: float, y1: float, value: int) -> None:
        c0, r0, c1, r1 = (round(v / RESOLUTION) for v in (x0, y0, x1, y1))
        self.cells[r0 : max(r1, r0 + 1), c0 : max(c1, c0 + 1)] = value


def floor(free_m2: float, seed: int = 1) -> GridMap:
    """A floor with about `free_m2` of free area: wings one above the other, about as high as it is long."""
    rng = np.random.default_rng(seed)
    wings = max(1, round(float(np.sqrt(free_m2 / _OPEN_SHARE)) / (sum(DEPTH) + HALLWAY)))
    depths = rng.uniform(*DEPTH, (wings, 2))
    height = float(depths.sum()) + wings * HALLWAY
    length = free_m2 / _OPEN_SHARE / height
    canvas = _Canvas(
        np.full((round(height / RESOLUTION) + 40, round(length / RESOLUTION) + 40), UNKNOWN, dtype=np.uint8)
    )
    y = 1.0
    for below, above in depths:
        canvas.box(1.0, y, 1.0 + length, y + below + HALLWAY + above, OCCUPIED)
        _hallway(canvas, rng, length, y + below)
        _rooms(canvas, rng, length, y, y + below, y + below)
        _rooms(canvas, rng, length, y + below + HALLWAY, y + below + HALLWAY + above, y + below + HALLWAY)
        y += below + HALLWAY + above
    canvas.box(1.0 + length - WALL, 1.0, 1.0 + length, y, OCCUPIED)
    return GridMap(canvas.cells, RESOLUTION, np.zeros(3))


def warehouse(thick: float, seed: int = 1) -> GridMap:
    """38 m x 26 m with thin walls, and five rows of racks so many metres thick, drawn filled."""
    rng = np.random.default_rng(seed)
    canvas = _Canvas(np.full((560, 800), UNKNOWN, dtype=np.uint8))
    canvas.box(1.0, 1.0, 39.0, 27.0, OCCUPIED)
    canvas.box(1.15, 1.15, 38.85, 26.85, FREE)
    for y in np.arange(4.0, 23.0, 4.5):
        x = 5.0
        while x < 34.0:
            end = x + float(rng.uniform(4.0, 8.0))
            canvas.box(x, y, min(end, 35.0), y + thick, OCCUPIED)
            x = end + float(rng.choice([0.0, 2.2]))
    return GridMap(canvas.cells, RESOLUTION, np.zeros(3))


def _hallway(canvas: _Canvas, rng: np.random.Generator, length: float, y: float) -> None:
    canvas.box(1.0 + WALL, y, 1.0 + length - WALL, y + HALLWAY, FREE)
    x = float(rng.uniform(*FIRE_DOORS))
    while x < length - 5.0:
        canvas.box(1.0 + x, y, 1.0 + x + WALL, y + HALLWAY, OCCUPIED)
        side = rng.uniform(0.1, HALLWAY - 1.4)
        canvas.box(1.0 + x, y + side, 1.0 + x + WALL, y + side + 1.3, FREE)
        x += float(rng.uniform(*FIRE_DOORS))
    for _ in range(int(length / 12)):
        at, deep = rng.uniform(2.0, length - 3.0), rng.uniform(0.2, 0.5)
        low = y if rng.random() < 0.5 else y + HALLWAY - deep
        canvas.box(1.0 + at, low, 1.0 + at + rng.uniform(0.3, 1.4), low + deep, OCCUPIED)


def _rooms(
    canvas: _Canvas, rng: np.random.Generator, length: float, low: float, high: float, wall: float
) -> None:
    """Rooms along a hallway whose nearer edge is at y = `wall`."""
    at = 0.0
    while length - at > ROOM[0]:
        width = float(rng.uniform(*ROOM))
        width = length - at if length - at - width < ROOM[0] else width
        x0, x1 = 1.0 + at + WALL, 1.0 + at + width
        y0, y1 = low + (WALL if wall == low else 0.0), high - (WALL if wall == high else 0.0)
        y0, y1 = (y0, y1 - WALL) if wall == low else (y0 + WALL, y1)
        canvas.box(x0, y0, x1, y1, FREE)
        for _ in range(int(rng.integers(1, 4))):
            _piece(canvas, rng, (x0, y0, x1, y1))
        door = float(rng.uniform(x0 + 0.1, x1 - 0.1 - DOOR))
        canvas.box(door, wall - 2 * WALL, door + DOOR, wall + 2 * WALL, FREE)
        at += width


def _piece(canvas: _Canvas, rng: np.random.Generator, room: tuple[float, float, float, float]) -> None:
    """A table, a shelf or a pillar, half of them against a wall."""
    x0, y0, x1, y1 = room
    wide, deep = rng.uniform(0.3, 1.8), rng.uniform(0.3, 0.9)
    if rng.random() < 0.5:
        wide, deep = deep, wide
    x, y = rng.uniform(x0, max(x1 - wide, x0 + 0.1)), rng.uniform(y0, max(y1 - deep, y0 + 0.1))
    if rng.random() < 0.5:
        x = x0 if rng.random() < 0.5 else x1 - wide
    canvas.box(x, y, min(x + wide, x1), min(y + deep, y1), OCCUPIED)


def poses(grid: GridMap, count: int, seed: int, clearance: float = 0.3) -> NDArray[np.float64]:
    """Random poses (count, 3) on free space, map frame."""
    rng = np.random.default_rng(seed)
    roomy = distance_transform_edt(grid.cells == FREE) * grid.resolution > clearance
    row, column = np.nonzero(roomy)
    pick = rng.choice(len(row), count, replace=False)
    points = grid.to_map(np.column_stack([column[pick], row[pick]]) + rng.uniform(0, 1, (count, 2)))
    return np.column_stack([points, rng.uniform(-np.pi, np.pi, count)])


def scan_at(
    caster: RayCaster,
    pose: NDArray[np.float64],
    seed: int,
    field_of_view: float = np.pi,
    step: float = float(np.deg2rad(0.5)),
    range_max: float = 30.0,
    people: float = 0.1,
) -> Scan:
    """What a lidar at `pose` sees: 1 cm of noise, and `people` of its beams cut short by legs."""
    rng = np.random.default_rng(seed)
    beams = min(round(field_of_view / step) + 1, round(2 * np.pi / step))
    angle_min = -0.5 * step * (beams - 1)
    ranges = caster.cast(pose, angle_min + np.arange(beams) * step, range_max)[0].astype(np.float64)
    hidden = np.zeros(beams, dtype=bool)
    while hidden.mean() < people:
        away = rng.uniform(0.6, 3.0)
        run = (rng.integers(beams) + np.arange(max(1, round(0.15 / away / step)))) % beams
        ranges[run] = np.minimum(ranges[run], away)
        hidden[run] = True
    ranges += rng.normal(0.0, 0.01, beams)
    scan = Scan(
        timestamp=stamp(seed + 1),
        frame_id="base_link",
        mount=pose_message((0.0, 0.0, 0.0)),
        angle_min=angle_min,
        angle_increment=step,
        range_min=0.05,
        range_max=range_max,
        sequence=seed,
    )
    scan.ranges.extend(np.where(ranges > range_max, np.inf, np.maximum(ranges, 0.05)).tolist())
    return scan
