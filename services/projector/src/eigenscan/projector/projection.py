"""One scan to candidate poses: project, associate, verify, refine, weigh (paper, sections 2, 5, 6)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from typing import Protocol

import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN
from eigenscan.geometry.circle import TURN, difference
from eigenscan.geometry.symmetric import determinant_each
from eigenscan.projector.association.manifold import Matches
from eigenscan.projector.candidates import Candidates, Fitted, Projected
from eigenscan.projector.connectivity import best_of_neighbourhoods, lattice_poses
from eigenscan.projector.covariance import pose_covariances
from eigenscan.projector.first_look import first_look
from eigenscan.projector.focus import WHOLE, Scope
from eigenscan.projector.foreground import foreground
from eigenscan.projector.from_eigenspace import answer
from eigenscan.projector.likelihood import log_likelihood, ordinary_support
from eigenscan.projector.observation import Observation
from eigenscan.projector.refinement import SLIDE, Fit, cost_at, fit
from eigenscan.projector.second_search import is_unsure, most_alike
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Reading, SensorView, Site
from eigenscan.projector.verification import verify
from eigenscan.projector.weighing import doubts, weigh
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
TraceCallback = Callable[[str, Array], None]
"""Called after each stage with its name and the sensor poses (n, 3) that it leaves.

The names of a second search's stages end with AGAIN.
"""
AGAIN = " again"

PATCH_M, PATCH_RAD = 0.4, np.deg2rad(9.0)
"""Of candidates this near to each other only the best is refined."""
USUAL_AREA = 1000.0
"""m2, up to which the refined candidates are enough: in a larger site more places look like the right one."""
SAME_M, SAME_RAD = 0.25, np.deg2rad(5.0)
"""Refined poses this near to each other are one."""
ONE_M, ONE_RAD = 0.05, float(np.deg2rad(2.0))
"""The same of slid poses around one place: the polish moves them into one."""
ABSENT_M, ABSENT_RAD = 1.0, np.deg2rad(20.0)
"""A place that is asked for is not in a list without a pose this near.

Nearer ones are other fits of one place: asked for, too, two claims on fr079 were 0.5 m off
(benchmarks/evaluate.py --only fr079).
"""
AGAIN_REFINED = 2
"""Times as many candidates are refined in a second search: the right one is seldom among the best."""
POLISHED = 48
"""Slid poses that are polished and weighed; more where more are published."""
FOREGROUND_SHARE = 0.1
"""Share of beams on free-standing things from which the scan is also searched without them."""
LACKING_SHARE = 0.1
"""Share of beams that show nothing from which a scan is compared by the others alone: its coefficients then
are those of the mean where these do not fix them."""
CLIMBING = 300
"""Candidates that also look at the model's finer positions around them."""
SURELY_LARGER = 2.0
"""Ratio of the mean squares of 45 independent errors each that chance exceeds in one of 100 (F-test)."""
SLIDE_POINTS = 32
"""Beams that are enough for the coarse refinement."""


@dataclass(frozen=True)
class _Slid:
    """Poses (n, 3) after the coarse refinement; what speaks against each (n,), the region of each (n,)."""

    poses: Array
    doubts: Array
    region: Index

    def joined(self, other: _Slid) -> _Slid:
        return _Slid(
            np.concatenate([self.poses, other.poses]),
            np.concatenate([self.doubts, other.doubts]),
            np.concatenate([self.region, other.region]),
        )


class Search(Protocol):
    """Searches for a scan in the regions of a scope, as `find_candidates` does."""

    def __call__(
        self, site: Site, view: SensorView, seen: Observation, settings: ProjectorSettings, *, scope: Scope
    ) -> Candidates:
        """The poses that explain the scan."""
        ...


def find_candidates(
    site: Site,
    view: SensorView,
    seen: Observation,
    settings: ProjectorSettings,
    trace: TraceCallback = lambda *_: None,
    scope: Scope = WHOLE,
) -> Candidates:
    """Candidate poses of the sensor in the map frame, of the regions in `scope`.

    Where none is sure, the scan is searched for again without the eigenspace.
    """

    def again(stage: str, poses: Array) -> None:
        trace(stage + AGAIN, poses)

    by_eigenspace = settings.verification == "eigenspace"
    masks = [np.isfinite(seen.coarse)] if by_eigenspace else _masks(seen.coarse)
    waiting = _prepare(site, view, seen, masks, scope)
    projected, matches = _associate(view, seen, masks, settings.candidates, scope)
    if by_eigenspace:
        found = answer(site, view, seen, projected, matches, settings.published)
        return replace(found, waiting=waiting if waiting.any() else None)
    refined = round(settings.refined * max(1.0, np.sqrt(site.area(scope.regions) / USUAL_AREA)))
    slid = _slide(site, view, seen, _seeds(view, matches), refined, trace)
    found = _weigh_promising(site, seen, slid, projected, settings, trace, scope)
    if view.tables.sweep is not None and is_unsure(found):
        alike = _alike(site, view, seen, settings.candidates, scope)
        slid = slid.joined(_slide(site, view, seen, alike, AGAIN_REFINED * refined, again))
        found = _weigh_promising(site, seen, slid, projected, settings, again, scope)
    trace("published", found.poses)
    trace("first", found.poses[:1])
    if not waiting.any():
        return found
    return replace(found, waiting=waiting, unlisted_log_likelihood=0.0)  # of what waits nothing is known


