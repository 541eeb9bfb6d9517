"""A picture of the regions, for people: colours on the map, names, areas, positions, a scale."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from io import BytesIO

import numpy as np
from eigenscan.geometry.gridmap import GridMap
from eigenscan.mapbuilder.backdrop import Backdrop
from eigenscan.mapbuilder.shards import Area
from PIL import Image, ImageDraw, ImageFont

_GOLDEN = 0.618034


def draw_regions(grid: GridMap, areas: Sequence[Area]) -> bytes:
    """PNG of the map: each region's outline with its overlap, its positions, name and area."""
    view = Backdrop(grid)
    image = view.image()
    shade = Image.new("RGBA", image.size, (0, 0, 0, 0))
    pen = ImageDraw.Draw(shade)
    loops = {n: view.pixels(area.outline) for n, area in enumerate(areas) if len(area.outline) > 2}
    for number, loop in loops.items():
        pen.polygon(loop, fill=(*_colour(number), 60))
    for number, loop in loops.items():  # over all colours: one that lies under others keeps its outline
        pen.line([*loop, loop[0]], fill=(*_colour(number), 255), width=2)
    for number, area in enumerate(areas):
        colour = _colour(number)
        for x, y in view.pixels(area.positions.points):
            pen.rectangle((x - 0.5, y - 0.5, x + 0.5, y + 0.5), fill=(*colour, 200))
    image = Image.alpha_composite(image, shade)
    pen = ImageDraw.Draw(image)
    _names(pen, view, areas)
    _legend(pen, view, areas)
    file = BytesIO()
    image.convert("RGB").save(file, format="PNG", optimize=True)
    return file.getvalue()


def _colour(number: int) -> tuple[int, int, int]:
    """Hues that differ from those of the neighbours in the order."""
    red, green, blue = colorsys.hsv_to_rgb((number * _GOLDEN) % 1.0, 0.85, 0.75)
    return round(255 * red), round(255 * green), round(255 * blue)


def _names(pen: ImageDraw.ImageDraw, view: Backdrop, areas: Sequence[Area]) -> None:
    """Names and areas where they fit, the largest region's first: beside none that is drawn already."""
    font = ImageFont.load_default(15)
    drawn = np.zeros((0, 4))
    for area in sorted(areas, key=lambda one: -one.size):
        points, text = area.positions.points, f"{area.name}\n{area.size:.0f} m2"
        nearest = np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1))
        (place,) = view.pixels(points[nearest : nearest + 1])
        left, top, right, bottom = box = pen.textbbox(place, text, font, "mm", align="center", stroke_width=2)
        beside = (drawn[:, 0] > right) | (drawn[:, 2] < left) | (drawn[:, 1] > bottom) | (drawn[:, 3] < top)
        if beside.all():
            drawn = np.vstack([drawn, box])
            pen.text(
                place,
                text,
                (0, 0, 0),
                font,
                "mm",
                align="center",
                stroke_width=2,
                stroke_fill=(255, 255, 255),
            )


def _legend(pen: ImageDraw.ImageDraw, view: Backdrop, areas: Sequence[Area]) -> None:
    count = "1 region" if len(areas) == 1 else f"{len(areas)} regions"
    view.legend(
        pen,
        f"{count}, {view.grid.free_area:.0f} m2 free; each outline is one region, its area "
        f"with what it shares with others;\neach dot a position with its panorama; names where they fit",
    )
