"""Buildings with places that look alike: only what is around a corner, behind a door or far off differs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.gridmap import GridMap
from eigenscan.workbench.simulation.world import WALL, Box, Disc, FloorPlan
from numpy.typing import NDArray

Array = NDArray[np.float64]
Furniture = list[Box | Disc]

DOOR = 1.0
TRIES = 200


@dataclass(frozen=True)
class Alike:
    """A building, and poses (n, 3) at places that have a like elsewhere."""

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
    furniture += _along(random, length, deep, deep + hall, [i * wide + door for i in range(count)])
    plan = FloorPlan(rooms, doors, tuple(furniture))
    return _alike("rooms on a hallway", plan, random, [rooms[f"room {i}"] for i in range(count)])


def _hallways(random: np.random.Generator) -> Alike:
    """Two like hallways side by side, joined at one end by a hall; at the other ends niches that differ."""
    length, hall, apart = random.uniform(10.0, 14.0), random.uniform(1.8, 2.4), random.uniform(3.0, 5.0)
    low, high = Box(3.0, 0.0, 3.0 + length, hall), Box(3.0, hall + apart, 3.0 + length, 2 * hall + apart)
    rooms = {"low": low, "high": high, "joined": Box(0.0, 0.0, 3.0, 2 * hall + apart)}
    doors = [Box(2.9, 0.3, 3.1, hall - 0.3), Box(2.9, hall + apart + 0.3, 3.1, 2 * hall + apart - 0.3)]
    # a side room at the far end of each, whose door looks away from the hallway
    for name, hallway, depth in (("nook low", low, 1.6), ("nook high", high, 3.0)):
        x = hallway.x_max - random.uniform(1.2, 2.0)
        rooms[name] = Box(x - 0.9, hallway.y_max, x + 0.9, hallway.y_max + min(depth, apart - 0.4))
        doors.append(_opening(x, hallway.y_max))
    pillars = [random.uniform(2.0, length - 4.0) for _ in range(2)]
    furniture: Furniture = [
        Disc(3.0 + at, hallway.y_min + 0.25, 0.15) for hallway in (low, high) for at in pillars
    ]
    furniture += [Box(0.1, 0.1, 0.7, 1.0), Disc(2.0, hall + apart / 2, 0.25)]
    plan = FloorPlan(rooms, tuple(doors), tuple(furniture))
    return _alike("two hallways", plan, random, [low, high])


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
    return _alike("rooms with closets", plan, random, [rooms[f"room {i}"] for i in range(count)])


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
    return _alike("two halves", plan, random, [rooms["hall"]])


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
    """A table, and shelves at two walls; none before the door."""
    shelf = random.uniform(0.6, deep - 2.0)
    table = 0.8 if door > wide / 2 else wide - 1.6
    return [
        Box(0.1, 0.2, 0.5, 0.2 + shelf),
        Box(wide - random.uniform(1.2, 2.0), 0.1, wide - 0.1, 0.5),
        Box(table, deep / 2 - 0.3, table + random.uniform(0.5, 0.9), deep / 2 + 0.3),
    ]


def _along(
    random: np.random.Generator, length: float, low: float, high: float, doors: list[float]
) -> Furniture:
    """Cupboards at the far wall of a hallway, and at one of its ends."""
    found: Furniture = [Box(length - 0.6, high - 0.9, length - 0.1, high - 0.1)]
    for _ in range(3):
        at, side = random.uniform(0.5, length - 2.0), random.uniform(0.5, 1.4)
        found.append(Box(at, high - random.uniform(0.25, 0.5), at + side, high))
    return found


def _alike(name: str, plan: FloorPlan, random: np.random.Generator, rooms: list[Box]) -> Alike:
    """With poses drawn in the `rooms`, clear of walls."""
    from scipy.ndimage import distance_transform_edt

    grid = plan.render()
    clear = distance_transform_edt(grid.cells == 0) * grid.resolution
    starts = list[list[float]]()
    for _ in range(TRIES):
        room = rooms[int(random.integers(len(rooms)))]
        x = random.uniform(room.x_min + 0.4, room.x_max - 0.4)
        y = random.uniform(room.y_min + 0.4, room.y_max - 0.4)
        column, row = np.floor(grid.to_grid(np.array([x, y]))).astype(int)
        if clear[row, column] > 0.45:
            starts.append([x, y, random.uniform(-np.pi, np.pi)])
    return Alike(name, grid, np.array(starts))