def fit_around(site: Site, seen: Observation, starts: Array, ordinary: float) -> Fitted:
    """The best supported of the poses to which the scan moves from sensor poses `starts` (n, 3).

    `ordinary`: support of an ordinary place, for here no other place is looked at.
    """
    slid = slide_around(site, seen, starts)
    kept = best_of_neighbourhoods(slid.poses, np.argsort(slid.cost), ONE_M, ONE_RAD, len(starts))
    _, polished, supported, explained = _weighed(site, seen, slid.poses[kept])
    best = int(supported.argmax())
    own = slice(best, best + 1)
    covariance, likelihood = _judged(site, seen, polished.information[own], supported[own], ordinary)
    return Fitted(polished.poses[best], covariance[0], float(likelihood[0]), float(explained[best]))


def look_also(site: Site, seen: Observation, found: Candidates, places: Array, count: int) -> Candidates:
    """The `count` likeliest of what a search found, and of the poses to which the scan moves from `places`.

    `places` (n, 3): sensor poses. Half of the right poses that a search leaves out, it misses: the scan fits
    there (benchmarks/single_scan.py --stages).
    """
    places = places[~_have(found.poses, places)]
    if not len(places):
        return found
    reading = next(one for one in site.readings if one.surfaces == found.surfaces)
    polished, supported, explained = _weighed_on(site, reading, seen, slide_around(site, seen, places).poses)
    covariances, likelihoods = _judged(site, seen, polished.information, supported, found.ordinary)
    # what is no likelier than an unlisted pose comes last, and is left out
    likelihoods = np.where(likelihoods > found.unlisted_log_likelihood, likelihoods, -np.inf)
    poses = np.concatenate([found.poses, polished.poses])
    likelihoods = np.append(found.log_likelihoods, likelihoods)
    kept = best_of_neighbourhoods(poses, np.argsort(-likelihoods, kind="stable"), SAME_M, SAME_RAD, count)
    kept = kept[np.isfinite(likelihoods[kept])]
    region = site.lattice.region_of[site.lattice.nearest(polished.poses[:, :2])]
    return replace(
        found,
        poses=poses[kept],
        covariances=np.concatenate([found.covariances, covariances])[kept],
        log_likelihoods=likelihoods[kept],
        explained=np.append(found.explained, explained)[kept],
        region=np.append(found.region, region)[kept],
        cut=len(kept) == count,
    )


def _have(poses: Array, places: Array) -> NDArray[np.bool_]:
    """Of which places (n, 3) there is one of the poses (k, 3)."""
    off = places[:, None] - poses[None]
    turned = np.abs(difference(places[:, None, 2], poses[None, :, 2]))
    near = (np.hypot(off[..., 0], off[..., 1]) < ABSENT_M) & (turned < ABSENT_RAD)
    found: NDArray[np.bool_] = near.any(axis=1)
    return found


def slide_around(site: Site, seen: Observation, starts: Array) -> Fit:
    """Where the scan slides from sensor poses `starts` (n, 3), by some of its beams."""
    return fit(site.coarse_walls, starts, _sliding(seen), SLIDE)


