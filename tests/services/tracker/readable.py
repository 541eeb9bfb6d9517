"""How the tracker reads a list, and its step with it, in numpy: the oracle of the compiled form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.pose import FARTHEST_M
from eigenscan.tracker import branching
from eigenscan.tracker.association import Pairs, within_gate
from eigenscan.tracker.belief import CARRIED_SHARE, MISSES, Belief, Elsewhere, emerges, missed
from eigenscan.tracker.covariance import (
    determinant,
    is_covariance,
    log_density,
    log_volume,
    mahalanobis_squared,
    residual,
)
from eigenscan.tracker.evidence import (
    ALIASES,
    ALIKE_M,
    BEHIND,
    ENDS,
    HIDES,
    LEAD,
    LEAST_MASS,
    MOST,
    NEAR_M,
    NEAR_RAD,
    SHOWS,
    SLIP_M,
    SLIP_RAD,
    SLIP_SHARE,
    SLIPS,
    TOGETHER,
)
from eigenscan.tracker.observation import (
    GOOD,
    LOG_LIKELIHOOD_LIMIT,
    SIGMA_LIMITS,
    Observation,
    poorness,
)
from eigenscan.tracker.planar import Pose, between, compose, scaled
from eigenscan.tracker.prediction import motion_noise
from eigenscan.tracker.reckoning import Leg, Motions
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.share import Share
from eigenscan.tracker.symmetric import fuse_each, moments_of
from eigenscan.tracker.tracks import Tracks, begin, join, replace
from eigenscan.tracker.unification import SAME_DISTANCE2
from numpy.typing import NDArray
from scipy.special import expit

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Bools = NDArray[np.bool_]


def checked(
    rows: Array, trust: float, poorer: float, spacing: float, step: float
) -> tuple[Array, Array, Array, int]:
    """Poses, covariances and log-likelihoods of the rows (n, 10) that are poses; how many were replaced."""
    finite = np.isfinite(rows[:, :4]).all(axis=1) & (np.abs(rows[:, :2]) < FARTHEST_M).all(axis=1)
    rows = rows[finite]
    covariances = rows[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
    likelihoods = trust * rows[:, 3].clip(-LOG_LIKELIHOOD_LIMIT, LOG_LIKELIHOOD_LIMIT)
    good = is_covariance(covariances)
    grid = np.diag(np.array([spacing, spacing, step]) ** 2)
    covariances = np.where(good[:, None, None], covariances, grid)
    covariances = covariances * np.exp(poorer * (GOOD - likelihoods).clip(0.0, GOOD))[:, None, None]
    sigma = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    scale = sigma.clip(SIGMA_LIMITS[:, 0], SIGMA_LIMITS[:, 1]) / sigma
    limited = covariances * scale[:, :, None] * scale[:, None, :] + np.diag((0.05 * SIGMA_LIMITS[:, 0]) ** 2)
    poses = np.column_stack([rows[:, :2], wrap(rows[:, 2])])
    return poses, limited, likelihoods, int((~good).sum())


class Readable(Belief):
    """The belief, whose step with a list is the one below."""

    def observe(self, seen: Observation, share: Share) -> None:
        frame = self.frame_index(seen.frame, seen.area)
        source = self.source_index(seen.source, first=share.first)
        seen = seen.likelier_than_unlisted()
        rest = self.elsewhere
        shown = self.tracks.evidence.copy()
        shown[:, source] *= np.exp(-share.progress)
        tracks = release(replace(self.tracks, evidence=shown), rest, share.carried, self.off_map_share)
        if share.broken:
            tracks = release(tracks, rest, CARRIED_SHARE, self.off_map_share)
            rest.searched[:, source] = 0.0
            shown = tracks.evidence.copy()
            shown[:, source] = 0.0
            hidden, alias = tracks.hidden.copy(), np.zeros(len(tracks))
            hidden[:, source] = 0.5
            tracks = replace(tracks, evidence=shown, hidden=hidden, alias=alias)
        mine = tracks.frame == frame
        old, others = tracks.pick(mine), tracks.pick(~mine)
        merit = Merit.of(seen)
        pairs = associate(old.x, old.C, seen.poses, seen.covariances, self.gate)
        emerging = rest.searched[frame, source] * -np.expm1(-emerges(self.off_map_share) * share.progress)
        findable = 1.0 - rest.searched[frame, source] + emerging
        density = rest.log_weight[frame] + np.log(findable / (rest.area[frame] * 2.0 * np.pi))
        alone = merit.alone + log_volume(seen.covariances) + density
        alone = np.logaddexp(alone, slipped(old, seen, merit, pairs, share.progress))
        unchosen = (old.observations <= 0) | share.first
        first = merit.at_first(pairs, unchosen)
        grown = branch(old, seen, pairs, merit.of_pairs(pairs), first, source, share)
        begun = np.zeros((len(alone), len(self.sources)))
        begun[:, source] = merit.predicted
        alias = aliases_of(merit.predicted)
        grown = at_least(grown, len(old), pairs, alone, begun, alias)
        k, log_weight = births(grown, seen, pairs, alone)
        new = begin(seen.poses[k], seen.covariances[k], log_weight, alias[k], begun[k], frame, seen.stamp)
        self.tracks = share_aliases(join([others, grown, new]))
        if not share.in_part:
            rest.log_weight[frame] += np.log1p(np.expm1(missed(seen)) * emerging)
            left = (1.0 - rest.searched[frame, source]) * (1.0 - (1.0 - MISSES) * share.weight)
            rest.searched[frame, source] = 1.0 - left
        normalise(self)


def release(tracks: Tracks, rest: Elsewhere, share: float, off_map: float) -> Tracks:
    """Moves a share of the tracks' mass to "none"."""
    if not len(tracks) or share == 0.0 or len(rest.area) < 2:
        return tracks
    freed = share * np.exp(tracks.log_weight).sum()
    parts = np.where(rest.area > 0.0, (1.0 - off_map) * rest.area / rest.area.sum(), off_map)
    stayed = np.exp(rest.log_weight)
    rest.log_weight[:] = np.log(stayed + freed * parts)
    # no list was of the mass that came
    rest.searched *= (stayed / (stayed + freed * parts))[:, None]
    return replace(tracks, log_weight=tracks.log_weight + np.log1p(-share))


