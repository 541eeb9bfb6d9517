"""Derives a changed map from the visits: lasting changes only, and no wall that is mapped slightly off."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_propagation, find_objects, label

TOLERANCE = 0.15
"""Distance from a mapped wall, m, within which a hit belongs to that wall."""
SMALLEST = 0.2
"""m, the longer side of the smallest thing that is a change."""
NEAR = 0.5
"""m between pieces of one thing, for people."""
DEEPEST = 1.0
"""Depth of unknown space behind a removed wall that becomes free, m: the inside of a cabinet, not the next
building."""
POCKET_M2 = 2.0
"""Free ground that a new thing cuts off is its inside up to this area, and a room beyond."""
_EIGHT = np.ones((3, 3), dtype=bool)

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Place:
    """One thing that changed: its centre in the map frame, and its sides along the grid's axes, m."""

    is_new: bool
    centre: tuple[float, float]
    sides: tuple[float, float]


@dataclass(frozen=True)
class Change:
    """A map as it should be, and the cells (H, W) that differ: walls that are new, walls that are gone."""

    grid: GridMap
    new: Mask
    gone: Mask

    def __bool__(self) -> bool:
        return bool(self.new.any() or self.gone.any())

    def places(self) -> list[Place]:
        """The things that are new, then those that are gone; pieces less than NEAR apart are one."""
        found = []
        reach = round(NEAR / 2 / self.grid.resolution)
        for is_new, cells in ((True, self.new), (False, self.gone)):
            parts, _ = label(_grown(cells, reach), structure=_EIGHT)
            for rows, columns in find_objects(np.where(cells, parts, 0)):
                low, high = np.array([columns.start, rows.start]), np.array([columns.stop, rows.stop])
                x, y = self.grid.to_map((low + high) / 2).tolist()
                width, height = ((high - low) * self.grid.resolution).tolist()
                found.append(Place(is_new, (x, y), (width, height)))
        return found


def find_change(grid: GridMap, run: NDArray[np.int8], visits: int) -> Change:
    """Cells that `visits` visits in a row see unlike the map, and neighbours with half as many.

    `run` (H, W) as in Evidence.
    """
    cells, half = grid.cells, max(1, visits // 2)
    reach = max(1, round(TOLERANCE / grid.resolution))
    wall, free = cells == OCCUPIED, cells == FREE
    # from its face inwards: beams that graze a remaining face cross the cells behind it
    face = wall & _grown(free, 1)
    gone = _things(face & (run <= -visits), wall & (run <= -half), grid.resolution)
    # its rim at a remaining wall, where a beam's end is too near to prove anything
    gone = _grown(gone, reach, wall & (run <= 0))
    near = _grown(wall & ~gone, reach)
    new = _things(free & ~near & (run >= visits), free & ~near & (run >= half), grid.resolution)
    new = _grown(new, reach, free & (run >= half))
    changed = cells.copy()
    changed[
        gone | _grown(gone, round(DEEPEST / grid.resolution), gone | ((cells == UNKNOWN) & (run <= -half)))
    ] = FREE
    changed[new] = OCCUPIED
    changed[_insides(changed, new, reach, POCKET_M2 / grid.resolution**2)] = UNKNOWN
    return Change(replace(grid, cells=changed), new, gone)


def _grown(mask: Mask, cells: int, within: Mask | None = None) -> Mask:
    if not mask.any() or not cells:  # scipy takes no iteration for as many as it needs
        return mask
    return np.asarray(binary_dilation(mask, _EIGHT, iterations=cells, mask=within)) | mask


def _things(seeds: Mask, cells: Mask, resolution: float) -> Mask:
    """Connected `cells` around `seeds` that are as long as a thing that counts."""
    found = np.asarray(binary_propagation(seeds, _EIGHT, mask=cells))
    parts, _ = label(found, structure=_EIGHT)
    longest = [max(box[0].stop - box[0].start, box[1].stop - box[1].start) for box in find_objects(parts)]
    large = np.array([False, *(length * resolution >= SMALLEST - 1e-9 for length in longest)])
    kept: Mask = large[parts]
    return kept


def _insides(cells: NDArray[np.uint8], new: Mask, reach: int, most: float) -> Mask:
    """Free ground of at most `most` cells that new things enclose, with walls `reach` cells away."""
    if not new.any():
        return new
    shut = _grown(new, reach)
    closed = (cells == OCCUPIED) | (shut & _grown(cells == OCCUPIED, 1))
    parts, count = label((cells == FREE) & ~closed)
    area = np.bincount(parts.ravel(), minlength=count + 1)
    touched = np.unique(parts[_grown(shut, 1)])
    inside = np.zeros(count + 1, dtype=bool)
    inside[touched] = area[touched] <= most
    inside[0] = False
    return np.asarray(inside[parts])
