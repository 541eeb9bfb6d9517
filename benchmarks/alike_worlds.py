"""Buildings with places that look alike: only what is around a corner, behind a door or far off differs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.gridmap import FREE, GridMap
from eigenscan.geometry.pose import compose
from eigenscan.geometry.raycast import RayCaster
from eigenscan.workbench.simulation.world import WALL, Box, Disc, FloorPlan
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

Array = NDArray[np.float64]
Furniture = list[Box | Disc]
Like = Callable[[Array], Array]
"""Gives the pose (3,) at a like place."""

DOOR = 1.0
TRIES = 300
CLEAR_M = 0.45
"""From a start to the nearest wall."""
REACH_M, TOLERANCE_M, MOST_DIFFERENT = 12.0, 0.15, 0.02
"""Places are alike where so few of a scan's beams, up to so long, differ by more than the tolerance."""


@dataclass(frozen=True)
class Alike:
    """A building, and poses (n, 3) from which a scan all around looks like one elsewhere."""

    name: str
    grid: GridMap
    starts: Array


def worlds(seed: int) -> list[Alike]:
    """One of each kind."""
    return [kind(np.random.default_rng([seed, number])) for number, kind in enumerate(KINDS)]


def _cells(random: np.random.Generator) -> Alike:
    """Like rooms in a row, their doors on a hallway whose furniture differs."""
    count, wide, deep = int(random.integers(3, 5)), random.uniform(3.6, 5.0), random.uniform(3.6, 5.0)
    hall = random.uniform(1.8, 2.4)
    rooms = {f"room {i}": Box(i * wide, 0.0, (i + 1) * wide, deep) for i in range(count)}
    length = count * wide
    rooms["hallway"] = Box(0.0, deep, length, deep + hall)
    door = random.uniform(0.8, wide - 0.8)
    doors = tuple(_opening(i * wide + door, deep) for i in range(count))
    pieces = _furnished(random, wide, deep, door)
    furniture = [piece for i in range(count) for piece in _moved(pieces, i * wide, 0.0)]
    furniture += _along(random, length, deep + hall)
    plan = FloorPlan(rooms, doors, tuple(furniture))
    return _alike("rooms on a hallway", plan, random, rooms["room 0"], _in_row(wide, count))


def _hallways(random: np.random.Generator) -> Alike:
    """Two like hallways side by side, joined at one end by a hall; at the other ends niches that differ."""
    length, hall, apart = random.uniform(20.0, 26.0), random.uniform(1.8, 2.4), random.uniform(3.0, 5.0)
    low, high = Box(3.0, 0.0, 3.0 + length, hall), Box(3.0, hall + apart, 3.0 + length, 2 * hall + apart)
    rooms = {"low": low, "high": high, "joined": Box(0.0, 0.0, 3.0, 2 * hall + apart)}
    doors = [Box(2.9, 0.3, 3.1, hall - 0.3), Box(2.9, hall + apart + 0.3, 3.1, 2 * hall + apart - 0.3)]
    # a side room at the far end of each, whose door looks away from the hallway
    for name, hallway, depth in (("nook low", low, 1.6), ("nook high", high, 3.0)):
        x = hallway.x_max - random.uniform(1.2, 2.0)
        rooms[name] = Box(x - 0.9, hallway.y_max, x + 0.9, hallway.y_max + min(depth, apart - 0.4))
        doors.append(_opening(x, hallway.y_max))
    pillars = [random.uniform(2.0, length - 4.0) for _ in range(3)]
    furniture: Furniture = [
        Disc(3.0 + at, hallway.y_min + 0.25, 0.15) for hallway in (low, high) for at in pillars
    ]
    furniture += [Box(0.1, 0.1, 0.7, 1.0), Disc(2.0, hall + apart / 2, 0.25)]
    plan = FloorPlan(rooms, tuple(doors), tuple(furniture))
    return _alike("two hallways", plan, random, low, _shifted(0.0, hall + apart))


def _corners(random: np.random.Generator) -> Alike:
    """Rooms of an L shape, all alike but for what stands around the corner."""
    count, wide, deep = 3, random.uniform(4.0, 5.0), random.uniform(4.0, 5.0)
    rooms, doors, furniture = {}, [], list[Box | Disc]()
    door = random.uniform(0.8, wide - 0.8)
    pieces = _furnished(random, wide, deep, door)
    closet = random.uniform(1.8, 2.6)
    for i in range(count):
        x = i * (wide + 0.6)
        rooms[f"room {i}"] = Box(x, 0.0, x + wide, deep)
        rooms[f"closet {i}"] = Box(x, deep, x + wide, deep + closet)
        doors.append(_opening(x + door, deep))
        furniture += _moved(pieces, x, 0.0)
        at = x + random.uniform(0.3, wide - 1.2)
        if abs(at + 0.4 - x - door) > 1.0:
            furniture.append(Box(at, deep + closet - random.uniform(0.4, 0.9), at + 0.8, deep + closet))
        if i:  # a way from room to room, on the side that all have
            doors.append(Box(x - 0.7, deep + 0.5, x + 0.1, deep + 1.4))
            rooms[f"lock {i}"] = Box(x - 0.6, deep + 0.4, x, deep + 1.5)
            doors.append(Box(x - 0.7, deep + 0.5, x - 0.5, deep + 1.4))
    plan = FloorPlan(rooms, tuple(doors), tuple(furniture))
    return _alike("rooms with closets", plan, random, rooms["room 0"], _in_row(wide + 0.6, count))


