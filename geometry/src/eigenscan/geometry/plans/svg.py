"""Reads walls of an SVG drawing: strokes, and areas with a dark fill."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import ParseError

import numpy as np
from eigenscan.geometry.gridmap import MapError
from eigenscan.geometry.plans.expansion import TooMuchError, placed
from eigenscan.geometry.plans.raster import Walls
from eigenscan.geometry.pose import Array

LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"
HREF = "{http://www.w3.org/1999/xlink}href"
SMOOTH = 0.05
"""m between the points that a curve becomes."""
MOST_POINTS = 1000
"""A curve becomes at most this many lines."""
CHORDS = 4
"""Number of chords that approximate a curve's length."""
MOST_CURVED = 50_000
"""Points of all curves of a drawing: more than any floor has, and a second's work."""
DARK = 128
"""A fill with a mean of red, green and blue (0..255) below this is a wall; paper is not."""


def read_svg(path: Path, metres_per_unit: float | None, layers: Collection[str]) -> Walls:
    """Outlines in m, y up, the drawing's lower left corner at 0, 0; `layers`: ids or labels of groups.

    Raises MapError.
    """
    try:
        from svgelements import SVG
    except ImportError as error:
        raise MapError(f"{path}: reading SVG needs svgelements: pip install 'eigenscan[plans]'") from error
    if metres_per_unit is None:
        raise MapError(f"{path}: an SVG has no scale: give --metres-per-unit, 0.01 where 1 m is 100 units")
    try:
        _check_size(path)
        drawing = SVG.parse(str(path))
    except TooMuchError as error:
        raise MapError(f"{path}: {error}: export the walls alone") from error
    except (ParseError, ValueError, OSError, *DAMAGE) as error:
        raise MapError(f"{path}: is no SVG that can be read: {error}") from error
    try:
        return _walls(path, drawing, metres_per_unit, layers)
    except TooMuchError as error:
        raise MapError(f"{path}: {error}: export the walls alone") from error
    except DAMAGE as error:
        raise MapError(f"{path}: its shapes cannot be read: {error}") from error


DAMAGE = (ArithmeticError, LookupError, TypeError, AttributeError, RecursionError, MemoryError)
"""Errors of the library for invalid values."""


def _walls(path: Path, drawing: Any, metres_per_unit: float, layers: Collection[str]) -> Walls:
    from svgelements import Path as Outline
    from svgelements import Shape

    groups = list(_groups(drawing, layers))
    if missing := sorted(set(layers).difference(*map(_names, groups))):
        raise MapError(f"{path}: no group with the id or label {', '.join(missing)}")
    lines, filled = list[Array](), list[Array]()
    curved = 0
    for element in (each for group in groups or [drawing] for each in group.select()):
        if isinstance(element, Shape):
            for part in Outline(element).as_subpaths():
                points = _points(Outline(part), metres_per_unit, MOST_CURVED - curved)
                curved += max(0, len(points) - len(part))
                if _is_dark(element.fill):
                    filled.append(points)
                if element.stroke.value is not None:
                    lines.append(points)
    return _upright(Walls(lines, filled))


def _check_size(path: Path) -> None:
    """Raises TooMuchError if its <use> elements multiply each other."""
    root = ElementTree.parse(path).getroot()
    elements = {str(number): element for number, element in enumerate(root.iter())}
    names = {element: name for name, element in elements.items()}
    by_id = {f"#{element.get('id')}": name for name, element in elements.items() if element.get("id")}

    def refers(name: str) -> Iterator[tuple[str, int]]:
        element = elements[name]
        yield from ((names[child], 1) for child in element)
        target = by_id.get(element.get("href") or element.get(HREF) or "")
        if target is not None and element.tag.endswith("use"):
            yield target, 1

    placed(names[root], refers, lambda _: 1)


def _groups(drawing: Any, layers: Collection[str]) -> Iterator[Any]:
    """The groups that are named."""
    for element in drawing.elements(lambda each: hasattr(each, "select")):
        if _names(element) & set(layers):
            yield element


def _names(group: Any) -> set[Any]:
    return {group.id, group.values.get(LABEL)}


def _is_dark(colour: Any) -> bool:
    return (
        colour.value is not None
        and colour.opacity > 0
        and (colour.red + colour.green + colour.blue) / 3 < DARK
    )


def _points(outline: Any, scale: float, room: int) -> Array:
    """Points (n, 2), m: corners of straight pieces, a row of points of curves, `room` of these at most.

    Raises TooMuchError.
    """
    points = [np.empty((0, 2))]
    for segment in outline:
        straight = type(segment).__name__ in ("Move", "Line", "Close")
        count = 1 if straight else min(MOST_POINTS, max(8, int(_length(segment) * scale / SMOOTH)))
        room -= count if not straight else 0
        if room < 0:
            raise TooMuchError(f"its curves become more than {MOST_CURVED} points")
        if segment.end is not None:
            points.append(_at(segment, np.arange(1, count + 1) / count))
    return np.concatenate(points) * scale


def _at(segment: Any, shares: Array) -> Array:
    """Points (n, 2) of a piece, at shares (n,) of it."""
    if len(shares) == 1:
        return np.array([[segment.end.x, segment.end.y]])
    found: Array = np.asarray(segment.npoint(shares), dtype=np.float64)
    return found


def _length(curve: Any) -> float:
    """Approximate length of a curve, in its units; an exact one may take seconds."""
    length = float(np.hypot(*np.diff(_at(curve, np.linspace(0.0, 1.0, CHORDS + 1)), axis=0).T).sum())
    return length if math.isfinite(length) else 0.0


def _upright(walls: Walls) -> Walls:
    """SVG's y runs down."""
    every = [line for line in (*walls.lines, *walls.filled) if len(line)]
    if not every:
        return walls
    corner = np.array([np.concatenate(every)[:, 0].min(), np.concatenate(every)[:, 1].max()])
    turn = np.array([1.0, -1.0])
    return Walls(
        [(line - corner) * turn for line in walls.lines], [(line - corner) * turn for line in walls.filled]
    )
