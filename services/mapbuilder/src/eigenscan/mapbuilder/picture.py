"""A picture of the regions, for people: colours on the map, names, areas, positions, a scale."""

from __future__ import annotations

import colorsys
from io import BytesIO

import numpy as np
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.model import RegionModel
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

_SIDE = 1600
"""Pixels of the longer side, at least a third and at most four a cell."""
_MARGIN, _LEGEND = 24, 56
_GOLDEN = 0.618034


def draw_regions(site: SiteModel) -> bytes:
    """PNG of the site: each region's outline with its overlap, its positions, name and area."""
    view = _View(site.grid)
    image = view.backdrop()
    shade = Image.new("RGBA", image.size, (0, 0, 0, 0))
    pen = ImageDraw.Draw(shade)
    for number, model in enumerate(site.regions):
        colour = _colour(number)
        if len(model.outline) > 2:
            loop = view.pixels(model.outline)
            pen.polygon(loop, fill=(*colour, 60))
            pen.line([*loop, loop[0]], fill=(*colour, 255), width=2)
        for x, y in view.pixels(model.positions):
            pen.rectangle((x - 0.5, y - 0.5, x + 0.5, y + 0.5), fill=(*colour, 200))
    image = Image.alpha_composite(image, shade)
    pen = ImageDraw.Draw(image)
    for model in site.regions:
        _name(pen, view, model)
    _legend(pen, view, site)
    file = BytesIO()
    image.convert("RGB").save(file, format="PNG", optimize=True)
    return file.getvalue()


class _View:
    """From the map frame to pixels, x right and y up in the map's own grid."""

    def __init__(self, grid: GridMap) -> None:
        self.grid = grid
        known = grid.cells != 255
        rows, columns = np.nonzero(known if known.any() else ~known)
        self.low = np.array([columns.min(), rows.min()])
        self.high = np.array([columns.max() + 1, rows.max() + 1])
        cells = int((self.high - self.low).max())
        self.scale = float(np.clip(_SIDE / cells, 1 / 3, 4.0))
        self.size = np.ceil((self.high - self.low) * self.scale).astype(int)

    def backdrop(self) -> Image.Image:
        """The map in greys, with room for a margin and the legend."""
        part = self.grid.cells[self.low[1] : self.high[1], self.low[0] : self.high[0]][::-1]
        grey = np.full(part.shape, 214, dtype=np.uint8)
        grey[part == FREE], grey[part == OCCUPIED] = 255, 0
        picture = Image.fromarray(grey).resize(tuple(self.size.tolist()), Image.Resampling.BOX)
        width, height = (self.size + 2 * _MARGIN).tolist()
        image = Image.new("RGBA", (max(width, 800), height + _LEGEND), (214, 214, 214, 255))
        image.paste(picture.convert("RGBA"), (_MARGIN, _MARGIN))
        return image

    def pixels(self, points: NDArray[np.float64]) -> list[tuple[float, float]]:
        """Pixels of map-frame points (K, 2)."""
        cells = (self.grid.to_grid(points) - self.low) * self.scale
        return [(_MARGIN + float(x), _MARGIN + float(self.size[1] - y)) for x, y in cells]


def _colour(number: int) -> tuple[int, int, int]:
    """Hues that differ from those of the neighbours in the order."""
    red, green, blue = colorsys.hsv_to_rgb((number * _GOLDEN) % 1.0, 0.85, 0.75)
    return round(255 * red), round(255 * green), round(255 * blue)


def _name(pen: ImageDraw.ImageDraw, view: _View, model: RegionModel) -> None:
    middle = model.positions.mean(axis=0)
    nearest = np.argmin(np.linalg.norm(model.positions - middle, axis=1))
    (place,) = view.pixels(model.positions[nearest : nearest + 1])
    pen.text(
        place,
        f"{model.region}\n{len(model.index) * model.spacing**2:.0f} m2",
        fill=(0, 0, 0),
        font=ImageFont.load_default(15),
        anchor="mm",
        align="center",
        stroke_width=2,
        stroke_fill=(255, 255, 255),
    )


def _legend(pen: ImageDraw.ImageDraw, view: _View, site: SiteModel) -> None:
    y = 2 * _MARGIN + int(view.size[1])
    per_metre = view.scale / site.grid.resolution
    metres = next((m for m in (50, 20, 10, 5, 2, 1) if m * per_metre < 300), 1)
    font = ImageFont.load_default(15)
    pen.line([(_MARGIN, y), (_MARGIN + metres * per_metre, y)], fill=(0, 0, 0), width=3)
    pen.text((_MARGIN, y + 6), f"{metres} m", fill=(0, 0, 0), font=font)
    spacing = site.regions[0].spacing if site.regions else 0.0
    text = (
        f"{len(site.regions)} regions, {site.grid.free_area:.0f} m2 free; each colour is one region with its "
        f"overlap,\neach dot a position with its panorama, {spacing:g} m apart"
    )
    pen.text((_MARGIN + max(metres * per_metre, 60) + 24, y - 8), text, fill=(0, 0, 0), font=font)
