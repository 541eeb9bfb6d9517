"""What becomes of each track with a scan: it goes on alone, with a hypothesis of its gate, or one begins.

Paper, section 7: association, fork when two poses fit one track, recursive estimation, new tracks.
"""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.inner import inner
from eigenscan.geometry.symmetric import MATRICES, determinant, triangle
from eigenscan.tracker.association import Pairs, crowding_each, within_gate
from eigenscan.tracker.evidence import (
    Constants,
    Listed,
    Scan,
    aliases_go_on,
    explained_by_aliases,
    hide_and_show,
    log_sum,
)
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.symmetric import ROWS, fuse_each
from eigenscan.tracker.tracks import (
    GIVEN,
    MADE,
    Arrays,
    Columns,
    Tracks,
    arrays_of,
    begun,
    taken,
    tracks_of,
)
from numba import njit, types
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

LEAST_BORN = float(np.log(1e-9))
"""Mass of a new track over the heaviest's, below which it is not begun."""
LEAST_NEW = 1e-3
"""Share of a hypothesis' information that each scan has for a track at least."""
KEPT = 1.0
"""Of the mass that a hypothesis would begin a track with, what the track that takes it gets at least."""


@inner(error_model="numpy")  # pragma: no cover - compiled
def branch(old: Columns, seen: Listed, pairs: Pairs, scan: Scan, c: Constants) -> Columns:
    """Each track (n,) once as predicted, then for each pair (p,) of a track and a hypothesis in its gate.

    A hidden track has no hypothesis; one that is shown has one of its gate, or hardly ever none. With w the
    scan's weight, f a branch's fit in nats and L the evidence of the present place, a shown track gains
    g = w (ln sum e^f - L). Branches share the track by e^(w f): scans from one place repeat each other's
    preference.
    """
    count = len(old.x)
    origin = np.concatenate((np.arange(count), pairs.track))
    fit, first = _fit(old, seen, pairs, scan, c)
    total, preference = np.full(count, -np.inf), np.full(count, -np.inf)
    for row in range(len(origin)):
        i = origin[row]
        total[i] = log_sum(total[i], fit[row])
        preference[i] = log_sum(preference[i], scan.weight * fit[row])
    gained = scan.weight * (total - old.evidence[:, scan.source])
    hides, elsewhere = _hidden(old, scan, c)
    before = aliases_go_on(old.alias, scan.progress, c)
    explained, of_others, alias = explained_by_aliases(before, gained, elsewhere)
    out = taken(old, origin)
    for row in range(len(origin)):
        i = origin[row]
        part = scan.weight * fit[row] - preference[i]
        log_weight = old.log_weight[i] + np.log1p(-hides[i]) + gained[i] - explained + part + first[row]
        out.hidden[row, scan.source] = 0.0
        if row < count:
            unseen = old.log_weight[i] + np.log(hides[i]) + of_others[i] - explained
            log_weight = log_sum(log_weight, unseen)
            out.hidden[row, scan.source] = np.exp(unseen - log_weight)
        out.log_weight[row], out.alias[row] = log_weight, alias[i] * np.exp(part)
        out.evidence[row, scan.source] += gained[i]
    _name_forks(out, origin, count)
    _fuse(
        out, count, seen.poses, seen.widened, pairs.hypothesis, pairs.distance2, scan.precision,
        scan.stamp, c.least_new,
    )  # fmt: skip
    return out


@inner()  # pragma: no cover - compiled
def _hidden(old: Columns, scan: Scan, c: Constants) -> tuple[Array, Array]:
    """How likely this source does not show each track (n,); and does not, while another one shows it."""
    hides, elsewhere = np.empty(len(old.x)), np.zeros(len(old.x))
    for i in range(len(hides)):
        hides[i] = hide_and_show(old.hidden[i, scan.source], scan.progress, c)
        for source in range(old.hidden.shape[1]):
            if source != scan.source:
                elsewhere[i] = max(elsewhere[i], hides[i] * (1.0 - old.hidden[i, source]))
    return hides, elsewhere


