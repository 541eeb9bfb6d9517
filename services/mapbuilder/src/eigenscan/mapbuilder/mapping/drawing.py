"""A picture of a map that was made from a log, with the way through it."""

from __future__ import annotations

import colorsys
from io import BytesIO
from itertools import pairwise

import numpy as np
from eigenscan.geometry.gridmap import OCCUPIED, GridMap
from eigenscan.mapbuilder.backdrop import Backdrop
from eigenscan.mapbuilder.mapping.survey import Mapped
from PIL import ImageDraw

_DOT = 5
_GONE = (240, 150, 40)


def draw_way(mapped: Mapped, given: GridMap | None = None) -> bytes:
    """PNG of the map and the robot's way, from blue at its start to red at its end.

    Walls of a `given` map that are no longer there are orange.
    """
    view = Backdrop(mapped.grid)
    image = view.image()
    pen = ImageDraw.Draw(image)
    note = ""
    if given is not None:
        note = "; orange: walls of the given map that are gone"
        rows, columns = np.nonzero(mapped.grid.cells != OCCUPIED)
        middles = mapped.grid.to_map(np.column_stack([columns, rows]) + 0.5)
        gone = middles[given.at(middles) == OCCUPIED]
        half = max(view.scale / 2 - 0.5, 0.0)
        for x, y in view.pixels(gone):
            pen.rectangle((x - half, y - half, x + half, y + half), fill=_GONE)
    way = view.pixels(mapped.poses[:, :2])
    for k, (here, there) in enumerate(pairwise(way)):
        pen.line([here, there], fill=_colour(k / len(way)), width=2)
    for (x, y), share in ((way[0], 0.0), (way[-1], 1.0)):
        pen.ellipse((x - _DOT, y - _DOT, x + _DOT, y + _DOT), fill=_colour(share), outline=(0, 0, 0))
    view.legend(
        pen,
        f"{mapped.grid.free_area:.0f} m2 free; the robot's way, {mapped.way:.0f} m, from blue to red;"
        f"\nkeyframes: {mapped.keyframes}, loop closures: {mapped.closures}{note}",
    )
    file = BytesIO()
    image.convert("RGB").save(file, format="PNG", optimize=True)
    return file.getvalue()


def _colour(share: float) -> tuple[int, int, int]:
    red, green, blue = colorsys.hsv_to_rgb(2 / 3 * (1 - share), 0.9, 0.85)
    return round(255 * red), round(255 * green), round(255 * blue)
