"""Turns walls drawn as lines into cells: walls occupied, enclosed space free, the outside unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, MapError
from eigenscan.geometry.pose import FARTHEST_M, Array
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.ndimage import distance_transform_edt, label

DOORWAY = 1.2
"""m: an opening no wider than this does not let the outside in."""
ROOM = 0.5
"""Enclosed space that is nowhere this far from its walls, m, is the inside of a wall, a pillar or a table."""
MOST_DRAWN_CELLS = 100_000_000
"""500 m by 500 m at 5 cm; finding the inside needs some 16 bytes a cell."""
BAND_CELLS = 2**19
"""Distances are found in bands of so many cells: one takes 40 bytes of each cell."""
MARGIN = 2.0
"""m of outside around the drawing: more than half a doorway, so that the outside goes around it."""


@dataclass(frozen=True)
class Walls:
    """Lines (n, 2) in m, y up; `filled` are closed and solid inside."""

    lines: Sequence[Array]
    filled: Sequence[Array] = ()


def rasterize(path: Path, walls: Walls, resolution: float) -> GridMap:
    """The map of `walls`, in the drawing's frame. Raises MapError if nothing is enclosed."""
    walls = Walls(*([line for line in part if len(line) > 1] for part in (walls.lines, walls.filled)))
    drawn = [*walls.lines, *walls.filled]
    if not drawn:
        raise MapError(f"{path}: no wall in it: check --layer")
    points = np.concatenate(drawn)
    if not (np.abs(points) <= FARTHEST_M).all():  # also if they are no numbers
        raise MapError(f"{path}: farther than {FARTHEST_M:g} m from its origin: check --metres-per-unit")
    low, high = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
    width, height = np.ceil((high - low) / resolution).astype(np.int64).tolist()
    if width * height > MOST_DRAWN_CELLS:
        wide, deep = high - low
        raise MapError(f"{path}: {wide:.0f} m by {deep:.0f} m: too large: check --metres-per-unit")
    wall = _draw(walls, low, resolution, (width, height))
    inside = ~(wall | _outside(wall, resolution))
    parts, count = label(inside)
    if count:
        roomy = np.zeros(count + 1, dtype=np.bool_)
        roomy[parts[~_near(wall, np.nextafter(ROOM, 0.0), resolution)]] = True
        wall |= inside & ~roomy[parts]
        inside &= roomy[parts]
    if not inside.any():
        wide, deep = high - low - 2 * MARGIN
        raise MapError(
            f"{path}: its walls, {wide:.1f} m by {deep:.1f} m, enclose nothing: check "
            f"--metres-per-unit, and close outer walls that are open by more than {DOORWAY} m"
        )
    cells = np.full(wall.shape, UNKNOWN, dtype=np.uint8)
    cells[inside], cells[wall] = FREE, OCCUPIED
    return GridMap(cells, resolution, np.array([*low, 0.0]))


def _draw(walls: Walls, low: Array, resolution: float, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Cells (H, W) on walls, row 0 lowest; lines are two cells wide, so that no ray slips through."""
    image = Image.new("1", size)
    pen = ImageDraw.Draw(image)
    for line in walls.lines:
        pen.line([*((line - low) / resolution).ravel().tolist()], fill=1, width=2)
    for outline in walls.filled:
        pen.polygon([*((outline - low) / resolution).ravel().tolist()], fill=1, outline=1)
    drawn: NDArray[np.bool_] = np.array(image, dtype=np.bool_)
    return drawn


def _outside(wall: NDArray[np.bool_], resolution: float) -> NDArray[np.bool_]:
    """Cells reached from the edge without passing a doorway."""
    parts, _ = label(~_near(wall, DOORWAY / 2, resolution))
    return _near(parts == parts[0, 0], DOORWAY / 2, resolution)


def _near(there: NDArray[np.bool_], far: float, resolution: float) -> NDArray[np.bool_]:
    """Cells that lie within `far` m of one that is `there`."""
    found = np.zeros_like(there)
    margin = ceil(far / resolution) + 1
    rows = max(BAND_CELLS // there.shape[1], margin)
    for first in range(0, len(there), rows):
        above = min(first, margin)
        band = there[first - above : first + rows + margin]
        if band.any():
            near = distance_transform_edt(~band) * resolution <= far
            found[first : first + rows] = near[above : above + rows]
    return found
