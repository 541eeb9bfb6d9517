"""Draws a change: new walls in red, removed ones in blue, each in a frame."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from eigenscan.geometry.gridmap import GridMap
from eigenscan.mapbuilder.backdrop import Backdrop
from eigenscan.mapbuilder.keeping.change import Change, Place
from PIL import ImageDraw, ImageFont

NEW, GONE = (205, 20, 20), (25, 70, 220)
AROUND = 12
"""Pixels between a thing and its frame."""


def draw_change(grid: GridMap, change: Change, note: str) -> bytes:
    """PNG of the map `grid` as it is in use, with the change on it and a line of text."""
    view = Backdrop(grid)
    image = view.image()
    pen = ImageDraw.Draw(image)
    for cells, colour in ((change.gone, GONE), (change.new, NEW)):
        rows, columns = np.nonzero(cells)
        low = view.pixels(grid.to_map(np.column_stack([columns, rows])))
        high = view.pixels(grid.to_map(np.column_stack([columns + 1, rows + 1])))
        for (x0, y1), (x1, y0) in zip(low, high, strict=True):
            pen.rectangle((x0, y0, max(x1 - 1, x0), max(y1 - 1, y0)), fill=colour)
    for place in change.places():
        _frame(pen, view, place, NEW if place.is_new else GONE)
    view.legend(pen, note)
    file = BytesIO()
    image.convert("RGB").save(file, format="PNG", optimize=True)
    return file.getvalue()


def _frame(pen: ImageDraw.ImageDraw, view: Backdrop, place: Place, colour: tuple[int, int, int]) -> None:
    ((x, y),) = view.pixels(np.array([place.centre]))
    wide, high = (side * view.scale / view.grid.resolution / 2 + AROUND for side in place.sides)
    pen.rounded_rectangle((x - wide, y - high, x + wide, y + high), AROUND, outline=colour, width=3)
    pen.text(
        (x, y + high + 4),
        "new" if place.is_new else "gone",
        fill=colour,
        font=ImageFont.load_default(22),
        anchor="mt",
        stroke_width=4,
        stroke_fill=(255, 255, 255),
    )
