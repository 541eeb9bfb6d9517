"""One scan to candidate poses: project, associate, verify, refine, weigh (paper, sections 2, 5, 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.projector.connectivity import best_of_neighbourhoods
from eigenscan.projector.covariance import pose_covariances
from eigenscan.projector.likelihood import log_likelihood, support
from eigenscan.projector.observation import Observation
from eigenscan.projector.refinement import polish, slide
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import SensorView, Site
from eigenscan.projector.verification import verify
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PATCH_M, PATCH_RAD = 0.4, np.deg2rad(9.0)
"""Of the candidates this near to each other only the best is refined."""
SAME_M, SAME_RAD = 0.25, np.deg2rad(5.0)
"""Refined poses this near to each other are one."""
CLIMBING = 300
"""Candidates that also look at the model's finer positions around them."""
SLIDE_POINTS, WEIGHED_BEAMS = 30, 60
"""Beams that are enough for the coarse refinement, and for the likelihood."""


@dataclass(frozen=True)
class Projected:
    """A scan in each region's space: coefficients (R, M) and its error, root mean square (R,), m."""

    coefficients: Array
    error_energy: Array


@dataclass(frozen=True)
class Candidates:
    """n poses of the sensor, most likely first. `region` (n,) proposed each."""

    poses: Array
    covariances: Array
    log_likelihoods: Array
    explained: Array
    region: Index
    projected: Projected
    unlisted_log_likelihood: float


def find_candidates(
    site: Site, view: SensorView, seen: Observation, settings: ProjectorSettings
) -> Candidates:
    """Candidate poses of the sensor in the map frame."""
    projected = project(view, seen)
    rows, _ = view.table.nearest(
        projected.coefficients,
        projected.error_energy**2 * view.embedding.channels * len(seen.coarse),
        settings.candidates,
    )
    seeds, region = _seeds(site, view, seen, rows, settings.refined)
    points = seen.points
    sliding = points[:: max(1, -(-len(points) // SLIDE_POINTS))]
    slid, cost = slide(site.walls, site.field.origin, seeds, sliding)
    order = np.argsort(cost, kind="stable")
    order = order[best_of_neighbourhoods(slid[order], SAME_M, SAME_RAD, 2 * settings.published)]
    return _weigh(site, seen, slid[order], region[order], projected, settings)


def project(view: SensorView, seen: Observation) -> Projected:
    """The scan in every region's space; beams without a return take no part."""
    usable = np.isfinite(seen.coarse)
    channels = view.embedding(np.where(usable, seen.coarse, np.float32(0)))
    parts = [space.project(channels, usable) for space in view.spaces]
    return Projected(np.array([alpha for alpha, _ in parts]), np.sqrt([square for _, square in parts]))


def _seeds(site: Site, view: SensorView, seen: Observation, rows: Index, count: int) -> tuple[Array, Index]:
    """Poses to refine: half the nearest in eigenspace, half the best verified, one a neighbourhood."""
    position = view.row_position[rows].astype(np.int64)
    window = view.row_window[rows].astype(np.int64)
    region = np.searchsorted(view.table.bounds, rows, side="right") - 1
    near = _poses(site, seen, position, window)
    first = best_of_neighbourhoods(near, PATCH_M, PATCH_RAD, count // 2)
    range_max = seen.sensor.range_max
    position, window, cost = verify(
        view.windows, site.lattice, position, window, seen.coarse, range_max, CLIMBING
    )
    order = np.argsort(cost, kind="stable")
    verified = _poses(site, seen, position[order], window[order])
    second = best_of_neighbourhoods(verified, PATCH_M, PATCH_RAD, count // 2)
    poses = np.concatenate([verified[second], near[first]])
    return poses, np.concatenate([region[order][second], region[first]])


def _poses(site: Site, seen: Observation, position: Index, window: Index) -> Array:
    step = 2.0 * np.pi / site.lattice.panoramas.shape[1]
    heading = wrap(window * step - seen.sensor.angle_min)
    return np.column_stack([site.lattice.positions[position], heading])


def _weigh(
    site: Site,
    seen: Observation,
    slid: Array,
    region: Index,
    projected: Projected,
    settings: ProjectorSettings,
) -> Candidates:
    poses, information = polish(site.field, slid, seen.points)
    used = np.flatnonzero(seen.used)
    used = used[:: max(1, -(-len(used) // WEIGHED_BEAMS))]
    z, bearing = seen.coarse[used], seen.bearings[used]
    reach = float(z.max()) + 1.0
    predicted = site.caster.cast(poses, bearing, reach)
    angle = poses[:, 2:3] + bearing
    ends = poses[:, None, :2] + z[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    distance, _ = site.field.at(ends)
    likelihood = log_likelihood(support(z, predicted, distance))
    order = np.argsort(-likelihood, kind="stable")
    kept = order[best_of_neighbourhoods(poses[order], SAME_M, SAME_RAD, settings.published)]
    return Candidates(
        poses[kept],
        pose_covariances(information[kept], len(seen.points)),
        likelihood[kept],
        (np.abs(predicted[kept] - z) < 0.3).mean(axis=1),
        region[kept],
        projected,
        float(min(likelihood[kept[-1]], 0.0)),
    )
