"""Floor plans as occupancy grids: drawings of walls, DXF or SVG, and plain images."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from eigenscan.geometry.gridmap import GridMap, MapError, read_image, read_map

IMAGES = frozenset({".png", ".pgm", ".bmp", ".jpg", ".jpeg", ".tif", ".tiff"})
DRAWINGS = frozenset({".dxf", ".svg"})


@dataclass(frozen=True)
class PlanOptions:
    """How a drawing is to be read. `layers`: those that hold walls; none: all."""

    metres_per_unit: float | None = None
    layers: Collection[str] = ()
    resolution: float = 0.05


def read_plan(path: Path, options: PlanOptions) -> GridMap:
    """Reads the map at `path`: a map_server yaml, an image (a unit is a pixel), or a DXF or SVG drawing.

    Raises MapError that names the file, the fault and the fix.
    """
    kind, scale = path.suffix.lower(), options.metres_per_unit
    if kind not in IMAGES | DRAWINGS:
        if scale is not None:
            raise MapError(f"{path}: has its own resolution: leave --metres-per-unit out")
        return read_map(path)
    if not path.is_file():
        raise MapError(f"{path}: is not there: check the path")
    if kind in IMAGES:
        if scale is None:
            raise MapError(f"{path}: an image has no scale: give --metres-per-unit, m a pixel")
        return read_image(path, scale)
    if scale is not None and not 0.0 < scale < math.inf:
        raise MapError(f"{path}: --metres-per-unit {scale:g}: give metres above 0, such as 0.01")
    from eigenscan.geometry.plans.raster import rasterize

    if kind == ".dxf":
        from eigenscan.geometry.plans.dxf import read_dxf as read
    else:
        from eigenscan.geometry.plans.svg import read_svg as read
    return rasterize(path, read(path, scale, options.layers), options.resolution)
