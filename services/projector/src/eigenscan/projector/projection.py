"""One scan to candidate poses: project, associate, verify, refine, weigh (paper, sections 2, 5, 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.projector.association.manifold import Matches
from eigenscan.projector.connectivity import best_of_neighbourhoods, lattice_poses
from eigenscan.projector.covariance import pose_covariances
from eigenscan.projector.foreground import foreground
from eigenscan.projector.likelihood import THROUGH_MARGIN, log_likelihood, support
from eigenscan.projector.observation import ANALYSIS_TURN, Observation
from eigenscan.projector.refinement import POLISH, SLIDE, fit
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
POLISHED, WEIGHED = 60, 36
"""Slid poses that are polished, and polished poses that are weighed."""
FOREGROUND_SHARE = 0.1
"""Of the beams on free-standing things, from which on the scan is also searched without them."""
CLIMBING = 300
"""Candidates that also look at the model's finer positions around them."""
SLIDE_POINTS, WEIGHED_BEAMS = 32, 120
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
    projected, matches = _associate(view, seen, settings.candidates)
    seeds, region = _seeds(site, view, seen, matches, settings.refined)
    points = seen.points
    sliding = points[:: max(1, -(-len(points) // SLIDE_POINTS))]
    slid = fit(site.coarse_walls, seeds, sliding, SLIDE)
    best = best_of_neighbourhoods(slid.poses, np.argsort(slid.cost), SAME_M, SAME_RAD, POLISHED)
    return _weigh(site, seen, slid.poses[best], region[best], projected, settings)


def _associate(view: SensorView, seen: Observation, count: int) -> tuple[Projected, Matches]:
    """The scan in every region's space, and the poses nearest to it there.

    Where narrow things stand free in the scan, half of them are the nearest to the scan without them.
    """
    returned = np.isfinite(seen.coarse)
    behind = returned & ~foreground(seen.coarse, 2.0 * np.pi / ANALYSIS_TURN)
    projected = project(view, seen, returned)
    cut_off = np.count_nonzero(returned) - np.count_nonzero(behind)
    if cut_off < FOREGROUND_SHARE * len(behind) or np.count_nonzero(behind) < len(behind) // 4:
        return projected, _nearest(view, projected, len(behind), count)
    whole = _nearest(view, projected, len(behind), count // 2)
    rest = _nearest(view, project(view, seen, behind), len(behind), count // 2)
    return projected, whole.alternating(rest)


def project(view: SensorView, seen: Observation, used: NDArray[np.bool_]) -> Projected:
    """The scan in every region's space; only the beams `used` (J,) take part."""
    channels = view.embedding(np.where(used, seen.coarse, np.float32(0)))
    coefficients, square = view.spaces.project(channels, used)
    return Projected(coefficients, np.sqrt(square))


def _nearest(view: SensorView, projected: Projected, beams: int, count: int) -> Matches:
    square = projected.error_energy**2 * (view.embedding.channels * beams)
    return view.association.nearest(projected.coefficients, square, count)


def _seeds(
    site: Site, view: SensorView, seen: Observation, matches: Matches, count: int
) -> tuple[Array, Index]:
    """Poses to refine: half the nearest in eigenspace, half the best verified, one a neighbourhood."""
    rows = matches.rows
    position = view.row_position[rows].astype(np.int64)
    window = view.row_window[rows].astype(np.int64)
    region = np.searchsorted(view.bounds, rows, side="right") - 1
    positions, angle_min = site.lattice.positions, seen.sensor.angle_min
    near = lattice_poses(positions, position, window, ANALYSIS_TURN, angle_min) + matches.offsets
    first = best_of_neighbourhoods(near, np.arange(len(near)), PATCH_M, PATCH_RAD, count // 2)
    position, window, cost = verify(
        view.windows, site.lattice, position, window, seen.coarse, seen.sensor.range_max, CLIMBING
    )
    verified = lattice_poses(positions, position, window, ANALYSIS_TURN, angle_min)
    order = np.argsort(cost)
    second = best_of_neighbourhoods(verified, order, PATCH_M, PATCH_RAD, count // 2)
    return np.concatenate([verified[second], near[first]]), np.concatenate([region[second], region[first]])


def _weigh(
    site: Site,
    seen: Observation,
    slid: Array,
    region: Index,
    projected: Projected,
    settings: ProjectorSettings,
) -> Candidates:
    polished = fit(site.walls, slid, seen.points, POLISH)
    best = best_of_neighbourhoods(polished.poses, np.argsort(polished.cost), SAME_M, SAME_RAD, WEIGHED)
    poses = polished.poses[best]
    used = np.flatnonzero(seen.used)
    used = used[:: max(1, -(-len(used) // WEIGHED_BEAMS))]
    z, bearing = seen.coarse[used], seen.bearings[used]
    predicted = site.caster.cast(poses, bearing, float(z.max()) + THROUGH_MARGIN)
    supported, explained = support(site.walls, poses, bearing, z, predicted)
    kept = np.argsort(-supported)[: settings.published]
    likelihood = log_likelihood(supported[kept])
    chosen = best[kept]
    return Candidates(
        poses[kept],
        pose_covariances(polished.information[chosen]),
        likelihood,
        explained[kept],
        region[chosen],
        projected,
        float(min(likelihood[-1], 0.0)),
    )