def _sliding(seen: Observation) -> Array:
    """The points of a scan that are enough for the coarse refinement."""
    points = seen.points
    return points[:: max(1, -(-len(points) // SLIDE_POINTS))]


def _masks(coarse: NDArray[np.float32]) -> list[NDArray[np.bool_]]:
    """Beams (J,) by which a scan is searched: all that came back.

    Where narrow things stand free in it also those without them.
    """
    returned = np.isfinite(coarse)
    behind = returned & ~foreground(coarse, TURN / ANALYSIS_TURN)
    cut_off = np.count_nonzero(returned) - np.count_nonzero(behind)
    if cut_off < FOREGROUND_SHARE * len(behind) or np.count_nonzero(behind) < len(behind) // 4:
        return [returned]
    return [returned, behind]


def _prepare(
    site: Site, view: SensorView, seen: Observation, masks: list[NDArray[np.bool_]], scope: Scope
) -> NDArray[np.bool_]:
    """Makes ready the regions that the scan may be of, as many as a scan waits for, the likeliest first.

    Which (R,) it may be of as well, and are left to later scans. `masks` (J,) as project's `used`.
    """
    tables = view.tables
    if tables.ready.all():
        return ~tables.ready
    wanted = scope.among(~tables.ready)
    if tables.is_known:
        explained = [project(view, seen, used, scope).explained for used in masks]
        wanted &= np.logical_or.reduce(explained)
    if np.count_nonzero(wanted) > tables.patience:
        order = first_look(site.lattice, seen.coarse, masks[-1])
    else:
        order = np.zeros(len(wanted))
    view.admit(wanted, order)
    return wanted & ~tables.ready


def _associate(
    view: SensorView, seen: Observation, masks: list[NDArray[np.bool_]], count: int, scope: Scope
) -> tuple[Projected, Matches]:
    """The scan in every region's space, and the poses nearest to it there, as many for each of the masks."""
    projected = [project(view, seen, used, scope) for used in masks]
    matches = [_nearest(view, one, len(seen.coarse), count) for one in projected]
    return projected[0], reduce(Matches.joined, matches)


def project(view: SensorView, seen: Observation, used: NDArray[np.bool_], scope: Scope = WHOLE) -> Projected:
    """The scan in the space of every region in `scope`; only the beams `used` (J,) take part."""
    tables = view.tables
    among = scope.regions if tables.is_known else scope.among(tables.ready)
    channels = view.embedding(np.where(used, seen.coarse, np.float32(0)))
    coefficients, square, part = view.spaces.project(channels, used, among)
    explained = explaining(square, view.usual_error)
    lacking = 1.0 - np.count_nonzero(used) / len(used)
    return Projected(coefficients, np.sqrt(square), explained, explained & tables.ready, part, lacking)


def explaining(square: Array, usual: Array) -> NDArray[np.bool_]:
    """Which regions (R,) can explain a scan whose error has these mean squares (R,) in their spaces.

    Not those where the error is larger than that of nearly all their own scans, and more so than elsewhere:
    what stands in front of the sensor is no region's, and adds to the error in all of them alike.
    """
    unusual = square / np.maximum(usual, 1e-12)
    return np.asarray(unusual <= np.maximum(1.0, SURELY_LARGER * unusual.min()))


def _nearest(view: SensorView, projected: Projected, beams: int, count: int) -> Matches:
    if view.tables.sweep is not None and projected.lacking > LACKING_SHARE:
        return view.tables.sweep.nearest_to_part(projected.part, projected.searched, projected.lacking, count)
    square = projected.error_energy**2 * (view.embedding.channels * beams)
    square[~projected.searched] = np.inf
    found = view.association.nearest(projected.coefficients, square, count)
    found.check(int(view.bounds[-1]))
    return found if view.ratios is None else view.ratios.interpolate(found, projected.coefficients)


@dataclass(frozen=True)
class _Seeds:
    """Positions (n,) of the lattice and windows (n,) of their panoramas, and a region (n,) of each.

    `offset` (n, 3): from there, m, m, rad, None without interpolation.
    """

    home: Index
    window: Index
    region: Index
    offset: Array | None = None


def _seeds(view: SensorView, matches: Matches) -> _Seeds:
    """The poses nearest to the scan in eigenspace, each once."""
    offset = None
    if matches.between is None:
        rows, home, window = view.distinct_places(matches.sorted_rows)
    else:
        matches = matches.by_row()
        rows, offset = matches.rows, matches.offsets
        home, window = view.places(rows)
        window += np.rint(offset[:, 2] * (ANALYSIS_TURN / TURN)).astype(np.int64)
        window %= ANALYSIS_TURN
    return _Seeds(home, window, np.searchsorted(view.bounds, rows, side="right") - 1, offset)


def _alike(site: Site, view: SensorView, seen: Observation, count: int, scope: Scope) -> _Seeds:
    """The poses of the regions in `scope` whose predicted scans are most like the scan."""
    # regions overlap
    wanted = np.zeros(len(site.lattice.positions), dtype=bool)
    for region in np.flatnonzero(scope.among(view.tables.ready)):
        wanted[site.lattice.searched[region]] = True
    positions = np.flatnonzero(wanted)
    home, window = most_alike(view.windows, view.leaves, positions, seen.coarse, seen.sensor.range_max, count)
    return _Seeds(home, window, site.lattice.region_of[home])


def _verified(
    site: Site, view: SensorView, seen: Observation, seeds: _Seeds, count: int, trace: TraceCallback
) -> tuple[Array, Index, Index]:
    """Poses to refine (k, 3), positions beside them (k,), their regions (k,): the best of neighbourhoods."""
    home, window, offset = seeds.home, seeds.window, seeds.offset
    positions, angle_min = site.lattice.positions, seen.sensor.angle_min
    position, window, cost = verify(
        view.windows, view.leaves, site.lattice, home, window, seen.coarse, seen.sensor.range_max, CLIMBING
    )
    poses = lattice_poses(positions, position, window, ANALYSIS_TURN, angle_min)
    if offset is not None:
        poses[:, :2] += offset[:, :2] * (position == home)[:, None]
    trace("associated", poses)
    # half by ranges, half by end points: along a wall a range changes much, its end's distance little
    best = best_of_neighbourhoods(poses, np.argsort(cost), PATCH_M, PATCH_RAD, count // 2)
    by_ends = np.argsort(cost_at(site.coarse_walls, poses, _sliding(seen), SLIDE.first))
    best = best_of_neighbourhoods(poses, np.append(best, by_ends), PATCH_M, PATCH_RAD, count)
    trace("verified", poses[best])
    return poses[best], position[best], seeds.region[best]


def _slide(
    site: Site, view: SensorView, seen: Observation, seeds: _Seeds, count: int, trace: TraceCallback
) -> _Slid:
    """The best verified poses, `count` at most, after the coarse refinement."""
    verified, home, region = _verified(site, view, seen, seeds, count, trace)
    poses = fit(site.coarse_walls, verified, _sliding(seen), SLIDE).poses
    trace("slid", poses)
    return _Slid(poses, doubts(site, view, seen, poses, home), region)


def _weighed(site: Site, seen: Observation, slid: Array) -> tuple[Reading, Fit, Array, Array]:
    """Slid poses polished on the surfaces that the scan fits; their support, and shares of explained beams.

    Whether walls are as thick as they are drawn is the same for all beams: the place where the whole scan
    fits best shows. Not by its likelihood: what an ordinary place supports differs between the two.
    """
    found = [(reading, *_weighed_on(site, reading, seen, slid)) for reading in site.readings]
    return max(found, key=lambda each: float(each[2].max(initial=0.0)))


def _weighed_on(site: Site, reading: Reading, seen: Observation, slid: Array) -> tuple[Fit, Array, Array]:
    walls, caster, exactness = reading.walls, reading.caster, reading.exactness
    return weigh(walls, caster, site.drawn, slid, seen.points, seen.weighed, exactness)


def _weigh_promising(
    site: Site,
    seen: Observation,
    among: _Slid,
    projected: Projected,
    settings: ProjectorSettings,
    trace: TraceCallback,
    scope: Scope,
) -> Candidates:
    """What is published of slid poses: those best supported by the panoramas are polished and weighed."""
    order = np.argsort(among.doubts)
    best = best_of_neighbourhoods(among.poses, order, SAME_M, SAME_RAD, max(POLISHED, settings.published))
    slid, region = among.poses[best], among.region[best]
    trace("kept to polish", slid)
    reading, polished, supported, explained = _weighed(site, seen, slid)
    order = np.argsort(-supported)
    kept = best_of_neighbourhoods(polished.poses, order, SAME_M, SAME_RAD, settings.published)
    ordinary = max(ordinary_support(supported[kept], site.parts), scope.ordinary)
    trace("polished", polished.poses)
    poses, supports = polished.poses[kept], supported[kept]
    covariances, likelihood = _judged(site, seen, polished.information[kept], supports, ordinary)
    return Candidates(
        poses,
        covariances,
        likelihood,
        explained[kept],
        region[kept],
        projected,
        # of what was not searched nothing is known
        float(likelihood.min(initial=0.0)) if site.parts == 1 and scope.regions is None else 0.0,
        ordinary,
        surfaces=reading.surfaces,
        cut=len(kept) == settings.published,
    )


def _judged(
    site: Site, seen: Observation, information: Array, supports: Array, ordinary: float
) -> tuple[Array, Array]:
    """Covariances (n, 3, 3) and log-likelihoods (n,) of polished poses."""
    covariances = pose_covariances(information, site.inexactness)
    likelihoods = log_likelihood(supports, ordinary, seen.returned)
    return covariances, likelihoods - _spread(site, information, covariances)


def _spread(site: Site, information: Array, covariances: Array) -> Array | float:
    """Nats (n,) by which an inexact map spreads places over more poses: that makes none of them likelier."""
    if not site.inexactness:
        return 0.0
    exact = determinant_each(pose_covariances(information))
    spread: Array = 0.5 * np.log(determinant_each(covariances) / exact)
    return spread
