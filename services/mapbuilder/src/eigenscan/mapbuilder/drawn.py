"""Regions as the user drew them, on the raster that regions are divided on; and back, to be edited."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from eigenscan.geometry.gridmap import FREE, GridMap
from eigenscan.geometry.pose import Array
from eigenscan.mapbuilder.geojson import GivenRegion, Polygon, RegionsError
from eigenscan.mapbuilder.regions import Division, Regions, reached
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, find_objects
from skimage.draw import polygon2mask
from skimage.measure import approximate_polygon, find_contours, label


def divide_as_drawn(grid: GridMap, drawn: Sequence[GivenRegion], division: Division) -> Regions:
    """Regions of the free space inside the polygons, in their order; other space belongs to none.

    Of overlapping polygons the smallest counts. All reach into their neighbours by the margin, like found
    regions. Raises RegionsError that names a region without free space.
    """
    block = max(1, round(division.raster / grid.resolution))
    free = _any_in_block(grid.cells == FREE, block)
    # cells rather than masks, each as large as the map
    cells_of = [np.flatnonzero(_mask(region, grid, block, free.shape) & free) for region in drawn]
    core = np.zeros(free.shape, dtype=np.int32)
    for number in sorted(range(len(cells_of)), key=lambda n: -len(cells_of[n])):
        core.flat[cells_of[number]] = number + 1
    left = np.bincount(core.ravel(), minlength=len(cells_of) + 1)[1:]
    for region, cells in zip(drawn, left, strict=True):
        if not cells:
            raise RegionsError(
                f"region {region.name!r} holds no free space of its own: "
                "check that its coordinates are in the map frame, in m"
            )
    return Regions(grid, block, core, reached(core, free, division.margin / (block * grid.resolution)))


def outlines(regions: Regions, names: dict[int, str]) -> tuple[GivenRegion, ...]:
    """Regions by number from 0, without their overlap, as polygons to be edited; holes are filled."""
    half = 0.5
    found = []
    boxes = find_objects(regions.core)
    for number, name in names.items():
        box = boxes[number]
        corner = np.array([axis.start for axis in box])
        pieces = label(regions.core[box] == number + 1, connectivity=2)
        polygons = []
        for piece in range(1, int(pieces.max()) + 1):
            mask = np.pad(np.asarray(binary_fill_holes(pieces == piece)), 1)
            ring = approximate_polygon(max(find_contours(mask.astype(float), half), key=len), half)
            if len(ring) >= 4:
                # contour coordinates are cell centres, and the padding adds one
                polygons.append(
                    Polygon((regions.grid.to_map((ring + corner - half)[:, ::-1] * regions.block),))
                )
        if polygons:
            found.append(GivenRegion(name, tuple(polygons)))
    return tuple(found)


def _mask(region: GivenRegion, grid: GridMap, block: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
    mask = np.zeros(shape, dtype=np.bool_)
    for polygon in region.polygons:
        outer, *holes = (_inside(ring, grid, block, shape) for ring in polygon.rings)
        for hole in holes:
            outer &= ~hole
        mask |= outer
    return mask


def _inside(ring: Array, grid: GridMap, block: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Raster cells whose centre is in the ring."""
    return np.asarray(polygon2mask(shape, grid.to_grid(ring)[:, ::-1] / block - 0.5), dtype=np.bool_)


def _any_in_block(cells: NDArray[np.bool_], block: int) -> NDArray[np.bool_]:
    height, width = cells.shape
    padded = np.pad(cells, ((0, -height % block), (0, -width % block)))
    tiles = padded.reshape(padded.shape[0] // block, block, padded.shape[1] // block, block)
    return np.asarray(tiles.any(axis=(1, 3)))
