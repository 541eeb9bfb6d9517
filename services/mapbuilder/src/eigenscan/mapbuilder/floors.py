"""Several floors as one site: their maps on one raster, one above the other, with the unknown between."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from eigenscan.eigenspace.floors import Floor
from eigenscan.geometry.gridmap import MOST_CELLS, UNKNOWN, GridMap, MapError
from eigenscan.geometry.pose import compose, inverse
from eigenscan.mapbuilder.geojson import MOST_NAME, NOT_IN_NAMES, is_name
from eigenscan.mapbuilder.site import Layout

GAP = 10.0
"""m between floors: no ray, no wall and no track reaches from one to the other."""


def stack(maps: Sequence[tuple[str, GridMap]]) -> tuple[GridMap, tuple[Floor, ...]]:
    """One map of several floors by their names, and where each is. The first keeps its place.

    Raises MapError where floors have the same name, a name that no region can have, cells of unlike size, or
    too many of them.
    """
    (_, first), resolution = maps[0], maps[0][1].resolution
    for name, count in Counter(name for name, _ in maps).items():
        if count > 1:
            raise MapError(f"{name}: two floors have this name: rename a file")
        if not is_name(name):
            raise MapError(
                f"{name}: cannot be a floor's name: rename the file, without {NOT_IN_NAMES} or spaces, "
                f"and with {MOST_NAME} letters at most"
            )
    for name, grid in maps:
        if grid.resolution != resolution:
            raise MapError(
                f"{name}: resolution = {grid.resolution}, that of {maps[0][0]} is {resolution}: "
                "save both maps with the same"
            )
    gap = round(GAP / resolution)
    tops = np.cumsum([0, *(grid.cells.shape[0] + gap for _, grid in maps)])
    width, height = max(grid.cells.shape[1] for _, grid in maps), int(tops[-1]) - gap
    if width * height > MOST_CELLS:
        raise MapError(
            f"{', '.join(name for name, _ in maps)}: {width} x {height} cells together, {MOST_CELLS} at "
            "most: save the maps with coarser cells, or make two sites of them"
        )
    cells = np.full((height, width), UNKNOWN, dtype=np.uint8)
    for (_, grid), top in zip(maps, tops, strict=False):
        rows, columns = grid.cells.shape
        cells[top : top + rows, :columns] = grid.cells
    whole = GridMap(cells, resolution, first.origin)
    return whole, tuple(_floor(whole, *each, int(top)) for each, top in zip(maps, tops, strict=False))


def _floor(whole: GridMap, name: str, grid: GridMap, top: int) -> Floor:
    height, width = grid.cells.shape
    corners = np.array([[0, top], [width, top], [width, top + height], [0, top + height]])
    at = compose(whole.origin, [0.0, top * whole.resolution, 0.0])
    return Floor(name, compose(at, inverse(grid.origin)), whole.to_map(corners))


def name_by_floor(layout: Layout, floors: Sequence[Floor]) -> Layout:
    """The layout with each region named after its floor too, such as ground.r01."""
    middles = {n: np.mean(layout.regions.outline(n), axis=0) for n in layout.names}
    on = {n: next(floor.name for floor in floors if floor.holds(middle)) for n, middle in middles.items()}
    return replace(layout, names={n: f"{on[n]}.{name}" for n, name in layout.names.items()})
