"""Finds rooms and hallways: cuts the free space at its narrow places into overlapping regions.

The distance to the nearest wall is largest in the middle of a room and has a saddle in each doorway. A
watershed from the maxima cuts at the saddles. Maxima belong to one room if the saddle between them is not
much narrower than the smaller of them. The criterion is a ratio, so it holds for closets and for halls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.distance_tiles import TILE, box_of, distance_tiles
from eigenscan.geometry.gridmap import FREE, GridMap
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, find_objects, label
from skimage.measure import find_contours
from skimage.morphology import local_maxima, reconstruction
from skimage.segmentation import watershed

_EIGHT = np.ones((3, 3), dtype=bool)
_OUTSIDE = -1e3


@dataclass(frozen=True)
class Division:
    """How free space is divided. Lengths in m, areas in m^2."""

    narrowing: float = 1.5
    """A doorway is this many times narrower than the smaller of the rooms that it joins."""
    margin: float = 1.0
    """How far a region reaches into its neighbours."""
    smallest: float = 4.0
    """A smaller piece joins the neighbour with which it shares the longest border."""
    largest: float = 150.0
    """A larger piece is halved across its longer axis until it fits."""
    clutter: float = 1.0
    """Furniture and specks smaller than this, m, do not divide a room."""
    raster: float = 0.1
    """Cell size at which space is divided."""


@dataclass(frozen=True)
class Regions:
    """Regions on a raster of `block` x `block` cells of the map.

    `core` (h, w) int32: the one region that a raster cell belongs to, from 1; 0: none. `reach` holds, for
    each region, its mask with the overlap, cropped, and the crop's first row and column.
    """

    grid: GridMap
    block: int
    core: NDArray[np.int32]
    reach: tuple[tuple[NDArray[np.bool_], int, int], ...]

    def members(self, points: NDArray[np.float64]) -> list[NDArray[np.int64]]:
        """Indices of the map-frame points (P, 2) in each region; a point may be in several or in none."""
        column, row = np.floor(self.grid.to_grid(points) / self.block).astype(np.int64).T
        order = np.argsort(row, kind="stable")
        column, row = column[order], row[order]
        found = []
        for mask, top, left in self.reach:
            band = slice(*np.searchsorted(row, (top, top + mask.shape[0])))
            r, c = row[band] - top, column[band] - left
            inside = (c >= 0) & (c < mask.shape[1])
            inside[inside] = mask[r[inside], c[inside]]
            found.append(np.sort(order[band][inside]))
        return found

    def outline(self, region: int) -> NDArray[np.float64]:
        """Map-frame outline (K, 2), m, of the region (from 0) with its overlap; its largest loop."""
        mask, top, left = self.reach[region]
        contours = find_contours(np.pad(mask, 1).astype(float), 0.5)
        rows, columns = max(contours, key=len).T
        # contour coordinates are cell centres, and the padding adds one
        cells = np.column_stack([columns + left - 0.5, rows + top - 0.5])
        return self.grid.to_map(cells * self.block)


def divide(grid: GridMap, division: Division) -> Regions:
    """Regions of the map's free space, by rows of their middles. There may be none."""
    space = _without_clutter(grid.cells == FREE, division.clutter / grid.resolution)
    block = max(1, round(division.raster / grid.resolution))
    width = _half_widths(space, block)
    cell_area = (block * grid.resolution) ** 2
    core = _cut(width, np.log(division.narrowing))
    core = _halve(core, division.largest / cell_area)
    core = _join(core, division.smallest / cell_area)
    core = _in_order(core)
    return Regions(grid, block, core, reached(core, core > 0, division.margin / (block * grid.resolution)))


def reached(
    core: NDArray[np.int32], space: NDArray[np.bool_], margin: float
) -> tuple[tuple[NDArray[np.bool_], int, int], ...]:
    """Cells of each region of `core` with the overlap, in `space`, as in Regions; `margin` in cells."""
    boxes = find_objects(core)
    return tuple(_grown(core, space, number, box, round(margin)) for number, box in enumerate(boxes, 1))


def _without_clutter(free: NDArray[np.bool_], extent: float) -> NDArray[np.bool_]:
    """`free` with those holes filled that are shorter than `extent` cells both ways."""
    parts, _ = label(~free, structure=_EIGHT)
    boxes = find_objects(parts)
    sizes = np.array([[0, 0]] + [[box[0].stop - box[0].start, box[1].stop - box[1].start] for box in boxes])
    small = sizes.max(axis=1) < extent
    small[0] = False
    filled: NDArray[np.bool_] = free | small[parts]
    return filled


