"""How surely a lidar's next scan distinguishes places: scans are cast at each, and weighed at all others.

By the same likelihood as a real scan (`likelihood`): what is foreseen is what the tracker will receive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from eigenscan.eigenspace.analysis import coarse_sensor
from eigenscan.eigenspace.panorama import Sensor
from eigenscan.geometry.pose import compose
from eigenscan.geometry.raycast import cast_rays, in_cells
from eigenscan.projector.intervals import find_clearance
from eigenscan.projector.likelihood import FULL_BEAMS, NATS, Exactness, find_support, sure_beyond
from eigenscan.projector.observation import NEAREST
from eigenscan.projector.site import Site
from eigenscan.projector.wall_field import cells_of
from eigenscan.projector.weighing import Rays, Walls, weigh
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

BEAMS = 72
"""Beams of a scan that are cast: at most so many, evenly spread."""
FARTHEST_M = 30.0
"""m, of a lidar that does not state its reach."""
SUPPOSED = 0.6
"""Of the foreseen support what a real scan has: people, furniture and noise take from it."""
UNSURE = 0.06
"""Support by which scans may differ where places do not: a track is off by some centimetres."""


@dataclass(frozen=True)
class Lidar:
    """A robot's lidar: its angular grid and its `mount` (3,) in the base frame."""

    sensor: Sensor
    mount: Array

    @property
    def bearings(self) -> Array:
        """Of the beams (b,) that are cast, rad, in the sensor's frame."""
        coarse = coarse_sensor(self.sensor)
        every = -(-coarse.beams // BEAMS)
        steps = np.arange(0, coarse.beams, every, dtype=np.float64)
        return self.sensor.angle_min + steps * coarse.angle_increment

    @property
    def reach(self) -> float:
        """M."""
        return self.sensor.range_max if self.sensor.range_max > 0 else FARTHEST_M

    @property
    def sees_around(self) -> bool:
        """Whether a turn shows nothing new."""
        return bool(self.sensor.beams * self.sensor.angle_increment > np.deg2rad(330.0))


def walls_of(site: Site) -> Walls:
    """What the map draws as walls, for compiled code."""
    return site.drawn.cells, site.drawn.cell, site.drawn.map_in_field


def rays_of(site: Site) -> Rays:
    """What rays run through, for compiled code."""
    grid = site.caster.grid
    return site.caster.leap, grid.map_in_grid, grid.resolution, float(grid.origin[2])


def odds(site: Site, lidars: Sequence[Lidar], moved: Array) -> Array:
    """Log-likelihood ratios (m, k, k), nats, of k places, from base poses `moved` (m, k, 3) after m moves.

    [i, a, b]: of place a to b, by a scan that is taken at a. 0 on the diagonal.
    """
    count, places = moved.shape[:2]
    total = np.zeros((count, places, places))
    surfaces = site.readings[0].walls
    surface = surfaces.cells, surfaces.cell, surfaces.map_in_field
    for lidar in lidars:
        out = np.empty((count, places, places))
        sensors = compose(moved, lidar.mount)
        bearings = lidar.bearings
        full = FULL_BEAMS * len(bearings) / coarse_sensor(lidar.sensor).beams
        _odds(
            surface,
            walls_of(site),
            rays_of(site),
            sensors,
            bearings,
            lidar.reach,
            full,
            site.readings[0].exactness,
            out,
        )
        total += out
    return total


def fitted_odds(site: Site, lidars: Sequence[Lidar], places: Array) -> Array:
    """The same (k, k) after one move, to `places` (k, 3); each scan is fitted to the walls there first.

    So an error of the tracks' poses is no difference of the places.
    """
    total = np.zeros((len(places), len(places)))
    for lidar in lidars:
        sensors, bearings = compose(places, lidar.mount), lidar.bearings
        ranges = site.caster.cast(sensors, bearings, lidar.reach)
        full = FULL_BEAMS * len(bearings) / coarse_sensor(lidar.sensor).beams
        for a, seen in enumerate(ranges):
            back = np.isfinite(seen) & (seen >= NEAREST)
            if not back.any():
                continue
            beams = bearings[back], np.ascontiguousarray(seen[back])
            points = np.column_stack([beams[1] * np.cos(beams[0]), beams[1] * np.sin(beams[0])])
            reading = site.readings[0]
            _, support, _ = weigh(
                reading.walls, reading.caster, site.drawn, sensors, points, beams, reading.exactness
            )
            worth = NATS * SUPPOSED * min(1.0, int(back.sum()) / full)
            total[a] += worth * np.maximum(support[a] - support - UNSURE, 0.0)
    np.fill_diagonal(total, 0.0)
    return total


def expected_share(shares: Array, ratios: Array) -> Array:
    """Expected share (m,) of the true place among places with `shares` (k,), after `ratios` (m, k, k)."""
    others = np.einsum("b,mab->ma", shares, np.exp(-ratios))
    expected: Array = np.einsum("a,ma->m", shares * shares, 1.0 / others)
    return expected


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _odds(
    surface: Walls,
    drawn: Walls,
    rays: Rays,
    sensors: Array,
    bearings: Array,
    reach: float,
    full: float,
    exactness: Exactness,
    out: Array,
) -> None:
    leap, map_in_grid, resolution, turned = rays
    limits, nothing = np.full(len(bearings), reach / resolution), np.float32(0.0)
    places = sensors.shape[1]
    for i in range(len(sensors)):
        poses = np.ascontiguousarray(sensors[i])
        starts = poses.copy()
        ground = in_cells(map_in_grid, resolution, np.ascontiguousarray(poses[:, :2]))
        for a in range(places):
            starts[a, 0], starts[a, 1], starts[a, 2] = ground[a, 0], ground[a, 1], poses[a, 2] - turned
        entered = cast_rays(leap, starts, bearings, limits, resolution)
        for a in range(places):
            back = np.isfinite(entered[a]) & (entered[a] >= NEAREST)
            count = int(back.sum())
            out[i, a] = 0.0
            if count == 0:
                continue
            seen, along = entered[a][back], bearings[back]
            share = np.sqrt(seen.astype(np.float64))
            share /= share.sum()
            there = np.empty((places, count), dtype=np.float32)
            for b in range(places):
                there[b] = entered[b][back]
            through = np.full((places, count), nothing)
            cells, cell, map_in_field = drawn
            find_clearance(cells, cell, cells_of(map_in_field, cell, poses), along, there, seen, through)
            for b in range(places):
                for j in range(count):
                    through[b, j] = sure_beyond(through[b, j], exactness.scale) * exactness.sure
            cells, cell, map_in_field = surface
            support = np.empty((2, places))
            find_support(
                cells,
                cell,
                cells_of(map_in_field, cell, poses),
                along,
                seen,
                share,
                through,
                exactness.scale,
                support,
            )
            worth = NATS * SUPPOSED * exactness.gain * min(1.0, count / full)
            for b in range(places):
                if b != a:
                    out[i, a, b] = worth * max(support[0, a] - support[0, b] - UNSURE, 0.0)