def come_back(rest: Elsewhere, share: float) -> None:
    """Moves a share of the mass off the map back onto it."""
    back = share * np.exp(rest.log_weight[0]) * rest.area[1:] / rest.area.sum()
    stayed = np.exp(rest.log_weight[1:])
    rest.log_weight[1:] = np.log(stayed + back)
    rest.searched[1:] *= (stayed / (stayed + back))[:, None]
    rest.log_weight[0] += np.log1p(-share)


def normalise(belief: Belief) -> None:
    """Makes all masses sum to 1; nothing left is that nothing is known."""
    total = np.logaddexp.reduce(np.concatenate([belief.tracks.log_weight, belief.elsewhere.log_weight]))
    if total == -np.inf:
        belief.elsewhere.log_weight[-1] = 0.0
        return
    belief.tracks = replace(belief.tracks, log_weight=belief.tracks.log_weight - total)
    belief.elsewhere.log_weight -= total


def settle(belief: Belief) -> None:
    """Keeps the most probable tracks, heaviest first; joins those of one place; gives numbers."""
    tracks, limits = belief.tracks, belief.settings
    order = np.argsort(-tracks.log_weight, kind="stable")[: limits.max_tracks]
    belief.tracks = tracks.pick(order[tracks.log_weight[order] > np.log(limits.prune_below)])
    normalise(belief)
    groups = places(belief.tracks)
    belief.tracks = join([merged(belief.tracks.pick(group)) for group in groups])
    unnamed = np.flatnonzero(belief.tracks.id == 0)
    belief.tracks.id[unnamed] = np.arange(belief.next_id, belief.next_id + len(unnamed))
    belief.next_id += len(unnamed)


def places(tracks: Tracks) -> list[Index]:
    """Greedy: the heaviest track takes all near it that are still free, then the next one."""
    off = residual(tracks.x[:, None], tracks.x[None])
    near = mahalanobis_squared(off, tracks.C[:, None] + tracks.C[None]) <= SAME_DISTANCE2
    near &= tracks.frame[:, None] == tracks.frame
    free, groups = np.ones(len(tracks), dtype=bool), list[Index]()
    for leader in range(len(tracks)):
        if free[leader]:
            groups.append(np.flatnonzero(near[leader] & free))
            free[groups[-1]] = False
    return groups or [np.zeros(0, dtype=np.intp)]


