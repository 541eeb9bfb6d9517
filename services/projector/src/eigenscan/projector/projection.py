"""One scan to candidate poses: project, associate, verify, refine, weigh (paper, sections 2, 5, 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.projector.connectivity import best_of_neighbourhoods
from eigenscan.projector.likelihood import log_likelihood
from eigenscan.projector.observation import Observation
from eigenscan.projector.refinement import refine
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import SensorView, Site
from eigenscan.projector.verification import TRUNCATION, truncated_l1
from numpy.typing import NDArray

Array = NDArray[np.float64]

POINT_SIGMA = 0.1
"""m, error of a beam's end point about the map's wall."""
FLOOR = np.diag([0.05, 0.05, np.deg2rad(0.7)]) ** 2
"""Covariance that no pose goes below: the map's own error."""
SAME_M, SAME_RAD = 0.3, np.deg2rad(6.0)
"""Two refined poses nearer than this are one."""


@dataclass(frozen=True)
class RegionProjection:
    """A scan's coefficients (M,) in one region's subspace and its error, root mean square, m."""

    coefficients: Array
    error_energy: float


@dataclass(frozen=True)
class Candidates:
    """n poses of the sensor, most likely first."""

    poses: Array
    covariances: Array
    log_likelihoods: Array
    explained: Array
    subspace: NDArray[np.int64]
    projections: tuple[RegionProjection, ...]
    unlisted_log_likelihood: float


def project(site: Site, view: SensorView, seen: Observation, settings: ProjectorSettings) -> Candidates:
    """Candidate poses of the sensor in the map frame."""
    projections, index, subspace = _associate(view, seen, settings.candidates)
    cost = _verify(view, seen, index, subspace)
    best = np.argsort(cost, kind="stable")
    index, subspace = index[best], subspace[best]
    poses = _poses(view, index, subspace)
    kept = best_of_neighbourhoods(poses, 0.4, np.deg2rad(9.0), settings.refined)
    poses, information = refine(site.field, poses[kept], seen.points)
    return _weigh(site, view, seen, settings, poses, information, subspace[kept], projections)


def _associate(
    view: SensorView, seen: Observation, count: int
) -> tuple[tuple[RegionProjection, ...], NDArray[np.int64], NDArray[np.int64]]:
    """The `count` poses nearest to the scan over all subspaces, by the bound on ||S - S'||."""
    projections, indices, squares, owners = [], [], [], []
    for number, subspace in enumerate(view.subspaces):
        alpha, energy = subspace.project(seen.coarse)
        projections.append(RegionProjection(alpha, energy))
        k = min(count, subspace.tree.n)
        distance, index = subspace.tree.query(alpha, k=k, eps=0.5)
        indices.append(np.atleast_1d(index))
        squares.append(np.atleast_1d(distance) ** 2 + energy**2 * len(seen.coarse))
        owners.append(np.full(k, number))
    square, index, owner = np.concatenate(squares), np.concatenate(indices), np.concatenate(owners)
    near = np.argsort(square, kind="stable")[:count]
    return tuple(projections), index[near].astype(np.int64), owner[near]


def _verify(
    view: SensorView, seen: Observation, index: NDArray[np.int64], owner: NDArray[np.int64]
) -> NDArray[np.float32]:
    cost = np.empty(len(index), dtype=np.float32)
    weight = (~np.isnan(seen.coarse)).astype(np.float32)
    if view.horizon > SHORT_SIGHT:
        weight[np.isinf(seen.coarse)] = 0.0
    for number, subspace in enumerate(view.subspaces):
        own = owner == number
        scan = subspace.transform(np.nan_to_num(seen.coarse, nan=0.0, posinf=np.inf))
        cost[own] = truncated_l1(subspace.panoramas, index[own], scan, weight, np.float32(TRUNCATION))
    return cost


SHORT_SIGHT = 15.0
"""m: below this range an empty beam says that no wall is near; beyond, glass and black walls do the same."""


def _poses(view: SensorView, index: NDArray[np.int64], owner: NDArray[np.int64]) -> Array:
    poses = np.empty((len(index), 3))
    for number, subspace in enumerate(view.subspaces):
        own = owner == number
        poses[own] = subspace.poses(index[own])
    return poses


def _weigh(
    site: Site,
    view: SensorView,
    seen: Observation,
    settings: ProjectorSettings,
    poses: Array,
    information: Array,
    owner: NDArray[np.int64],
    projections: tuple[RegionProjection, ...],
) -> Candidates:
    used = seen.used & (seen.coarse < view.horizon)
    z = seen.coarse[used]
    predicted = site.caster.cast(poses, seen.bearings[used], 2.0 * view.horizon)
    likelihood = log_likelihood(z, predicted, view.ranges, view.horizon)
    order = np.argsort(-likelihood, kind="stable")
    ranked = poses[order]
    kept = order[best_of_neighbourhoods(ranked, SAME_M, SAME_RAD, settings.published)]
    explained = (np.abs(predicted[kept] - z) < 0.3).mean(axis=1)
    prior = np.diag([1.0 / 0.25**2, 1.0 / 0.25**2, 1.0 / np.deg2rad(5.0) ** 2])
    covariance = np.linalg.inv(information[kept] / (4.0 * POINT_SIGMA**2) + prior) + FLOOR
    unlisted = float(likelihood[kept[-1]]) if len(kept) else 0.0
    return Candidates(
        poses[kept], covariance, likelihood[kept], explained, owner[kept], projections, min(unlisted, 0.0)
    )
