"""Polishes poses of a scan and weighs them by all its beams, each in one compiled call.

The steps are those of `fit`, RayCaster.cast, `find_clearance` and `find_support`; the calls between them cost
more than the work on few poses.
"""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.raycast import RayCaster, cast_rays, in_cells, stop_at
from eigenscan.geometry.trace import DARK
from eigenscan.projector.intervals import find_clearance
from eigenscan.projector.likelihood import Exactness, find_support, share_of, sure_beyond
from eigenscan.projector.observation import Observation
from eigenscan.projector.refinement import POLISH, Fit, Flat, fit_poses, flat
from eigenscan.projector.site import SensorView, Site
from eigenscan.projector.verification import Grid, Steps, cap, find_overshot, grid_of
from eigenscan.projector.wall_field import WallField, cells_of
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Singles = NDArray[np.float32]
Walls = tuple[NDArray[np.uint32], float, Array]
"""Cells of a field, their width, m, and the map frame's pose in it."""
Rays = tuple[NDArray[np.uint8], Array, float, float]
"""What rays run through: leaps, the map frame's pose in the grid, m a cell, and the grid's heading, rad."""

UNKNOWN_GROUND = 0.1
"""Support that a pose loses off the known part of the map: nothing there speaks against it."""


def weigh(
    walls: WallField,
    caster: RayCaster,
    drawn: WallField,
    slid: Array,
    points: Array,
    beams: tuple[Array, Singles],
    exactness: Exactness,
) -> tuple[Fit, Array, Array]:
    """Poses `slid` (n, 3) polished on `walls`, with their support (n,) and share of explained beams (n,).

    What support lacks of 1 counts by the gain.

    `caster` shows where beams enter these walls, `drawn` when they are beyond them. `points` (B, 2) of the
    whole scan are fitted; `beams`, bearings (b,) and finite ranges (b,), are weighed.
    """
    count = len(slid)
    found = Fit(np.empty((count, 3)), np.empty(count), np.empty((count, 3, 3)))
    out, grid = np.empty((2, count)), caster.grid
    _weigh(
        flat(walls),
        (walls.cells, walls.cell, walls.map_in_field),
        (drawn.cells, drawn.cell, drawn.map_in_field),
        (caster.leap, grid.map_in_grid, grid.resolution, float(grid.origin[2])),
        slid,
        points,
        POLISH.squares,
        beams[0],
        beams[1],
        exactness,
        (found.poses, found.cost, found.information),
        out,
    )
    return found, out[0], out[1]


def doubts(site: Site, view: SensorView, seen: Observation, slid: Array, home: Index) -> Array:
    """What speaks against poses `slid` (n, 3) near positions `home` (n,), by ranges that panoramas foresee.

    The steps are `find_overshot`, `find_support` and RayCaster.in_dark.
    """
    sensor, grid, (bearings, ranges) = seen.sensor, site.caster.grid, seen.weighed
    out = np.empty(len(slid))
    _doubt(
        view.leaves,
        grid_of(site.lattice),
        home,
        slid,
        sensor.angle_min,
        seen.few,
        cap(sensor.range_max),
        (site.drawn.cells, site.drawn.cell, site.drawn.map_in_field),
        (site.caster.leap, grid.map_in_grid, grid.resolution, float(grid.origin[2])),
        bearings,
        ranges,
        share_of(ranges),
        site.readings[0].exactness,
        out,
    )
    return out


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _doubt(
    leaves: Steps,
    lattice: Grid,
    home: Index,
    slid: Array,
    angle_min: float,
    beams: Index,
    most: np.float32,
    drawn: Walls,
    rays: Rays,
    bearings: Array,
    seen: Singles,
    share: Array,
    exactness: Exactness,
    out: Array,
) -> None:
    through = np.empty((len(slid), len(beams)), dtype=np.float32)
    find_overshot(leaves, lattice, home, slid, angle_min, beams, seen, most, through)
    through *= np.float32(exactness.sure)
    cells, cell, map_in_field = drawn
    found = np.empty((2, len(slid)))
    find_support(
        cells,
        cell,
        cells_of(map_in_field, cell, slid),
        bearings,
        seen,
        share,
        through,
        exactness.scale,
        found,
    )
    leap, map_in_grid, resolution, _ = rays
    stops = stop_at(leap, in_cells(map_in_grid, resolution, np.ascontiguousarray(slid[:, :2])))
    for i in range(len(slid)):
        # nothing speaks against a pose on what the map does not know
        out[i] = (UNKNOWN_GROUND if stops[i] == DARK else 0.0) - found[0, i]


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _weigh(
    field: Flat,
    walls: Walls,
    drawn: Walls,
    rays: Rays,
    slid: Array,
    points: Array,
    scales: Array,
    bearings: Array,
    seen: Singles,
    exactness: Exactness,
    fitted: tuple[Array, Array, Array],
    out: Array,
) -> None:
    poses, cost, information = fitted
    fit_poses(field, slid, points, scales, poses, cost, information)
    leap, map_in_grid, resolution, turned = rays
    starts, limits = poses.copy(), np.empty(len(seen))
    ground = in_cells(map_in_grid, resolution, np.ascontiguousarray(poses[:, :2]))
    for i in range(len(poses)):
        starts[i, 0], starts[i, 1], starts[i, 2] = ground[i, 0], ground[i, 1], poses[i, 2] - turned
    share, total = np.empty(len(seen)), 0.0
    for j in range(len(seen)):
        limits[j] = seen[j] / resolution
        share[j] = np.sqrt(np.float64(seen[j]))
        total += share[j]
    for j in range(len(seen)):
        share[j] /= max(total, 1e-9)
    entered = cast_rays(leap, starts, bearings, limits, resolution)
    through = np.zeros(entered.shape, dtype=np.float32)
    cells, cell, map_in_field = drawn
    find_clearance(cells, cell, cells_of(map_in_field, cell, poses), bearings, entered, seen, through)
    for i in range(len(poses)):
        for j in range(len(seen)):
            through[i, j] = sure_beyond(through[i, j], exactness.scale) * exactness.sure
    cells, cell, map_in_field = walls
    find_support(
        cells, cell, cells_of(map_in_field, cell, poses), bearings, seen, share, through, exactness.scale, out
    )
    stops = stop_at(leap, ground)
    for i in range(len(poses)):
        out[0, i] = 1.0 - exactness.gain * (1.0 - out[0, i])
        if stops[i] == DARK:
            out[0, i] -= UNKNOWN_GROUND
