"""Keeps the set of tracks small: pruning, a bound on their number, unification (paper, section 7)."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.inner import inner
from eigenscan.geometry.symmetric import put, triangle
from eigenscan.tracker.association import within_gate
from eigenscan.tracker.belief import Belief
from eigenscan.tracker.prediction import carried
from eigenscan.tracker.symmetric import apart, moments_of
from eigenscan.tracker.tracks import GIVEN, MADE, Arrays, Columns, arrays_of, taken, tracks_of
from eigenscan.tracker.weighing import normalise
from numba import njit, types
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SAME_DISTANCE2 = 4.0
"""Squared Mahalanobis distance under C1 + C2 within which two tracks are one."""


def settle(belief: Belief) -> None:
    """Ends tracks below the least probability and beyond the greatest number, and joins those of one place.

    The rest shares all mass and is sorted, most probable first. Forks and births get their numbers.
    """
    # sorted by numpy: compiled, a sort takes seconds of the first start
    order = np.argsort(-belief.tracks.log_weight, kind="stable")[: belief.settings.max_tracks]
    made = _settled(
        arrays_of(belief.tracks), belief.elsewhere.log_weight, order, belief.settings.prune_below,
        SAME_DISTANCE2, belief.next_id,
    )  # fmt: skip
    belief.tracks = tracks_of(made)
    belief.next_id = max(belief.next_id, 1 + int(made.id.max(initial=0)))


@inner()  # pragma: no cover - compiled
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


@inner(error_model="numpy")  # pragma: no cover - compiled
def _where_fixed(t: Columns, group: Index) -> tuple[Array, Array]:
    """The members where a scan last fixed the first one (k, 3), (k, 3, 3); others are moved back with it."""
    x, C, first = t.fixed_x[group], t.fixed_covariance[group], group[0]
    cos, sin = np.cos(t.x[first, 2]), np.sin(t.x[first, 2])
    ahead, left, turn = apart(x[0], t.x[first])
    back = cos * ahead + sin * left, cos * left - sin * ahead, turn
    still = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for member in range(1, len(group)):
        own = group[member]
        if t.fixed_at[own] != t.fixed_at[first]:
            pose, covariance = carried(t.x[own], triangle(t.C[own]), back, still)
            x[member, 0], x[member, 1], x[member, 2] = pose
            put(covariance, C[member])
    return x, C


@inner(error_model="numpy")  # pragma: no cover - compiled
def _merge(t: Columns, group: Index, out: Columns, row: int) -> None:
    """Writes to `row` of `out` one track with the moments of all in `group`.

    It goes on under the name of its heaviest member that has one, from where a scan last fixed the heaviest:
    scan motion from there on comes yet, and will correct the odometry since.
    """
    heaviest = t.log_weight[group].max()
    weight = np.exp(t.log_weight[group] - heaviest)
    total = weight.sum()
    x, C = moments_of(t.x[group], t.C[group], weight)
    fixed_x, fixed_covariance = moments_of(*_where_fixed(t, group), weight)
    for i in range(3):
        out.x[row, i], out.fixed_x[row, i] = x[i], fixed_x[i]
        for j in range(3):
            out.C[row, i, j], out.fixed_covariance[row, i, j] = C[i, j], fixed_covariance[i, j]
    out.log_weight[row] = heaviest + np.log(total)
    out.alias[row] = t.alias[group].sum(axis=0)
    for source in range(t.evidence.shape[1]):
        # evidence speaks of a track that is shown
        shown = weight * (1.0 - t.hidden[group, source])
        out.hidden[row, source] = 1.0 - shown.sum() / total
        if shown.sum() > 0.0:
            out.evidence[row, source] = (shown * t.evidence[group, source]).sum() / shown.sum()
    for member in group:
        if t.id[member] > 0:
            out.id[row], out.parent[row], out.born[row] = t.id[member], t.parent[member], t.born[member]
            out.observations[row] = t.observations[group].max()
            break


@inner(error_model="numpy")  # pragma: no cover - compiled
def _unified(t: Columns, near: float) -> Columns:
    """Joins tracks that describe one place into the heaviest of them. Expects them sorted, heaviest first."""
    track, other, _, _ = within_gate(t.x, t.C, t.x, t.C, near)
    leader = _leaders(track, other, t.frame)
    heads = np.flatnonzero(leader == np.arange(len(leader)))
    out = taken(t, heads)
    for row in range(len(heads)):
        group = np.flatnonzero(leader == heads[row])
        if len(group) > 1:
            _merge(t, group, out, row)
    return out


@njit(  # pragma: no cover - compiled
    MADE(GIVEN, types.float64[::1], types.int64[::1], types.float64, types.float64, types.int64),
    cache=True,
    error_model="numpy",
)
def _settled(arrays: Arrays, rest: Array, order: Index, least: float, near: float, next_id: int) -> Columns:
    given = Columns(*arrays)
    t = taken(given, order[given.log_weight[order] > np.log(least)])
    normalise(t.log_weight, rest)
    out = _unified(t, near)
    for row in range(len(out.id)):
        if out.id[row] == 0:
            out.id[row], next_id = next_id, next_id + 1
    return out