@inner()  # pragma: no cover - compiled
def _fit(old: Columns, seen: Listed, pairs: Pairs, scan: Scan, c: Constants) -> tuple[Array, Array]:
    """What each branch (n + p,) fits, in nats; and what that is worth more to a track without observations.

    For a vague track, the hypothesis' own likelihood spread over all the track's room is less. A track that a
    relocation began no scan chose, so the first one counts as it does for a place that begins a track. So
    does a lidar's first list for tracks of others: it must not matter which lidar came first.
    """
    count = len(old.x)
    fit, first = np.empty(count + len(pairs.track)), np.zeros(count + len(pairs.track))
    for i in range(count):
        # a projector of a part of the site is no evidence on tracks elsewhere
        silent = scan.in_part and old.evidence[i, scan.source] == 0.0
        fit[i] = 0.0 if silent else c.shown_yet_missed
    for pair in range(len(pairs.track)):
        k, row = pairs.hypothesis[pair], count + pair
        alone = seen.alone[k] + pairs.log_overlap[pair]
        fit[row] = min(seen.predicted[k] - 0.5 * pairs.distance2[pair], alone)
        if scan.first or old.observations[pairs.track[pair]] <= 0:
            first[row] = alone - fit[row]
    return fit, first


@inner()  # pragma: no cover - compiled
def _name_forks(out: Columns, origin: Index, count: int) -> None:
    """The likeliest branch stays the track, the others fork from it, yet unnamed (0)."""
    best = np.arange(count)
    for row in range(count, len(origin)):
        i = origin[row]
        if out.log_weight[row] > out.log_weight[best[i]]:
            best[i] = row
    for row in range(len(origin)):
        if row != best[origin[row]]:
            out.parent[row], out.id[row] = out.id[row], 0


@inner(error_model="numpy")  # pragma: no cover - compiled
def _fuse(
    out: Columns, alone: int, poses: Array, covariances: Array, hypothesis: Index, distance2: Array,
    precision: float, stamp: int, least_new: float,
) -> None:  # fmt: skip
    """Brings the branches after the first `alone` together with their hypotheses (p,).

    Scans from one place err alike: a track as sure as one scan learns only what motion makes new, the
    `precision`. One that prediction has made vaguer than a scan takes all of it: 1 - (|R| / |C|)^(1/3).
    """
    # by single numbers: whole rows take ten seconds and thirty MB more to compile
    count = len(hypothesis)
    y, R = np.empty((count, 3)), np.empty((count, 3, 3))
    for pair in range(count):
        row, k = alone + pair, hypothesis[pair]
        known = np.cbrt(determinant(triangle(covariances[k])) / determinant(triangle(out.C[row])))
        share = min(max(1.0 - known, precision, least_new), 1.0)
        for i in range(3):
            y[pair, i] = poses[k, i]
            for j in range(3):
                R[pair, i, j] = covariances[k, i, j] / share
    fused_x, fused_C = fuse_each(out.x[alone:], out.C[alone:], y, R)
    for pair in range(count):
        row = alone + pair
        out.nis[row] = distance2[pair]
        for i in range(4):
            out.unchecked[row, i] = 0.0
        out.fixed_at[row] = stamp
        out.observations[row] += 1
        for i in range(3):
            out.x[row, i] = out.fixed_x[row, i] = fused_x[pair, i]
            for j in range(3):
                out.C[row, i, j] = out.fixed_covariance[row, i, j] = fused_C[pair, i, j]


def follow(tracks: Tracks, seen: Observation, gate: float, precision: float) -> Tracks:
    """Tracks brought to the nearest pose of a local list in their gates, with the masses that they had.

    It was made where a track was predicted. It omits other places, so it is no evidence for this one.
    """
    made = _followed(arrays_of(tracks), seen.poses, seen.covariances, gate, precision, seen.stamp, LEAST_NEW)
    return tracks_of(made)