def merged(group: Tracks) -> Tracks:
    """One track with the moments of all, under the name of the heaviest that has one.

    So it is where a scan last fixed the heaviest: there, too, it has the moments of all.
    """
    if len(group) < 2:
        return group
    weight = np.exp(group.log_weight - group.log_weight[0])
    shown = weight[:, None] * (1.0 - group.hidden)
    x, C = moments_of(group.x, group.C, weight)
    fixed_x, fixed_covariance = moments_of(*where_fixed(group), weight)
    known = shown.sum(axis=0)
    mean = (shown * group.evidence).sum(axis=0) / np.where(known > 0.0, known, 1.0)
    evidence = np.where(known > 0.0, mean, group.evidence[0])
    named = np.flatnonzero(group.id > 0)[:1]
    own = replace(group.pick(np.array([0])), observations=group.observations[:1])
    if len(named):
        names = {name: getattr(group, name)[named] for name in ("id", "parent", "born")}
        own = replace(own, observations=group.observations.max(keepdims=True), **names)
    return replace(
        own,
        x=x[None],
        C=C[None],
        log_weight=group.log_weight[:1] + np.log(weight.sum()),
        hidden=(weight @ group.hidden / weight.sum())[None],
        alias=group.alias.sum(axis=0)[None],
        evidence=evidence[None],
        fixed_x=fixed_x[None],
        fixed_covariance=fixed_covariance[None],
    )


def where_fixed(group: Tracks) -> tuple[Array, Array]:
    """Poses and covariances of all when a scan last fixed the first; others go back by its motion since."""
    since = between(pose_of(group.x[0]), pose_of(group.fixed_x[0]))
    back, C = carry(group.x, group.C, since, np.zeros((3, 3)))
    same = group.fixed_at == group.fixed_at[0]
    return (
        np.where(same[:, None], group.fixed_x, back),
        np.where(same[:, None, None], group.fixed_covariance, C),
    )


def pose_of(row: Array) -> Pose:
    """A row (3,) as plain numbers."""
    x, y, theta = row.tolist()
    return x, y, theta


def leads(seen: Observation) -> Array:
    """By how many nats (k,) hypotheses are ahead of the next place; those of other places behind the best."""
    if not len(seen.poses):
        return np.zeros(0)
    off = residual(seen.poses, seen.poses[np.argmax(seen.log_likelihoods)])
    there = (np.hypot(off[:, 0], off[:, 1]) <= NEAR_M) & (np.abs(off[:, 2]) <= NEAR_RAD)
    next_place = seen.log_likelihoods[~there].max(initial=seen.unlisted)
    lead: Array = seen.log_likelihoods - np.where(there, next_place, seen.log_likelihoods.max())
    return lead


def together(seen: Observation) -> Array:
    """What it is worth (k,) that a place and others are ahead of the rest together, nats."""
    place, best = np.full(len(seen.poses), -1), list[float]()
    for k in np.argsort(-seen.log_likelihoods, kind="stable"):
        if place[k] >= 0:
            continue
        off = residual(seen.poses, seen.poses[k])
        there = (np.hypot(off[:, 0], off[:, 1]) <= NEAR_M) & (np.abs(off[:, 2]) <= NEAR_RAD)
        place[there & (place < 0)] = len(best)
        best.append(seen.log_likelihoods[k])
    if len(best) < 2:
        return np.zeros(len(place))
    size = np.arange(2, len(best))
    worth = (TOGETHER * (np.array(best[1:-1]) - np.array(best[2:]))).clip(max=MOST) - np.log(size)
    of_place = [worth[max(0, own - 1) :].max(initial=0.0) for own in range(len(best))]
    return np.array(of_place)[place]