def _halves(random: np.random.Generator) -> Alike:
    """A floor that is the same turned by half, but for what its two side rooms hold and how deep they are."""
    length, hall = random.uniform(12.0, 16.0), random.uniform(2.4, 3.2)
    wide, deep = random.uniform(3.2, 4.4), random.uniform(3.0, 4.0)
    low, high = deep, deep + hall
    rooms = {
        "hall": Box(0.0, low, length, high),
        "south": Box(0.8, 0.0, 0.8 + wide, low),
        "north": Box(length - 0.8 - wide, high, length - 0.8, high + deep + random.uniform(0.6, 1.2)),
    }
    x = 0.8 + random.uniform(0.8, wide - 0.8)
    doors = (_opening(x, low), _opening(length - x, high))
    at = random.uniform(length / 2 - 2.0, length / 2 + 2.0)
    furniture: Furniture = [
        Disc(at, low + 0.6, 0.2),
        Disc(length - at, high - 0.6, 0.2),
        Box(0.9, 0.1, 0.9 + random.uniform(1.0, 1.6), random.uniform(0.7, 1.1)),
    ]
    plan = FloorPlan(rooms, doors, tuple(furniture))
    middle = np.array([length / 2, low + hall / 2, 0.0])
    return _alike(
        "two halves",
        plan,
        random,
        rooms["hall"],
        [lambda pose: compose(middle, compose([0, 0, np.pi], pose - middle))],
    )


KINDS = (_cells, _hallways, _corners, _halves)


def _opening(x: float, y: float) -> Box:
    """A door in a wall that runs along x."""
    return Box(x - DOOR / 2, y - WALL, x + DOOR / 2, y + WALL)


def _moved(pieces: Furniture, x: float, y: float) -> Furniture:
    return [
        piece.moved(x, y) if isinstance(piece, Box) else Disc(piece.x + x, piece.y + y, piece.radius)
        for piece in pieces
    ]


def _furnished(random: np.random.Generator, wide: float, deep: float, door: float) -> Furniture:
    """A table, and racks at two walls; none before the door."""
    rack = random.uniform(0.6, deep - 2.0)
    table = 0.8 if door > wide / 2 else wide - 1.6
    return [
        Box(0.1, 0.2, 0.5, 0.2 + rack),
        Box(wide - random.uniform(1.2, 2.0), 0.1, wide - 0.1, 0.5),
        Box(table, deep / 2 - 0.3, table + random.uniform(0.5, 0.9), deep / 2 + 0.3),
    ]


def _along(random: np.random.Generator, length: float, high: float) -> Furniture:
    """Cupboards at the far wall of a hallway, and at one of its ends."""
    found: Furniture = [Box(length - 0.6, high - 0.9, length - 0.1, high - 0.1)]
    for _ in range(3):
        at, side = random.uniform(0.5, length - 2.0), random.uniform(0.5, 1.4)
        found.append(Box(at, high - random.uniform(0.25, 0.5), at + side, high))
    return found


def _shifted(x: float, y: float) -> list[Like]:
    return [lambda pose: pose + np.array([x, y, 0.0])]


def _in_row(wide: float, count: int) -> list[Like]:
    """The same place of all rooms of a row but the first."""
    return [like for i in range(1, count) for like in _shifted(i * wide, 0.0)]


def _alike(
    name: str, plan: FloorPlan, random: np.random.Generator, first: Box, likes: Sequence[Like]
) -> Alike:
    """With poses drawn in the `first` of the like places and its likes, where a scan does not tell which."""
    grid = plan.render()
    caster, clear = RayCaster.of(grid), distance_transform_edt(grid.cells == FREE) * grid.resolution
    bearings, starts = np.arange(360) * (2.0 * np.pi / 360), list[Array]()
    for _ in range(TRIES):
        x = random.uniform(first.x_min + 0.4, first.x_max - 0.4)
        y = random.uniform(first.y_min + 0.4, first.y_max - 0.4)
        poses = np.array([[x, y, random.uniform(-np.pi, np.pi)]])
        poses = np.vstack([poses, *(like(poses[0]) for like in likes)])
        column, row = np.floor(grid.to_grid(poses[:, :2])).astype(int).T
        if (clear[row, column] < CLEAR_M).any():
            continue
        seen = np.minimum(caster.cast(poses, bearings, REACH_M), REACH_M)
        true = int(random.integers(len(poses)))
        differs = (np.abs(np.delete(seen, true, axis=0) - seen[true]) > TOLERANCE_M).mean(axis=1)
        if differs.min() < MOST_DIFFERENT:
            starts.append(poses[true])
    return Alike(name, grid, np.array(starts).reshape(-1, 3))
