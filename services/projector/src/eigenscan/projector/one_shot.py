"""Answers a query for one scan: candidates, their probabilities, and that of all other places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from eigenscan.eigenspace.floors import Floor, floor_of
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.doubtful_ranges import not_in_metres, one_value
from eigenscan.geometry.message_floats import floats_of
from eigenscan.geometry.normalize import (
    FARTHEST_MOUNT,
    FAULTS,
    MOST_BEAMS,
    ScanError,
    Sweep,
    limit,
    limits,
    orient,
    own_beams,
)
from eigenscan.geometry.pose import compose, covariance_to_message, from_message, to_message
from eigenscan.projector.candidates import Candidates
from eigenscan.projector.focus import Reach, Scope
from eigenscan.projector.observation import Observation, observe
from eigenscan.projector.projection import find_candidates
from eigenscan.projector.publishing import to_base
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import SensorView, Site
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.localize_pb2 import LocalizeCandidate, LocalizeQuery, LocalizeReply
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

REACH = 3.0
"""m from the base to the sensor at most, unless its mount is farther: regions this far outside of the allowed
ones are searched too."""
_FAULTS = FAULTS | {"too_many_beams": f"ranges: more than {MOST_BEAMS} beams"}


class QueryError(ValueError):
    """A query that cannot be answered; the message names the field."""


@dataclass(frozen=True)
class Allowed:
    """Allowed poses of the robot. `near` (3,): map frame. `regions` (R,): searched regions; None: all."""

    near: Array | None
    radius: float
    turn: float
    floor: Floor | None
    region: str
    regions: Flags | None

    @classmethod
    def of(cls, query: LocalizeQuery, mount: Array, site: Site) -> Allowed:
        """The limits in a query; `mount` (3,): the sensor in the base frame. Raises QueryError."""
        floor = _floor(query.floor, site.floors)
        near = _near(query, floor)
        if query.region and query.region not in site.regions:
            raise QueryError(f"region: {query.region!r:.80} is none of the {len(site.regions)} of this map")
        kept = np.ones(len(site.boxes), dtype=bool)
        if query.region:
            kept &= np.array(site.regions) == query.region
        if floor is not None:
            centres = site.boxes.reshape(-1, 2, 2).mean(axis=1)
            kept &= np.array([floor.holds([*centre, 0.0]) for centre in centres], dtype=bool)
        if near is not None:
            kept &= Reach(
                float(near[0]), float(near[1]), query.radius + max(REACH, math.hypot(mount[0], mount[1]))
            ).regions(site.boxes)
        if not kept.any():
            raise QueryError("near, radius, floor, region: no part of the map is in all of them")
        turn = query.turn or math.pi
        return cls(near, query.radius, turn, floor, query.region, None if kept.all() else kept)

    def holds(self, poses: Array, regions: Sequence[str]) -> Flags:
        """Which base poses (n, 3), found in `regions`, are allowed (n,)."""
        kept = np.ones(len(poses), dtype=bool)
        if self.near is not None:
            away = np.hypot(*(poses[:, :2] - self.near[:2]).T)
            kept &= (away <= self.radius) & (np.abs(wrap(poses[:, 2] - self.near[2])) <= self.turn)
        if self.floor is not None:
            kept &= np.array([self.floor.holds(pose) for pose in poses], dtype=bool)
        if self.region:
            kept &= np.array([region == self.region for region in regions], dtype=bool)
        return kept

    def area(self, site: Site, waiting: Flags | None = None) -> float:
        """Free area, m2, less that of regions `waiting` (R,)."""
        regions = self.regions
        if waiting is not None and waiting.any():
            regions = ~waiting if regions is None else regions & ~waiting
        area = site.area(regions)
        return area if self.near is None else min(area, math.pi * self.radius * self.radius)


def answer(
    query: LocalizeQuery, site: Site, settings: ProjectorSettings, *, whole: bool = False
) -> LocalizeReply:
    """Candidates of one scan; `whole`: once all regions are ready. Raises QueryError naming the field."""
    scan = canonical(query.scan)
    seen, mount = observe(scan), from_message(scan.mount)
    allowed = Allowed.of(query, mount, site)
    reply = LocalizeReply(
        timestamp=query.scan.timestamp,
        frame_id=site.frame_id,
        model_version=site.version,
        asked_area_m2=allowed.area(site),
        none_probability=1.0,
    )
    if seen.measured < settings.least_beams:
        reply.status = Hypotheses.STATUS_UNUSABLE_SCAN
        return reply
    view = site.view(seen.sensor, passing=True)
    found = _search(site, view.complete() if whole else view, seen, settings, allowed)
    reply.status = Hypotheses.STATUS_OK
    reply.searched_area_m2 = allowed.area(site, found.waiting)
    poses, covariances = to_base(found.poses, found.covariances, mount)
    regions = [site.regions[r] for r in found.region]
    kept = np.flatnonzero(allowed.holds(poses, regions))
    prior = reply.searched_area_m2 * 2.0 * allowed.turn
    likelihoods = found.log_likelihoods[kept]
    probabilities = posterior(likelihoods, covariances[kept], prior, found.unlisted_log_likelihood)
    for k, probability in list(zip(kept.tolist(), probabilities.tolist(), strict=True))[: query.most or None]:
        added = reply.candidates.add(
            pose=to_message(poses[k]),
            covariance=covariance_to_message(covariances[k]),
            log_likelihood=found.log_likelihoods[k],
            probability=probability,
            region=regions[k],
        )
        reply.none_probability -= probability
        _locate(added, poses[k], site.floors)
    reply.none_probability = max(reply.none_probability, 0.0)
    return reply


def posterior(log_likelihoods: Array, covariances: Array, prior: float, unlisted: float) -> Array:
    """Probabilities (n,) of poses, where the robot is as likely off the map as on it.

    On it every pose is alike in `prior`, m2 rad, of which a pose has the share of its own volume,
    (2 pi)^3/2 sqrt|C|. `unlisted`: ln likelihood of all others.
    """
    shares = 1.5 * np.log(2.0 * np.pi) + 0.5 * np.linalg.slogdet(covariances)[1] - np.log(max(prior, 1e-9))
    odds = log_likelihoods + np.minimum(shares, 0.0)
    result: Array = np.exp(odds - np.logaddexp.reduce([*odds, 0.0, unlisted]))
    return result


def canonical(raw: RawScan) -> Scan:
    """A driver's scan as the contract's. Raises QueryError naming the field."""
    try:
        if not len(raw.ranges):
            raise ScanError("no_beams")
        if len(raw.ranges) > MOST_BEAMS:
            raise ScanError("too_many_beams")
        if not all(abs(value) <= FARTHEST_MOUNT for value in (raw.mount.x, raw.mount.y, raw.mount.theta)):
            raise ScanError("mount_too_far")
        low, high = limits(raw.range_min, raw.range_max)
        ranges = floats_of(raw, "ranges")
        if not_in_metres(ranges):
            raise ScanError("not_in_metres")
        sweep = orient(Sweep(ranges, raw.angle_min, raw.angle_increment), raw.upside_down)
        sweep = own_beams(Sweep(limit(sweep.ranges, low, high), sweep.angle_min, sweep.angle_increment))
        if np.isnan(sweep.ranges).all():
            raise ScanError("no_valid_range")
        if one_value(sweep.ranges, sweep.angle_increment):
            raise ScanError("one_value")
    except ScanError as error:
        raise QueryError(f"scan.{_FAULTS[error.reason]}") from None
    return Scan(
        timestamp=raw.timestamp,
        mount=raw.mount,
        angle_min=sweep.angle_min,
        angle_increment=sweep.angle_increment,
        range_min=low,
        range_max=high,
        ranges=sweep.ranges.tolist(),
    )


def _search(
    site: Site, view: SensorView, seen: Observation, settings: ProjectorSettings, allowed: Allowed
) -> Candidates:
    """The whole site first, also where only some regions may be right: what an ordinary place there has."""
    found = find_candidates(site, view, seen, settings)
    if allowed.regions is None:
        return found
    return find_candidates(site, view, seen, settings, scope=Scope(allowed.regions, found.ordinary))


def _floor(name: str, floors: Sequence[Floor]) -> Floor | None:
    if not name:
        return None
    for floor in floors:
        if floor.name == name:
            return floor
    known = ", ".join(repr(floor.name) for floor in floors) or "no floors"
    raise QueryError(f"floor: {name!r:.80} is not of this map; it has {known}")


def _near(query: LocalizeQuery, floor: Floor | None) -> Array | None:
    if not (math.isfinite(query.turn) and query.turn >= 0.0):
        raise QueryError(f"turn: {query.turn} rad; must be finite, 0 or more")
    if not query.HasField("near"):
        if query.radius or query.turn:
            raise QueryError("near: missing; radius and turn are about it")
        return None
    near: Array = from_message(query.near)
    if not np.isfinite(near).all():
        raise QueryError("near: not finite; m, m, rad in the map frame")
    if not (math.isfinite(query.radius) and query.radius > 0.0):
        raise QueryError(f"radius: {query.radius} m; must be finite and above 0")
    return near if floor is None else compose(floor.origin, near)


def _locate(candidate: LocalizeCandidate, pose: Array, floors: Sequence[Floor]) -> None:
    floor = floor_of(floors, pose)
    if floor is not None:
        candidate.floor = floor.name
        candidate.floor_pose.CopyFrom(to_message(floor.own(pose)))
