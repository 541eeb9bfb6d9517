"""What becomes of each track with a scan: it goes on alone, with a hypothesis of its gate, or one begins.

Paper, section 7: association, fork when two poses fit one track, recursive estimation, new tracks.
"""

from __future__ import annotations

import numpy as np
from eigenscan.tracker.association import Pairs, crowding
from eigenscan.tracker.covariance import determinant, fuse
from eigenscan.tracker.evidence import (
    SHOWN_YET_MISSED,
    aliases_go_on,
    explained_by_aliases,
    hide_and_show,
    surprise,
)
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.share import Share
from eigenscan.tracker.tracks import Tracks, replace
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

LEAST_BORN = float(np.log(1e-9))
"""Mass of a new track over the heaviest's, below which it is not begun."""


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
    fit = np.concatenate([np.where(silent, 0.0, SHOWN_YET_MISSED), worth])
    total, preference = np.full(count, -np.inf), np.full(count, -np.inf)
    np.logaddexp.at(total, origin, fit)
    # which of several hypotheses is the track's: scans from one place repeat each other's preference
    np.logaddexp.at(preference, origin, share.weight * fit)
    evidence = old.evidence.copy()
    gained = share.weight * (total - evidence[:, source])
    evidence[:, source] += gained
    explained, of_others, alias = explained_by_aliases(aliases_go_on(old.alias, share.progress), gained)
    hidden = hide_and_show(old.hidden, share.progress)
    with np.errstate(divide="ignore"):
        shown = old.log_weight + np.log1p(-hidden) + gained - explained
        unseen = old.log_weight + np.log(hidden) + of_others - explained
    part = share.weight * fit - preference[origin]
    log_weight = shown[origin] + part
    log_weight[count:] += first
    log_weight[:count] = np.logaddexp(log_weight[:count], unseen)
    hidden_share = np.zeros(len(origin))
    hidden_share[:count] = np.exp(unseen - log_weight[:count])
    branches = old.pick(origin)
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
    return fused(weighed, count, seen, pairs, share.precision)


def fused(branches: Tracks, alone: int, seen: Observation, pairs: Pairs, precision: float) -> Tracks:
    """Branches after the first `alone`, brought together with their hypotheses."""
    joined = slice(alone, None)
    x, C, nis = branches.x.copy(), branches.C.copy(), branches.nis.copy()
    R = seen.covariances[pairs.hypothesis]
    C[joined] *= surprise(pairs.distance2)[:, None, None]
    share = independent_share(C[joined], R, precision)
    x[joined], C[joined] = fuse(x[joined], C[joined], seen.poses[pairs.hypothesis], R / share[:, None, None])
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


def at_least(
    grown: Tracks, alone: int, pairs: Pairs, log_mass: Array, evidence: Array, alias: Array
) -> Tracks:
    """Branches after the first `alone`, each with at least the mass (k,) of its hypothesis alone.

    A track that was begun on a poor scan must not keep a good one from counting. The likeliest branch of a
    hypothesis takes it, with the `evidence` (k, sources) and the `alias` (k,) of a track that begins: with a
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
    alive = log_weight > heaviest + LEAST_BORN
    return k[alive], log_weight[alive] - np.log(crowding(x[alive], C[alive]))


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
