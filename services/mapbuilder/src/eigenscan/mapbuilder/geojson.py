"""Regions as GeoJSON (RFC 7946): polygons in the map frame, m, that any editor of GeoJSON opens.

The coordinates are no longitudes, which section 4 allows by prior arrangement: `frame_id` names their frame.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.pose import Array
from eigenscan.schemas.channels import is_chunk

MOST_NAME, _MOST_NAME_BYTES = 64, 200
"""Letters, and bytes: a file's name has 255 at most, with a floor's region number and its ending."""
NOT_IN_NAMES = "/ \\ * $ ? # @"
"""For messages: what `is_name` refuses, besides spaces and control characters."""


class RegionsError(ValueError):
    """Regions that cannot be used; the message names the file, the feature and the fix."""


@dataclass(frozen=True)
class Polygon:
    """Rings (K, 2) of map-frame points, m: the outer one first, then the holes."""

    rings: tuple[Array, ...]


@dataclass(frozen=True)
class GivenRegion:
    """A region that the user drew; it may be in several pieces."""

    name: str
    polygons: tuple[Polygon, ...]


def is_name(text: str) -> bool:
    """Whether a region can have this name: as one chunk of a key, and as the name of its file."""
    fits = len(text) <= MOST_NAME and text.isprintable() and len(text.encode()) <= _MOST_NAME_BYTES
    return fits and is_chunk(text) and "\\" not in text and not text.startswith(".")


def read_regions(path: Path) -> tuple[GivenRegion, ...]:
    """Regions of a FeatureCollection of Polygons and MultiPolygons; property `name` names each.

    Raises RegionsError.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RegionsError(f"{path}: cannot be read: {error.strerror}: check the path") from error
    except (ValueError, RecursionError) as error:  # also if it is nested too deeply
        raise RegionsError(f"{path}: is not JSON: {error}") from error
    features = data.get("features") if isinstance(data, dict) else None
    if not isinstance(features, list) or data.get("type") != "FeatureCollection" or not features:
        raise RegionsError(f"{path}: features: give a FeatureCollection with a feature for each region")
    regions = tuple(_region(f"{path}: feature {n}", feature, n) for n, feature in enumerate(features, 1))
    names = [region.name for region in regions]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise RegionsError(f"{path}: name {twice!r} is given twice: name each region differently")
    return regions


def _region(where: str, feature: Any, number: int) -> GivenRegion:
    geometry = feature.get("geometry") if isinstance(feature, dict) else None
    properties = (feature.get("properties") or {}) if isinstance(feature, dict) else {}
    name = properties.get("name", f"r{number:02}") if isinstance(properties, dict) else None
    if not isinstance(name, str) or not is_name(name):
        raise RegionsError(
            f"{where}: properties.name = {name!r}: give a word of {MOST_NAME} letters at most, without "
            f"{NOT_IN_NAMES} or control characters; begin it with a letter or a digit"
        )
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    if kind not in ("Polygon", "MultiPolygon") or not isinstance(geometry, dict):
        raise RegionsError(f"{where} ({name}): geometry.type = {kind!r}: give a Polygon or a MultiPolygon")
    coordinates = geometry.get("coordinates")
    pieces = [coordinates] if kind == "Polygon" else coordinates
    if not isinstance(pieces, list) or not pieces:
        raise RegionsError(f"{where} ({name}): geometry.coordinates is empty: give at least one ring")
    return GivenRegion(name, tuple(_polygon(f"{where} ({name})", piece) for piece in pieces))


def _polygon(where: str, piece: Any) -> Polygon:
    rings = []
    given: list[Any] = piece if isinstance(piece, list) and piece else [()]
    for ring in given:
        try:
            points = np.array([point[:2] for point in ring], dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise RegionsError(f"{where}: coordinates: give rings of [x, y], in m") from error
        if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 4 or not np.isfinite(points).all():
            raise RegionsError(
                f"{where}: coordinates: a ring has {len(points)} points: give four or more finite [x, y], "
                "the last one equal to the first"
            )
        rings.append(points)
    return Polygon(tuple(rings))


def to_geojson(regions: Sequence[GivenRegion], frame_id: str) -> str:
    """Text of a FeatureCollection that read_regions reads; coordinates in whole centimetres."""
    features = [
        {
            "type": "Feature",
            "properties": {"name": region.name},
            "geometry": {
                "type": "MultiPolygon",
                "coordinates": [
                    [np.round(ring, 2).tolist() for ring in polygon.rings] for polygon in region.polygons
                ],
            },
        }
        for region in regions
    ]
    # a feature a line: easy to compare and to edit by hand
    lines = ",\n".join(json.dumps(feature) for feature in features)
    head = f'{{"type": "FeatureCollection", "frame_id": {json.dumps(frame_id)}, "features": [\n'
    return f"{head}{lines}\n]}}\n"
