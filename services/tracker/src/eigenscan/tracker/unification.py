"""Keeps the set of tracks small: pruning, unification, a bound on their number (paper, section 7)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from eigenscan.tracker.belief import Belief, Tracks
from eigenscan.tracker.covariance import mahalanobis_squared, moments, residual
from numpy.typing import NDArray

Array = NDArray[np.float64]

SAME_DISTANCE2 = 4.0
"""Squared Mahalanobis distance under C1 + C2 within which two tracks are one."""
SAME_PLACE = np.array([0.05, 0.05, 0.03])
"""m, m, rad: tracks this close are one, however sure they are."""


def prune(belief: Belief) -> None:
    """Ends tracks below the least probability and beyond the greatest number; the rest keep all mass."""
    tracks, settings = belief.tracks, belief.settings
    order = np.argsort(-tracks.log_weight, kind="stable")[: settings.max_tracks]
    order = order[tracks.log_weight[order] > np.log(settings.prune_below)]
    belief.tracks = tracks.pick(order)
    belief.normalise()


def unify(belief: Belief) -> None:
    """Joins tracks that describe one place into the heaviest of them; most probable first."""
    rest = belief.tracks
    order = np.argsort(-rest.log_weight, kind="stable")
    x, C, frame = rest.x[order], rest.C[order], rest.frame[order]
    free = np.ones(len(order), dtype=bool)
    leaders, merged = [], []
    for leader in range(len(order)):
        if not free[leader]:
            continue
        group = np.flatnonzero(free & _same(x, C, frame, leader))
        free[group] = False
        leaders.append(order[leader])
        merged.append(order[group])
    if len(leaders) == len(order):
        belief.tracks = rest.pick(order)
        return
    belief.tracks = _merge(rest, np.array(leaders), merged)


def _same(x: Array, C: Array, frame: NDArray[np.intp], leader: int) -> NDArray[np.bool_]:
    delta = residual(x, x[leader])
    close = (np.abs(delta) <= SAME_PLACE).all(axis=1)
    alike = mahalanobis_squared(delta, C + C[leader]) <= SAME_DISTANCE2
    result: NDArray[np.bool_] = (close | alike) & (frame == frame[leader])
    result[leader] = True
    return result


def _merge(tracks: Tracks, leaders: NDArray[np.intp], groups: list[NDArray[np.intp]]) -> Tracks:
    """One track a group, with the moments of its members; groups list the heaviest first."""
    result = tracks.pick(leaders)
    x, C, log_weight = result.x.copy(), result.C.copy(), result.log_weight.copy()
    evidence = result.evidence.copy()
    for row, group in enumerate(groups):
        if len(group) == 1:
            continue
        _keep_name(result, row, tracks, group)
        weight = np.exp(tracks.log_weight[group] - tracks.log_weight[group].max())
        x[row], C[row] = moments(tracks.x[group], tracks.C[group], weight)
        evidence[row] = weight @ tracks.evidence[group] / weight.sum()
        log_weight[row] = np.logaddexp.reduce(tracks.log_weight[group])
    return replace(result, x=x, C=C, log_weight=log_weight, evidence=evidence)


def _keep_name(result: Tracks, row: int, tracks: Tracks, group: NDArray[np.intp]) -> None:
    """A group goes on under the name of its heaviest member that has one."""
    named = group[tracks.id[group] > 0]
    if len(named):
        heaviest = named[0]
        result.id[row], result.parent[row] = tracks.id[heaviest], tracks.parent[heaviest]
        result.born[row] = tracks.born[heaviest]
        result.observations[row] = tracks.observations[group].max()
