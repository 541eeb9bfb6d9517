"""Walls of a DXF drawing."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.gridmap import MapError
from eigenscan.geometry.plans.expansion import TooMuchError, placed
from eigenscan.geometry.plans.raster import Walls
from eigenscan.geometry.pose import Array

OUTLINES = frozenset({"LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE"})
"""Types that may be walls. Text, dimensions and hatches are not."""
DAMAGE = (ArithmeticError, LookupError, TypeError, AttributeError, RecursionError, MemoryError, StopIteration)
"""Errors of the library for invalid values."""
MOST_CURVED = 300_000
"""Points of all curves of a drawing: more than any floor has."""
_POINT = np.dtype((np.float64, 2))
SMOOTH = 0.01
"""m that a straight piece may lie off the curve that it stands for."""


def read_dxf(path: Path, metres_per_unit: float | None, layers: Collection[str]) -> Walls:
    """Lines of the model space, blocks included, in m. Raises MapError."""
    try:
        from ezdxf.filemanagement import readfile
        from ezdxf.lldxf.const import DXFError
    except ImportError as error:
        raise MapError(f"{path}: reading DXF needs ezdxf: pip install 'eigenscan[plans]'") from error
    try:
        drawing = readfile(path)
    except (DXFError, OSError, ValueError, *DAMAGE) as error:
        raise MapError(f"{path}: is no DXF that can be read: {error}") from error
    try:
        return _read(path, drawing, metres_per_unit, layers)
    except TooMuchError as error:
        raise MapError(f"{path}: {error}: explode it, or save the walls alone") from error
    except MapError:
        raise
    except (DXFError, ValueError, *DAMAGE) as error:
        raise MapError(f"{path}: its lines cannot be read: {error}") from error


def _read(path: Path, drawing: Any, metres_per_unit: float | None, layers: Collection[str]) -> Walls:
    from ezdxf.enums import InsertUnits
    from ezdxf.path import make_path
    from ezdxf.units import conversion_factor

    _check_size(drawing)
    scale = metres_per_unit
    if scale is None:
        if not drawing.units:
            raise MapError(f"{path}: has no unit: give --metres-per-unit, such as 0.001 for millimetres")
        scale = float(conversion_factor(InsertUnits(drawing.units), InsertUnits.Meters))
    walls = list(_walls(drawing.modelspace()))
    if missing := sorted(set(layers) - {layer for layer, _ in walls}):
        there = ", ".join(sorted({layer for layer, _ in walls}))
        raise MapError(f"{path}: no wall on the layer {missing[0]}: choose one of {there}")
    lines, curved = [], MOST_CURVED
    for layer, entity in walls:
        if not layers or layer in layers:
            outline = make_path(entity)
            straight = len(outline) + 1
            points = islice(outline.flattening(SMOOTH / scale), straight + curved + 1)
            line: Array = np.fromiter(((point.x, point.y) for point in points), dtype=_POINT)
            curved -= max(0, len(line) - straight)
            if curved < 0:
                raise TooMuchError(f"its curves become more than {MOST_CURVED} points")
            lines.append(line * scale)
    return Walls(lines)


def _check_size(drawing: Any) -> None:
    """Raises TooMuchError if its blocks multiply each other."""
    known = {block.name.lower() for block in drawing.blocks}

    def parts(name: str) -> Any:
        return drawing.blocks.get(name) if name else drawing.modelspace()

    def refers(name: str) -> Iterator[tuple[str, int]]:
        for entity in parts(name):
            if entity.dxftype() == "INSERT" and entity.dxf.name.lower() in known:
                yield entity.dxf.name.lower(), max(1, entity.mcount)

    placed("", refers, lambda name: len(parts(name)))


def _walls(space: Iterable[Any]) -> Iterator[tuple[str, Any]]:
    """Layers and possible walls; in a block, layer 0 is the layer of the block."""
    from ezdxf.disassemble import recursive_decompose

    for item in space:
        if item.dxftype() in OUTLINES | {"INSERT"}:
            for entity in recursive_decompose([item]):
                if entity.dxftype() in OUTLINES:
                    layer = entity.dxf.layer
                    yield item.dxf.layer if layer == "0" else layer, entity
