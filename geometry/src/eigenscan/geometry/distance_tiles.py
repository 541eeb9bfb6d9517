"""Distances over a raster of any size, tile by tile: the whole at once takes some forty bytes a cell."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

TILE = 1024
_HALO = 64


def distance_tiles(
    space: NDArray[np.bool_], farthest: float = np.inf, tile: int = TILE
) -> Iterator[tuple[tuple[slice, slice], NDArray[np.float64]]]:
    """Parts of a raster (H, W), and the distance of each of their cells to the nearest cell not in `space`.

    Distances are between cell centres, in cells, and exact up to `farthest`; farther ones are only known to
    be farther. +inf if every cell is in `space`.
    """
    height, width = space.shape
    for top in range(0, height, tile):
        for left in range(0, width, tile):
            part = slice(top, min(top + tile, height)), slice(left, min(left + tile, width))
            yield part, _distances(space, part, farthest)


def box_of(mask: NDArray[np.bool_], margin: int = 0, tile: int = 1) -> tuple[slice, slice]:
    """Part of a raster (H, W) with `mask` and `margin` cells around it; it begins where a tile does."""
    found = []
    for axis in (1, 0):
        where = np.flatnonzero(mask.any(axis=axis))
        low, high = (int(where[0]), int(where[-1]) + 1) if len(where) else (0, 0)
        found.append(slice(max(low - margin, 0) // tile * tile, high + margin))
    return found[0], found[1]


def _distances(space: NDArray[np.bool_], part: tuple[slice, slice], farthest: float) -> NDArray[np.float64]:
    if not space[part].any():  # as most of a map with much unknown ground
        return np.zeros(space[part].shape)
    halo = _HALO
    while True:
        around = tuple(
            slice(max(axis.start - halo, 0), min(axis.stop + halo, size))
            for axis, size in zip(part, space.shape, strict=True)
        )
        crop = space[around]
        inner = tuple(
            slice(axis.start - outer.start, axis.stop - outer.start)
            for axis, outer in zip(part, around, strict=True)
        )
        if crop.all():
            found = np.full(space[part].shape, np.inf)
        else:
            found = np.asarray(distance_transform_edt(crop))[inner]
        # cells outside of the crop are at least a halo away
        if crop.shape == space.shape or halo >= min(farthest, float(found.max())):
            return found
        halo *= 2