@dataclass(frozen=True)
class Merit:
    """What the hypotheses (k,) of a list are worth, in nats.

    `alone`: ln p(list | the robot is there) / p(list | it is off the map), for a pose that nothing predicted.
    `predicted`: ln p(hypothesis | its track is right) / p(hypothesis | it is wrong), where a track was just
    there.
    """

    alone: Array
    predicted: Array

    @classmethod
    def of(cls, seen: Observation) -> Merit:
        """Both follow from likelihoods, and from how far the best is ahead of other places."""
        lead = leads(seen)
        # that a poor fit may be of more poses makes the place no likelier
        spread = 1.5 * poorness(seen.log_likelihoods)
        predicted = np.where(lead > 0.0, LEAD, BEHIND) * lead + together(seen)
        return cls(seen.log_likelihoods + lead.clip(0.0, MOST) - spread, predicted.clip(-MOST, MOST))

    def of_pairs(self, pairs: Pairs) -> Array:
        """What each pair (p,) of a track and a hypothesis in its gate is worth.

        For a vague track, the hypothesis' own likelihood spread over all the track's room is less.
        """
        return np.minimum(self.predicted[pairs.hypothesis] - 0.5 * pairs.distance2, self._alone_of(pairs))

    def at_first(self, pairs: Pairs, unchosen: Bools) -> Array:
        """What it is worth more (p,) to tracks (n,) that no scan of this lidar chose.

        The first one counts as it does for a place that begins a track.
        """
        more = (self._alone_of(pairs) - self.of_pairs(pairs)).clip(min=0.0)
        return np.where(unchosen[pairs.track], more, 0.0)

    def _alone_of(self, pairs: Pairs) -> Array:
        result: Array = self.alone[pairs.hypothesis] + pairs.log_overlap
        return result


def hide_and_show(hidden: Array, progress: float) -> Array:
    """Hidden shares (n,) after a robot moved on by `progress`, 1: a scan is new evidence."""
    hides, shows = -np.expm1(-HIDES * progress), -np.expm1(-SHOWS * progress)
    result: Array = hidden * (1.0 - shows) + (1.0 - hidden) * hides
    return result


def aliases_of(predicted: Array) -> Array:
    """How many (k,) of the wrong tracks that such hypotheses begin are aliases; `predicted` as in `Merit`."""
    result: Array = expit(np.log(ALIASES / (1.0 - ALIASES)) + predicted)
    return result


def aliases_go_on(alias: Array, progress: float) -> Array:
    """Aliases (n,) after a robot moved on by `progress`, 1: a scan is new evidence; see `Tracks`."""
    stay = np.exp(-ENDS * progress)
    result: Array = alias * stay + ALIASES * (1.0 - alias.sum()).clip(min=0.0) * (1.0 - stay)
    return result


def share_aliases(tracks: Tracks) -> Tracks:
    """The same tracks, of which at most one is an alias."""
    return replace(tracks, alias=tracks.alias / tracks.alias.sum().clip(min=1.0))


def explained_by_aliases(alias: Array, gained: Array, elsewhere: Array) -> tuple[float, Array, Array]:
    """How much likelier aliases make a scan, in nats, where no track (n,) is right.

    Then the same (n,) where each track is right, but hidden; and the aliases (n,) after the scan.
    Of an alias it is as likely as of a right track, `gained` (n,): what looked right goes on looking right.
    One that another source shows may be hidden from this one, with the probability `elsewhere` (n,).
    """
    odds = alias * (elsewhere + (1.0 - elsewhere) * np.exp(gained))
    total = (1.0 - alias.sum()).clip(min=1e-12) + odds.sum()
    others = (total - odds) / (1.0 - alias).clip(min=1e-12)
    return float(np.log(total)), np.log(others.clip(min=1e-12)), odds / total


def present_evidence(tracks: Tracks) -> Array:
    """The present place's evidence for each track (n,), >= 0.

    If the robot slipped just now, the track is shown where it was predicted by chance:
    then this evidence does not count.
    """
    result: Array = tracks.evidence.clip(min=0.0).sum(axis=1)
    return result


