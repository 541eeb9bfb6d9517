"""The demo's own building: the paper's square room beside an office with rooms and a hallway.

All lengths are metres in the map frame, whose origin is the building's south-west corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, MapError
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

WALL = 0.1
"""Thickness of a wall, centred on the outline of its room."""

RESOLUTION = 0.05

STORE = (17.0, 2.75)
"""In the store, between rows: the first scans there fit several rooms."""


@dataclass(frozen=True)
class Box:
    """A rectangle along the axes."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float

    def covers(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the points, x and y of equal shape, m, lie inside."""
        inside: NDArray[np.bool_] = (x > self.x_min) & (x < self.x_max) & (y > self.y_min) & (y < self.y_max)
        return inside

    def moved(self, x: float, y: float) -> Box:
        """The same elsewhere, by so much."""
        return Box(self.x_min + x, self.y_min + y, self.x_max + x, self.y_max + y)

    def grown(self, by: float) -> Box:
        """The same with every side moved outwards."""
        return Box(self.x_min - by, self.y_min - by, self.x_max + by, self.y_max + by)


@dataclass(frozen=True)
class Disc:
    """A pillar, a round table, a plant."""

    x: float
    y: float
    radius: float

    def covers(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the points, x and y of equal shape, m, lie inside."""
        inside: NDArray[np.bool_] = np.hypot(x - self.x, y - self.y) < self.radius
        return inside


@dataclass(frozen=True)
class FloorPlan:
    """Rooms from wall centre to wall centre, openings in their walls, and furniture."""

    rooms: dict[str, Box]
    doors: tuple[Box, ...]
    furniture: tuple[Box | Disc, ...]

    def render(self, resolution: float = RESOLUTION) -> GridMap:
        """The plan as cells: FREE rooms, OCCUPIED walls and furniture, UNKNOWN outside."""
        margin = 0.5
        width = max(room.x_max for room in self.rooms.values()) + 2 * margin
        height = max(room.y_max for room in self.rooms.values()) + 2 * margin
        x, y = np.meshgrid(
            (np.arange(ceil(width / resolution)) + 0.5) * resolution - margin,
            (np.arange(ceil(height / resolution)) + 0.5) * resolution - margin,
        )
        cells = np.full(x.shape, UNKNOWN, dtype=np.uint8)
        for room in self.rooms.values():
            cells[room.grown(WALL / 2).covers(x, y)] = OCCUPIED
        for room in self.rooms.values():
            cells[room.grown(-WALL / 2).covers(x, y)] = FREE
        for door in self.doors:
            cells[door.covers(x, y)] = FREE
        for piece in self.furniture:
            cells[piece.covers(x, y)] = OCCUPIED
        return GridMap(cells, resolution, np.array([-margin, -margin, 0.0]))


CUPBOARD = Box(8.9, 9.6, 9.45, 11.95)
"""A tall one, in the bureau."""


def office() -> FloorPlan:
    """Eight rooms, a hallway and the square room, about 270 m^2. No two rooms are alike."""
    return FloorPlan(rooms=_rooms(), doors=_doors(), furniture=_furniture())


def _rooms() -> dict[str, Box]:
    return {
        "meeting": Box(0.0, 0.0, 5.0, 5.5),
        "study": Box(5.0, 0.0, 8.5, 5.5),
        "laboratory": Box(8.5, 0.0, 15.0, 5.5),
        "store": Box(15.0, 0.0, 19.0, 5.5),
        "hallway": Box(0.0, 5.5, 19.0, 7.5),
        "kitchen": Box(0.0, 7.5, 4.0, 12.0),
        "bureau": Box(4.0, 7.5, 9.5, 12.0),
        "library": Box(9.5, 7.5, 14.0, 12.0),
        "workshop": Box(14.0, 7.5, 19.0, 12.0),
        "square": Box(19.0, 3.0, 26.0, 10.0),
    }


def _doors() -> tuple[Box, ...]:
    south = [_opening(x, 5.5) for x in (3.6, 6.2, 10.2, 17.8)]
    north = [_opening(x, 7.5) for x in (2.9, 5.2, 12.8, 15.1)]
    between = [Box(8.4, 1.4, 8.6, 2.4), Box(13.9, 10.4, 14.1, 11.4)]
    return (*south, *north, *between, Box(18.9, 5.8, 19.1, 7.0))


def _opening(x: float, y: float) -> Box:
    """A door of 1 m in a wall that runs along x."""
    return Box(x - 0.5, y - WALL, x + 0.5, y + WALL)


def _furniture() -> tuple[Box | Disc, ...]:
    return (
        # meeting: one long table, a sideboard
        Box(1.5, 1.4, 2.9, 3.6), Box(0.05, 4.6, 1.6, 5.45),
        # study: a desk at the window, shelves
        Box(5.6, 0.05, 7.2, 0.8), Box(7.9, 3.4, 8.45, 5.45),
        # laboratory: two benches, a pillar, a machine in the corner
        Box(10.0, 1.2, 12.4, 2.0), Box(12.6, 3.4, 13.4, 4.8), Disc(11.2, 4.0, 0.25),
        Box(14.1, 0.05, 14.95, 1.5),
        # store: shelves along three walls
        Box(15.05, 0.05, 15.6, 4.0), Box(16.4, 0.05, 18.95, 0.55), Box(17.0, 2.0, 17.6, 3.8),
        # hallway: a cabinet, a copier, a plant
        Box(8.0, 7.05, 9.2, 7.45), Box(0.05, 5.9, 0.6, 6.7), Disc(14.0, 5.8, 0.2),
        # kitchen: counter in an L, a round table
        Box(0.05, 11.3, 3.95, 11.95), Box(0.05, 9.0, 0.65, 11.3), Disc(2.3, 9.6, 0.5),
        # bureau: two desks, a cupboard
        Box(6.4, 8.6, 7.8, 9.4), Box(4.4, 10.9, 6.2, 11.7), CUPBOARD,
        # library: free-standing shelves
        Box(10.3, 8.4, 10.7, 11.0), Box(11.7, 9.2, 12.1, 11.95),
        # workshop: a bench, a pillar, crates
        Box(16.2, 11.3, 18.95, 11.95), Disc(16.6, 9.4, 0.3), Box(18.0, 7.55, 18.95, 8.3),
        # square room: nearly the same from four sides; a cupboard and a pillar break the symmetry
        Box(25.2, 3.05, 25.95, 4.4), Disc(21.2, 8.6, 0.2),
    )  # fmt: skip


BOX_SIDES = (0.4, 1.2)
"""m, of a side, least and greatest."""
BOX_AISLE = 0.8
"""m that a box leaves free around it, so that every place can still be reached."""


def put_boxes(grid: GridMap, count: int, random: np.random.Generator) -> GridMap:
    """The map with `count` more boxes. Raises MapError if they do not fit."""
    cells = grid.cells.copy()
    for number in range(count):
        half = random.uniform(*BOX_SIDES, size=2) / 2
        clear = distance_transform_edt(cells == FREE) * grid.resolution
        places = np.argwhere(clear > float(np.hypot(*half)) + BOX_AISLE)
        if not len(places):
            raise MapError(f"{number} boxes fit into the map's free space, not {count}: ask for fewer")
        row, column = places[random.integers(len(places))]
        rows, columns = np.maximum(1, np.round(half / grid.resolution)).astype(np.int64)
        cells[row - rows : row + rows + 1, column - columns : column + columns + 1] = OCCUPIED
    return GridMap(cells, grid.resolution, grid.origin)
