"""Keeps the set of tracks small: pruning, a bound on their number, unification (paper, section 7)."""

from __future__ import annotations

import numpy as np
from eigenscan.tracker.association import Pairs, associate
from eigenscan.tracker.belief import Belief
from eigenscan.tracker.covariance import moments
from eigenscan.tracker.tracks import Tracks
from numpy.typing import NDArray

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
    groups = _groups(len(tracks), pairs, tracks.frame)
    belief.tracks = _merge(tracks, groups, belief.stamp or 0)


def _groups(count: int, pairs: Pairs, frame: Index) -> list[Index]:
    """Greedy: the heaviest track takes all near it that are still free, then the next one."""
    free = np.ones(count, dtype=bool)
    bounds = np.searchsorted(pairs.track, np.arange(count + 1))
    groups = []
    for leader in range(count):
        if not free[leader]:
            continue
        near = pairs.hypothesis[bounds[leader] : bounds[leader + 1]]
        group = near[free[near] & (frame[near] == frame[leader])]
        free[group] = False
        groups.append(group)
    return groups


def _merge(tracks: Tracks, groups: list[Index], stamp: int) -> Tracks:
    """One track a group, with the moments of its members; groups list the heaviest first."""
    result = tracks.pick(np.array([group[0] for group in groups]))
    for row, group in enumerate(groups):
        if len(group) == 1:
            continue
        _keep_name(result, row, tracks, group)
        weight = np.exp(tracks.log_weight[group] - tracks.log_weight[group].max())
        result.x[row], result.C[row] = moments(tracks.x[group], tracks.C[group], weight)
        result.fixed_x[row], result.fixed_covariance[row] = result.x[row], result.C[row]
        result.fixed_at[row] = stamp
        # evidence speaks of a track that is shown
        shown = weight * (1.0 - tracks.hidden[group])
        if shown.sum() > 0.0:
            result.evidence[row] = shown @ tracks.evidence[group] / shown.sum()
        result.twin[row] = tracks.twin[group].sum()
        result.hidden[row] = weight @ tracks.hidden[group] / weight.sum()
        result.log_weight[row] = np.logaddexp.reduce(tracks.log_weight[group])
    return result


def _keep_name(result: Tracks, row: int, tracks: Tracks, group: Index) -> None:
    """A group goes on under the name of its heaviest member that has one."""
    named = group[tracks.id[group] > 0]
    if len(named):
        heaviest = named[0]
        result.id[row], result.parent[row] = tracks.id[heaviest], tracks.parent[heaviest]
        result.born[row] = tracks.born[heaviest]
        result.observations[row] = tracks.observations[group].max()