def slipped(tracks: Tracks, seen: Observation, merit: Merit, pairs: Pairs, progress: float = 0.0) -> Array:
    """Ln of the mass of tracks whose wheels have slipped, to each of the hypotheses (k,) seen.

    A track has not slipped to those in its gate, `pairs`. As there, a hypothesis nearby is worth no more
    than how much oftener a right track gets one than a wrong track does. The farther the robot came since the
    last list, the likelier it slipped.
    """
    log_mass = tracks.log_weight - present_evidence(tracks)
    sigma = np.array([SLIP_M, SLIP_M, SLIP_RAD]) + SLIP_SHARE * tracks.unchecked[:, [2, 2, 3]]
    spread = tracks.C + sigma[:, :, None] ** 2 * np.eye(3)
    total = spread[:, None] + seen.covariances[None]
    off = residual(seen.poses[None], tracks.x[:, None])
    # the hypothesis' volume by the density that the slipped track has there
    overlap = log_density(off, total) + log_volume(seen.covariances)
    mass = log_mass[:, None] + np.minimum(merit.predicted, merit.alone + overlap)
    mass[log_mass <= LEAST_MASS] = -np.inf
    mass[pairs.track, pairs.hypothesis] = -np.inf
    share = -np.expm1(-SLIPS * max(progress, 1.0))
    result: Array = np.log(share) + np.logaddexp.reduce(mass, axis=0, initial=-np.inf)
    return result


def branch(
    old: Tracks, seen: Observation, pairs: Pairs, worth: Array, first: Array, source: int, share: Share
) -> Tracks:
    """Each track once as predicted, then for each hypothesis in its gate, a pair `worth` (p,) nats.

    `first` (p,): what a pair is worth once, on top, for a track without observations. A hidden track has no
    hypothesis; one that is shown has one of its gate, or hardly ever none.
    """
    count = len(old)
    origin = np.concatenate([np.arange(count), pairs.track])
    # a projector of a part of the site is no evidence on tracks elsewhere
    silent = (old.evidence[:, source] == 0.0) & share.in_part
    fit = np.concatenate([np.where(silent, 0.0, missed(seen)), worth])
    total, preference = np.full(count, -np.inf), np.full(count, -np.inf)
    np.logaddexp.at(total, origin, fit)
    # which of several hypotheses is the track's: scans from one place repeat each other's preference
    np.logaddexp.at(preference, origin, share.weight * fit)
    evidence = old.evidence.copy()
    gained = share.weight * (total - evidence[:, source])
    evidence[:, source] += gained
    hidden = hide_and_show(old.hidden[:, source], share.progress)
    before = aliases_go_on(old.alias, share.progress)
    by_others = np.delete(1.0 - old.hidden, source, axis=1).max(axis=1, initial=0.0)
    explained, of_others, alias = explained_by_aliases(before, gained, hidden * by_others)
    with np.errstate(divide="ignore"):
        shown = old.log_weight + np.log1p(-hidden) + gained - explained
        unseen = old.log_weight + np.log(hidden) + of_others - explained
    part = share.weight * fit - preference[origin]
    log_weight = shown[origin] + part
    log_weight[count:] += first
    log_weight[:count] = np.logaddexp(log_weight[:count], unseen)
    branches = old.pick(origin)
    hidden_share = branches.hidden.copy()
    hidden_share[:, source] = 0.0
    hidden_share[:count, source] = np.exp(unseen - log_weight[:count])
    id_, parent = _forks(branches, log_weight, origin)
    weighed = replace(
        branches,
        log_weight=log_weight,
        hidden=hidden_share,
        alias=alias[origin] * np.exp(part),
        evidence=evidence[origin],
        id=id_,
        parent=parent,
    )
    return fused(weighed, count, seen, widened(seen), pairs, share.precision)


def associate(x: Array, C: Array, y: Array, R: Array, gate: float) -> Pairs:
    """Pairs of tracks (n, 3), (n, 3, 3) and hypotheses (k, 3), (k, 3, 3) with distance^2 <= `gate`."""
    return Pairs(*within_gate(x, C, y, R, gate))


def follow(tracks: Tracks, seen: Observation, gate: float, precision: float) -> Tracks:
    """Tracks brought to the nearest pose of a local list in their gates, with the masses that they had."""
    pairs = associate(tracks.x, tracks.C, seen.poses, seen.covariances, gate)
    order = np.lexsort((pairs.distance2, pairs.track))
    _, first = np.unique(pairs.track[order], return_index=True)
    k = order[first]
    own = Pairs(pairs.track[k], pairs.hypothesis[k], pairs.distance2[k], pairs.log_overlap[k])
    others = np.setdiff1d(np.arange(len(tracks)), own.track)
    rows = np.concatenate([others, own.track])
    joined = fused(tracks.pick(rows), len(others), seen, seen.covariances, own, precision)
    return joined.pick(np.argsort(rows))