def _half_widths(space: NDArray[np.bool_], block: int) -> NDArray[np.float64]:
    """Largest distance to the edge of the space, in cells, by blocks; beyond the map is no space."""
    height, width = space.shape
    padded = np.pad(space, ((block, block + -height % block), (block, block + -width % block)))
    widths = np.empty((padded.shape[0] // block, padded.shape[1] // block))
    for (rows, columns), distance in distance_tiles(padded, tile=TILE // block * block):
        tiles = distance.reshape(distance.shape[0] // block, block, distance.shape[1] // block, block)
        widths[rows.start // block : rows.stop // block, columns.start // block : columns.stop // block] = (
            tiles.max(axis=(1, 3))
        )
    return widths[1:-1, 1:-1]


def _cut(width: NDArray[np.float64], depth: float) -> NDArray[np.int32]:
    """Watershed of the free half-widths (0: not free), from maxima `depth` above their saddles, in log."""
    whole = np.zeros(width.shape, dtype=np.int32)
    box = box_of(width > 0, 1)
    width = width[box]
    space = width > 0
    level = np.full(width.shape, _OUTSIDE)
    level[space] = np.log(width[space])
    domes = reconstruction(np.where(space, level - depth, _OUTSIDE), level)
    markers, _ = label(local_maxima(domes) & space, structure=_EIGHT)
    whole[box] = watershed(-level, markers, mask=space, connectivity=2)
    return whole


def _halve(core: NDArray[np.int32], largest: float) -> NDArray[np.int32]:
    """Pieces of more than `largest` cells in halves, across the longer principal axis, until they fit."""
    core = core.copy()
    count = int(core.max(initial=0))
    waiting = [
        np.argwhere(core[box] == n) + [axis.start for axis in box]
        for n, box in enumerate(find_objects(core), 1)
    ]
    while waiting:
        cells = waiting.pop()
        if len(cells) <= largest:
            continue
        centred = cells - cells.mean(axis=0)
        axis = np.linalg.eigh(centred.T @ centred)[1][:, -1]
        along = centred @ axis
        middle = np.median(along)
        # where most cells lie at one end, none is beyond the middle
        far = along > middle if along.max() > middle else along < middle
        count += 1
        core[cells[far, 0], cells[far, 1]] = count
        waiting += [cells[~far], cells[far]]
    return core


def _join(core: NDArray[np.int32], smallest: float) -> NDArray[np.int32]:
    """Pieces of fewer than `smallest` cells joined to the neighbour with the longest shared border."""
    while True:
        area = np.bincount(core.ravel())
        into = np.arange(len(area))
        pairs, lengths = _borders(core)
        for number in np.argsort(area, kind="stable"):
            if not number or not 0 < area[number] < smallest or into[number] != number:
                continue
            mine = (pairs == number).any(axis=1)
            if mine.any():
                longest = pairs[mine][np.argmax(lengths[mine])]
                other = longest[longest != number][0]
                if into[other] == other:
                    into[number] = other
                    area[other], area[number] = area[other] + area[number], 0
        if (into == np.arange(len(into))).all():
            return core
        core = into[core].astype(np.int32)


def _borders(core: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs (K, 2) of numbers that touch, and the lengths (K,) of their borders in cells."""
    touching = []
    for a, b in ((core[:, 1:], core[:, :-1]), (core[1:], core[:-1])):
        different = (a != b) & (a > 0) & (b > 0)
        touching.append(np.sort(np.column_stack([a[different], b[different]]), axis=1))
    pairs, lengths = np.unique(np.concatenate(touching), axis=0, return_counts=True)
    return pairs.astype(np.int64), lengths


def _in_order(core: NDArray[np.int32]) -> NDArray[np.int32]:
    """The numbers of `core` replaced by 1, 2, ... by the rows of the pieces' middles."""
    rows, columns = np.nonzero(core)
    numbers, which = np.unique(core[rows, columns], return_inverse=True)
    area = np.bincount(which)
    middle = np.column_stack([np.bincount(which, rows) / area, np.bincount(which, columns) / area])
    new = np.zeros(int(core.max(initial=0)) + 1, dtype=np.int32)
    new[numbers[np.lexsort((middle[:, 1], middle[:, 0]))]] = np.arange(1, len(numbers) + 1)
    return new[core]


def _grown(
    core: NDArray[np.int32], space: NDArray[np.bool_], number: int, box: tuple[slice, ...], steps: int
) -> tuple[NDArray[np.bool_], int, int]:
    """The piece with all free space within `steps` cells of way of it, cropped, and the crop's corner."""
    top, left = max(box[0].start - steps, 0), max(box[1].start - steps, 0)
    crop = slice(top, box[0].stop + steps), slice(left, box[1].stop + steps)
    mask: NDArray[np.bool_] = np.asarray(core[crop] == number)
    if steps:
        mask = np.asarray(binary_dilation(mask, _EIGHT, iterations=steps, mask=space[crop]))
    return mask, top, left
