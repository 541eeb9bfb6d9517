"""A hall that a real projector can search: niches in its walls look different from everywhere in it."""

from __future__ import annotations

from functools import cache
from random import Random

import numpy as np
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import build_site
from eigenscan.tracker.planar import Pose
from numpy.typing import NDArray

RESOLUTION = 0.1
"""m."""
LOW, HIGH = -4.0, 20.0
"""Of the map along both axes, m."""
INSIDE = (0.5, 15.5, 0.0, 12.0)
"""Of the hall: x and y, m. Robots drive from 2 to 14 and from 1 to 11."""
NICHES = (
    (-2.0, 0.5, 2.0, 4.0),
    (-0.5, 0.5, 7.0, 10.0),
    (15.5, 18.0, 5.0, 6.0),
    (15.5, 16.5, 8.0, 11.5),
    (2.0, 5.0, 12.0, 13.0),
    (8.0, 9.0, 12.0, 15.0),
    (11.0, 14.0, -1.5, 0.0),
)
"""As INSIDE; the last one is walled up in every second edition of the map."""


@cache
def hall(edition: int) -> SiteModel:
    """The models of the hall."""
    return build_site(_grid(edition), MapbuilderSettings().plan)


def ranges(
    pose: Pose, bearings: NDArray[np.float64], range_max: float, noise: float, random: Random
) -> list[float]:
    """What a lidar in the hall measures, m; the bearings (B,), rad, are of its own frame."""
    seen = _caster().cast(np.array(pose), bearings, range_max)[0]
    return [float(value) + random.gauss(0.0, noise) for value in seen]


def _grid(edition: int) -> GridMap:
    size = round((HIGH - LOW) / RESOLUTION)
    cells = np.full((size, size), OCCUPIED, dtype=np.uint8)
    for x, to_x, y, to_y in (INSIDE, *NICHES)[: len(NICHES) + (edition == 0)]:
        columns, rows = (
            slice(round((low - LOW) / RESOLUTION), round((high - LOW) / RESOLUTION))
            for low, high in ((x, to_x), (y, to_y))
        )
        cells[rows, columns] = FREE
    return GridMap(cells, RESOLUTION, np.array([LOW, LOW, 0.0]))


@cache
def _caster() -> RayCaster:
    return RayCaster.of(_grid(0))