def fused(
    branches: Tracks, alone: int, seen: Observation, covariances: Array, pairs: Pairs, precision: float
) -> Tracks:
    """Branches after the first `alone`, brought together with their hypotheses of these covariances."""
    joined = slice(alone, None)
    x, C, nis = branches.x.copy(), branches.C.copy(), branches.nis.copy()
    R = covariances[pairs.hypothesis]
    R /= independent_share(C[joined], R, precision)[:, None, None]
    x[joined], C[joined] = fuse_each(x[joined], C[joined], seen.poses[pairs.hypothesis], R)
    unchecked, observations = branches.unchecked.copy(), branches.observations.copy()
    unchecked[joined], nis[joined] = 0.0, pairs.distance2
    observations[joined] += 1
    fixed_x, fixed_covariance, fixed_at = (
        branches.fixed_x.copy(),
        branches.fixed_covariance.copy(),
        branches.fixed_at.copy(),
    )
    fixed_x[joined], fixed_covariance[joined], fixed_at[joined] = x[joined], C[joined], seen.stamp
    return replace(
        branches,
        x=x,
        C=C,
        fixed_x=fixed_x,
        fixed_covariance=fixed_covariance,
        fixed_at=fixed_at,
        unchecked=unchecked,
        nis=nis,
        observations=observations,
    )


def widened(seen: Observation) -> Array:
    """Covariances (k, 3, 3) with the spread of what lies nearby with one heading, weighed by likelihood."""
    off = residual(seen.poses[None], seen.poses[:, None])
    near = (np.hypot(off[..., 0], off[..., 1]) <= ALIKE_M) & (np.abs(off[..., 2]) <= NEAR_RAD)
    weight = np.where(near, np.exp(seen.log_likelihoods[None] - seen.log_likelihoods[:, None]), 0.0)
    spread = np.einsum("ki,kia,kib->kab", weight / weight.sum(axis=1, keepdims=True), off, off)
    return np.asarray(seen.covariances + spread)


def at_least(
    grown: Tracks, alone: int, pairs: Pairs, log_mass: Array, evidence: Array, alias: Array
) -> Tracks:
    """Branches after the first `alone`, each with at least the mass (k,) of its hypothesis alone.

    A track that was begun on a poor scan must not keep a good one from counting. The likeliest branch of a
    hypothesis takes it, with the `evidence` (k, sources) and `alias` (k,) of a track that begins: with a
    poor scan's it would gain from the next one what it has already, and get ahead of a place that looks the
    same and had no track.
    """
    log_weight = grown.log_weight.copy()
    joined = log_weight[alone:]
    best = np.full(len(log_mass), -np.inf)
    np.maximum.at(best, pairs.hypothesis, joined)
    raised = np.flatnonzero((joined == best[pairs.hypothesis]) & (joined < log_mass[pairs.hypothesis]))
    k = pairs.hypothesis[raised]
    own = np.exp(joined[raised] - log_mass[k])
    joined[raised] = log_mass[k]
    evidences, aliases, rows = grown.evidence.copy(), grown.alias.copy(), raised + alone
    evidences[rows] = own[:, None] * evidences[rows] + (1.0 - own)[:, None] * evidence[k]
    aliases[rows] = own * aliases[rows] + (1.0 - own) * alias[k]
    return replace(grown, log_weight=log_weight, evidence=evidences, alias=aliases)


def births(tracks: Tracks, seen: Observation, pairs: Pairs, log_mass: Array) -> tuple[Index, Array]:
    """Hypotheses (n,) outside of all gates that begin tracks, and these tracks' masses as logarithms (n,).

    `log_mass` (k,): what each hypothesis has by itself, of robots that were carried there or slipped.
    """
    free = np.ones(len(seen.poses), dtype=bool)
    free[pairs.hypothesis] = False
    k = np.flatnonzero(free)
    x, C, log_weight = seen.poses[k], seen.covariances[k], log_mass[k]
    # those that could not live through this scan are not begun
    heaviest = max(tracks.log_weight.max(initial=-np.inf), log_weight.max(initial=-np.inf))
    alive = log_weight > heaviest + branching.LEAST_BORN
    return k[alive], log_weight[alive] - np.log(crowding(x[alive], C[alive]))


