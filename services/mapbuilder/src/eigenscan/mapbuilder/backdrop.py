"""A map in greys to draw on, with a scale and a line of text below."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.distance_tiles import box_of
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

_SIDE = 1600
"""Pixels of the longer side, at least a third and at most four a cell."""
_MARGIN, _LEGEND = 24, 56


class Backdrop:
    """A map to draw on: from its frame to pixels, x right and y up in the map's own grid."""

    def __init__(self, grid: GridMap) -> None:
        self.grid = grid
        known = grid.cells != UNKNOWN
        rows, columns = box_of(known if known.any() else ~known)
        self.low = np.array([columns.start, rows.start])
        self.high = np.array([columns.stop, rows.stop])
        cells = int((self.high - self.low).max())
        self.scale = float(np.clip(_SIDE / cells, 1 / 3, 4.0))
        self.size = np.ceil((self.high - self.low) * self.scale).astype(int)

    def image(self) -> Image.Image:
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

    def legend(self, pen: ImageDraw.ImageDraw, text: str) -> None:
        """Draws the scale and a text."""
        y = 2 * _MARGIN + int(self.size[1])
        per_metre = self.scale / self.grid.resolution
        metres = next((m for m in (50, 20, 10, 5, 2, 1) if m * per_metre < 300), 1)
        font = ImageFont.load_default(15)
        pen.line([(_MARGIN, y), (_MARGIN + metres * per_metre, y)], fill=(0, 0, 0), width=3)
        pen.text((_MARGIN, y + 6), f"{metres} m", fill=(0, 0, 0), font=font)
        pen.text((_MARGIN + max(metres * per_metre, 60) + 24, y - 8), text, fill=(0, 0, 0), font=font)
