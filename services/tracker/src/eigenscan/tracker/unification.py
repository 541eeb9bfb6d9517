"""Keeps the set of tracks small: pruning, a bound on their number, unification (paper, section 7)."""

from __future__ import annotations

import numpy as np
from eigenscan.tracker.association import associate
from eigenscan.tracker.belief import Belief
from eigenscan.tracker.symmetric import moments_of
from eigenscan.tracker.tracks import replace
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SAME_DISTANCE2 = 4.0
"""Squared Mahalanobis distance under C1 + C2 within which two tracks are one."""


def prune(belief: Belief) -> None:
    """Ends tracks below the least probability and beyond the greatest number; the rest share all mass.

    The rest is sorted, most probable first.
    """
    tracks, settings = belief.tracks, belief.settings
    order = np.argsort(-tracks.log_weight, kind="stable")[: settings.max_tracks]
    order = order[tracks.log_weight[order] > np.log(settings.prune_below)]
    belief.tracks = tracks.pick(order)
    belief.normalise()


def unify(belief: Belief) -> None:
    """Joins tracks that describe one place into the heaviest of them. Expects them sorted, heaviest first."""
    tracks = belief.tracks
    pairs = associate(tracks.x, tracks.C, tracks.x, tracks.C, SAME_DISTANCE2)
    if len(pairs.track) == len(tracks):
        return  # each is alone with itself
    leader = _leaders(pairs.track, pairs.hypothesis, tracks.frame)
    heads = np.flatnonzero(leader == np.arange(len(tracks)))
    of_groups = _merged(
        leader, heads, tracks.x, tracks.C, tracks.log_weight, tracks.hidden, tracks.alias, tracks.evidence,
        tracks.id, tracks.parent, tracks.born, tracks.observations,
    )  # fmt: skip
    result = replace(tracks.pick(heads), **dict(zip(_MERGED, of_groups, strict=True)))
    joined = np.bincount(leader, minlength=len(tracks))[heads] > 1
    result.fixed_x[joined], result.fixed_covariance[joined] = result.x[joined], result.C[joined]
    result.fixed_at[joined] = belief.stamp or 0
    belief.tracks = result


@njit("i8[::1](i8[:], i8[:], i8[:])", cache=True)  # pragma: no cover - compiled
def _leaders(track: Index, near: Index, frame: Index) -> Index:
    """Greedy: the heaviest track leads all near it that are still free, then the next one; (n,) indices.

    Pairs of a `track` and one `near` it (p,), sorted by both.
    """
    leader = np.full(len(frame), -1, dtype=np.int64)
    for pair in range(len(track)):
        one, other = track[pair], near[pair]
        # one that leads or is led is no leader of others: its own pair comes after those with heavier ones
        if leader[one] < 0:
            leader[one] = one
        if leader[one] == one and leader[other] < 0 and frame[one] == frame[other]:
            leader[other] = one
    return leader


_MERGED = ("x", "C", "log_weight", "hidden", "alias", "evidence", "id", "parent", "born", "observations")
_ARRAYS = "f8[:,::1], f8[:,:,::1], f8[::1], f8[::1], f8[::1], f8[:,::1], i8[::1], i8[::1], i8[::1], i8[::1]"


@njit(f"Tuple(({_ARRAYS}))(i8[::1], i8[:], {_ARRAYS.replace('::1', ':')})", cache=True)  # pragma: no cover
def _merged(
    leader: Index, heads: Index, x: Array, C: Array, log_weight: Array, hidden: Array, alias: Array,
    evidence: Array, id_: Index, parent: Index, born: Index, observations: Index,
) -> tuple[Array | Index, ...]:  # fmt: skip
    """One track for each of `heads`, with the moments of those that it leads.

    A group goes on under the name of its heaviest member that has one.
    """
    own = (x[heads], C[heads], log_weight[heads], hidden[heads], alias[heads], evidence[heads])
    named = (id_[heads], parent[heads], born[heads], observations[heads])
    for row in range(len(heads)):
        group = np.flatnonzero(leader == heads[row])
        if len(group) == 1:
            continue
        heaviest = log_weight[group].max()
        weight = np.exp(log_weight[group] - heaviest)
        total = weight.sum()
        own[0][row], own[1][row] = moments_of(x[group], C[group], weight)
        own[2][row] = heaviest + np.log(total)
        own[3][row] = (weight * hidden[group]).sum() / total
        own[4][row] = alias[group].sum()
        # evidence speaks of a track that is shown
        shown = weight * (1.0 - hidden[group])
        if shown.sum() > 0.0:
            for source in range(evidence.shape[1]):
                own[5][row, source] = (shown * evidence[group, source]).sum() / shown.sum()
        for member in group:
            if id_[member] > 0:
                named[0][row], named[1][row], named[2][row] = id_[member], parent[member], born[member]
                named[3][row] = observations[group].max()
                break
    return own + named