def crowding(y: Array, R: Array) -> Array:
    """How many hypotheses (k, 3), (k, 3, 3) share each one's place, itself included; shape (k,), >= 1.

    Overlapping hypotheses describe one peak of the likelihood; dividing by this counts the peak once.
    """
    pairs = associate(y, R, y, R, gate=50.0)
    # under R + R the squared distance is half of what it is under R
    return np.bincount(pairs.track, weights=np.exp(-pairs.distance2), minlength=len(y)).clip(min=1.0)


def _forks(branches: Tracks, log_weight: Array, origin: Index) -> tuple[Index, Index]:
    """Ids and parents: the likeliest branch stays the track, the others fork from it, yet unnamed (0)."""
    order = np.lexsort((-log_weight, origin))
    first = np.ones(len(order), dtype=bool)
    first[1:] = origin[order][1:] != origin[order][:-1]
    forked = np.ones(len(order), dtype=bool)
    forked[order[first]] = False
    return np.where(forked, 0, branches.id), np.where(forked, branches.id, branches.parent)


def independent_share(C: Array, R: Array, progress: float) -> Array:
    """Share (p,) of a hypothesis' information that a track does not have yet; for (p, 3, 3) each.

    Scans from one place err alike: a track as sure as one scan learns only what motion makes new. One
    that prediction has made vaguer than a scan takes all of it.
    """
    known = np.cbrt(determinant(R) / determinant(C))
    return np.clip(1.0 - known, max(progress, 1e-3), 1.0)


def carry(x: Array, C: Array, delta: tuple[float, float, float], Q: Array) -> tuple[Array, Array]:
    """Poses (n, 3) and covariances (n, 3, 3) after an increment, its noise Q (3, 3) in the base frame."""
    cos, sin = np.cos(x[:, 2]), np.sin(x[:, 2])
    F, G = np.tile(np.eye(3), (2, len(x), 1, 1))
    F[:, 0, 2], F[:, 1, 2] = -sin * delta[0] - cos * delta[1], cos * delta[0] - sin * delta[1]
    G[:, :2, :2] = np.stack([cos, -sin, sin, cos], axis=1).reshape(-1, 2, 2)
    moved = np.stack([x[:, 0] + F[:, 1, 2], x[:, 1] - F[:, 0, 2], wrap(x[:, 2] + delta[2])], axis=1)
    return moved, F @ C @ F.mT + G @ Q @ G.mT


def correct(tracks: Tracks, way: Leg, now: int, motions: Motions, settings: TrackerSettings) -> Tracks:
    """The tracks, predicted to `now`, as if odometry had been what it and the scans give together.

    Those that a hypothesis confirmed later stay as they are.
    """
    open_ = tracks.fixed_at < way.stamp
    if not open_.any():
        return tracks
    fixed_x, fixed_covariance, fixed_at = (
        tracks.fixed_x.copy(),
        tracks.fixed_covariance.copy(),
        tracks.fixed_at.copy(),
    )
    x, C = tracks.x.copy(), tracks.C.copy()
    for at in np.unique(fixed_at[open_]).tolist():
        these = fixed_at == at
        begun = max(at, way.since)
        if at < begun:
            moved = motions(at, begun)
            fixed_x[these], fixed_covariance[these] = carry(
                fixed_x[these], fixed_covariance[these], moved.delta, np.diag(motion_noise(moved, settings))
            )
        share = (way.stamp - begun) / (way.stamp - way.since)
        delta = way.delta
        if begun > way.since:
            delta = compose(motions(begun, way.stamp).delta, scaled(way.correction, share))
        fixed_x[these], fixed_covariance[these] = carry(
            fixed_x[these], fixed_covariance[these], delta, way.noise * share
        )
    fixed_at[open_] = way.stamp
    rest = motions(way.stamp, now)
    x[open_], C[open_] = carry(
        fixed_x[open_], fixed_covariance[open_], rest.delta, np.diag(motion_noise(rest, settings))
    )
    return replace(tracks, x=x, C=C, fixed_x=fixed_x, fixed_covariance=fixed_covariance, fixed_at=fixed_at)