@njit(  # pragma: no cover - compiled
    MADE(
        GIVEN, ROWS, MATRICES, types.float64, types.float64, types.int64, types.float64
    ),
    cache=True,
    error_model="numpy",
)  # fmt: skip
def _followed(
    arrays: Arrays, poses: Array, covariances: Array, gate: float, precision: float, stamp: int,
    least_new: float,
) -> Columns:  # fmt: skip
    t = Columns(*arrays)
    track, hypothesis, distance2, _ = within_gate(t.x, t.C, poses, covariances, gate)
    nearest = np.full(len(t.x), -1)
    for pair in range(len(track)):
        before = nearest[track[pair]]
        if before < 0 or distance2[pair] < distance2[before]:
            nearest[track[pair]] = pair
    own = np.flatnonzero(nearest >= 0)
    order = np.concatenate((np.flatnonzero(nearest < 0), own))
    pairs = nearest[own]
    out = taken(t, order)
    _fuse(
        out, len(order) - len(own), poses, covariances, hypothesis[pairs], distance2[pairs], precision, stamp,
        least_new,
    )  # fmt: skip
    return taken(out, np.argsort(order))


@inner(error_model="numpy")  # pragma: no cover - compiled
def raise_to(
    grown: Columns, alone: int, seen: Listed, pairs: Pairs, log_mass: Array, scan: Scan, c: Constants
) -> None:
    """Gives branches after the first `alone` at least the mass (k,) of their hypothesis alone.

    A track that was begun on a poor scan must not keep a good one from counting. The likeliest branch of a
    hypothesis takes it, with the evidence and the share of aliases of a track that begins: with a
    poor scan's it would gain from the next one what it has already, and get ahead of a place that looks the
    same and had no track.
    """
    best = np.full(len(log_mass), -np.inf)
    for pair in range(len(pairs.track)):
        k = pairs.hypothesis[pair]
        best[k] = max(best[k], grown.log_weight[alone + pair])
    for pair in range(len(pairs.track)):
        k, row = pairs.hypothesis[pair], alone + pair
        least = log_mass[k] + np.log(c.kept)
        if grown.log_weight[row] != best[k] or grown.log_weight[row] >= least:
            continue
        own = np.exp(grown.log_weight[row] - least)
        grown.log_weight[row] = least
        for source in range(grown.evidence.shape[1]):
            grown.evidence[row, source] *= own
        grown.evidence[row, scan.source] += (1.0 - own) * seen.predicted[k]
        grown.alias[row] = own * grown.alias[row] + (1.0 - own) * seen.alias[k]


@inner(error_model="numpy")  # pragma: no cover - compiled
def births(grown: Columns, seen: Listed, pairs: Pairs, log_mass: Array, frame: int, scan: Scan) -> Columns:
    """Tracks that begin at hypotheses outside of all gates.

    `log_mass` (k,): what each hypothesis has by itself, of robots that were carried there or slipped.
    """
    free = np.ones(len(seen.poses), dtype=np.bool_)
    for hypothesis in pairs.hypothesis:
        free[hypothesis] = False
    # those that could not live through this scan are not begun
    heaviest = -np.inf
    for log_weight in grown.log_weight:
        heaviest = max(heaviest, log_weight)
    for log_weight in log_mass[free]:
        heaviest = max(heaviest, log_weight)
    k = np.flatnonzero(free & (log_mass > heaviest + LEAST_BORN))
    x, C = seen.poses[k], seen.covariances[k]
    evidence = np.zeros((len(k), grown.evidence.shape[1]))
    for row in range(len(k)):
        evidence[row, scan.source] = seen.predicted[k[row]]
    log_weight = log_mass[k] - np.log(crowding_each(x, C))
    return begun(x, C, log_weight, seen.alias[k], evidence, frame, scan.stamp)
