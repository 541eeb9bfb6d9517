"""The evidence of a scan for a track that was there before it.

A track is a prediction, and a place that is wrong but looks like the right one goes on looking like it. So a
hypothesis that lies where a track was predicted is no news as such: it is evidence by how much oftener a
right track gets one of its likelihood than a wrong track does. A right track in turn may be hidden: where the
map shows little of the room, the projector misses it for metres, and then for each scan alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.symmetric import determinant, inverse, plus, square, triangle
from eigenscan.tracker.association import Pairs
from eigenscan.tracker.covariance import residual
from eigenscan.tracker.observation import Observation, poorness
from eigenscan.tracker.symmetric import apart
from eigenscan.tracker.tracks import Tracks, replace
from numba import njit
from numpy.typing import NDArray
from scipy.special import expit

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SLOPE, MOST_AHEAD = 0.35, 5.0
"""ln of that ratio is SLOPE (L - even), and as many nats as the list's best is ahead of the next place.

Rounded from what three buildings have in common: benchmarks/evidence.py.
"""
EVEN_EXACT, EVEN_POOR = 13.0, 8.0
"""The L that speaks neither for nor against a track: on an exact map, and on one of thick or smeared walls
(benchmarks/evidence.py --way)."""
EVEN_BELOW, EVEN_STEPS = 6.0, 10.0
"""How far it lies below the mean L of right tracks, and the new scans over which that mean is learned.

Chosen on intel, guardian 3, aces and fr079 with benchmarks/mechanisms.py.
"""


def learned(even: float, likelihood: float, weight: float) -> float:
    """`even` after a scan at a claimed pose had a hypothesis of this log-likelihood there; 0: it had none.

    A map counts as exact until the robot's own scans show otherwise: then less is asked of each.
    """
    return float(
        np.clip(even + weight / EVEN_STEPS * (likelihood - EVEN_BELOW - even), EVEN_POOR, EVEN_EXACT)
    )


NEAR_M, NEAR_RAD = 0.5, float(np.radians(10.0))
"""Poses this near to each other are of one place."""
SHOWN_YET_MISSED = -6.0
"""The same for a track without a hypothesis, were it shown: next to impossible."""
HIDES, SHOWS = 0.05, 0.2
"""Of shown tracks that hide, and of hidden ones that show, over the way that makes a scan new evidence.

Hidden ones show less often than on the mean: most of the way that is hidden lies in a few long stretches.
"""


def likelihood_at(pose: Array, seen: Observation) -> float:
    """Log-likelihood of the likeliest hypothesis at a pose (3,); 0 without one."""
    off = residual(seen.poses, pose)
    there = (np.hypot(off[:, 0], off[:, 1]) <= NEAR_M) & (np.abs(off[:, 2]) <= NEAR_RAD)
    return float(seen.log_likelihoods[there].max(initial=0.0))


def ahead(seen: Observation) -> Array:
    """By how many nats (k,) the list's best is ahead of the next place; 0 for hypotheses of other places."""
    result: Array = _ahead(seen.poses, seen.log_likelihoods, seen.unlisted)
    return result


@njit("f8[::1](f8[:,:], f8[:], f8)", cache=True)  # pragma: no cover - compiled
def _ahead(poses: Array, log_likelihoods: Array, unlisted: float) -> Array:
    there = np.zeros(len(poses), dtype=np.bool_)
    lead, next_place = np.zeros(len(poses)), unlisted
    if not len(poses):
        return lead
    best = poses[np.argmax(log_likelihoods)]
    for k in range(len(poses)):
        x, y, turn = apart(poses[k], best)
        there[k] = np.hypot(x, y) <= NEAR_M and abs(turn) <= NEAR_RAD
        if not there[k]:
            next_place = max(next_place, log_likelihoods[k])
    for k in range(len(poses)):
        if there[k]:
            lead[k] = min(max(log_likelihoods[k] - next_place, 0.0), MOST_AHEAD)
    return lead


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
    def of(cls, seen: Observation, even: float = EVEN_EXACT) -> Merit:
        """Both follow from likelihoods, and from how far the best is ahead of other places."""
        lead = ahead(seen)
        # that a poor fit may be of more poses makes the place no likelier
        spread = 1.5 * poorness(seen.log_likelihoods)
        return cls(seen.log_likelihoods + lead - spread, SLOPE * (seen.log_likelihoods - even) + lead)

    def of_pairs(self, pairs: Pairs) -> Array:
        """What each pair (p,) of a track and a hypothesis in its gate is worth.

        For a vague track, the hypothesis' own likelihood spread over all the track's room is less.
        """
        return np.minimum(self.predicted[pairs.hypothesis] - 0.5 * pairs.distance2, self._alone_of(pairs))

    def at_first(self, pairs: Pairs, observations: Index) -> Array:
        """What it is worth more (p,) to tracks (n,) without observations: those that a relocation began.

        No scan chose them, so the first one counts as it does for a place that begins a track.
        """
        more = (self._alone_of(pairs) - self.of_pairs(pairs)).clip(min=0.0)
        return np.where(observations[pairs.track] > 0, 0.0, more)

    def _alone_of(self, pairs: Pairs) -> Array:
        result: Array = self.alone[pairs.hypothesis] + pairs.log_overlap
        return result


def hide_and_show(hidden: Array, progress: float) -> Array:
    """Hidden shares (n,) after a robot moved on by `progress`, 1: a scan is new evidence."""
    hides, shows = -np.expm1(-HIDES * progress), -np.expm1(-SHOWS * progress)
    result: Array = hidden * (1.0 - shows) + (1.0 - hidden) * hides
    return result


ALIASES, ENDS = 0.015, 0.35
"""Of the wrong tracks those that the building shows as it would show right ones; over the way that makes a
scan new evidence, how many of these it ceases to.

Rounded from what three buildings have in common: benchmarks/evidence.py.
"""


def aliases_of(predicted: Array) -> Array:
    """How many (k,) of the wrong tracks that such hypotheses begin are aliases; `predicted` as in `Merit`."""
    result: Array = expit(np.log(ALIASES / (1.0 - ALIASES)) + predicted)
    return result


def aliases_go_on(alias: Array, progress: float) -> Array:
    """Aliases (n,) after a robot moved on by `progress`, 1: a scan is new evidence; see `Tracks`."""
    stay = np.exp(-ENDS * progress)
    none = max(1.0 - float(alias.sum()), 0.0)
    result: Array = alias * stay + none * ALIASES * (1.0 - stay)
    return result


def share_aliases(tracks: Tracks) -> Tracks:
    """The same tracks, of which at most one is an alias."""
    return replace(tracks, alias=tracks.alias / max(float(tracks.alias.sum()), 1.0))


def explained_by_aliases(alias: Array, gained: Array) -> tuple[float, Array, Array]:
    """How much likelier aliases make a scan, in nats, where no shown track (n,) is right.

    Then the same (n,) where each track is known to be no alias, and the aliases (n,) after the scan.
    Of an alias it is as likely as of a right track, `gained` (n,): what looked right goes on looking right.
    """
    none = max(1.0 - float(alias.sum()), 1e-12)
    odds = alias * np.exp(gained)
    total = none + float(odds.sum())
    others = (total - odds) / (1.0 - alias).clip(min=1e-12)
    return float(np.log(total)), np.log(others.clip(min=1e-12)), odds / total


SLIPS = 0.02
"""Of the tracks, how many odometry has misled by more than its noise since they were last confirmed."""
SLIP_M, SLIP_RAD, SLIP_SHARE = 0.1, 0.1, 1.0
"""Sigma of what it is then off by: this much, and this share of the way and of the turn."""
TAIL = 3.0
"""Degrees of freedom of the predicted pose: odometry errs heavily, now and then (Student's t)."""
LEAST_MASS = float(np.log(1e-4))
"""Of tracks, below which their slipping is not looked at."""


def present_evidence(tracks: Tracks) -> Array:
    """The present place's evidence for each track (n,), >= 0.

    If the robot slipped just now, the track is shown where it was predicted by chance:
    then this evidence does not count.
    """
    result: Array = tracks.evidence.clip(min=0.0).sum(axis=1)
    return result


def slipped(tracks: Tracks, seen: Observation, merit: Merit, pairs: Pairs) -> Array:
    """Ln of the mass of tracks whose wheels have slipped, to each of the hypotheses (k,) seen.

    A track has not slipped to those in its gate, `pairs`. As there, a hypothesis nearby is worth no more
    than how much oftener a right track gets one than a wrong track does.
    """
    result: Array = _slipped(
        tracks.x, tracks.C, tracks.log_weight - present_evidence(tracks), tracks.unchecked, seen.poses,
        seen.covariances, merit.alone, merit.predicted, pairs.track, pairs.hypothesis,
    )  # fmt: skip
    return result


@njit(  # pragma: no cover - compiled
    "f8[::1](f8[:,:], f8[:,:,:], f8[:], f8[:,:], f8[:,:], f8[:,:,:], f8[:], f8[:], i8[:], i8[:])",
    cache=True,
    error_model="numpy",
)
def _slipped(
    x: Array, C: Array, log_mass: Array, unchecked: Array, y: Array, R: Array,
    alone: Array, predicted: Array, track: Index, hypothesis: Index,
) -> Array:  # fmt: skip
    out = np.full(len(y), -np.inf)
    pair = 0
    for i in range(len(x)):
        way, turn = SLIP_M + SLIP_SHARE * unchecked[i, 0], SLIP_RAD + SLIP_SHARE * unchecked[i, 1]
        spread = plus(triangle(C[i]), (way * way, 0.0, 0.0, way * way, 0.0, turn * turn))
        for k in range(len(y)):
            while pair < len(track) and (track[pair] < i or (track[pair] == i and hypothesis[pair] < k)):
                pair += 1
            in_gate = pair < len(track) and track[pair] == i and hypothesis[pair] == k
            if in_gate or log_mass[i] <= LEAST_MASS:
                continue
            own = triangle(R[k])
            total = plus(spread, own)
            # the hypothesis' volume by the density that the slipped track has there
            overlap = 0.5 * np.log(determinant(own) / determinant(total))
            overlap -= 0.5 * square(inverse(total), apart(y[k], x[i]))
            worth = log_mass[i] + min(predicted[k], alone[k] + overlap)
            most = max(out[k], worth)
            out[k] = most + np.log1p(np.exp(min(out[k], worth) - most))
    result: Array = np.log(SLIPS) + out
    return result


def surprise(distance2: Array) -> Array:
    """Factor (p,) >= 1 on predicted covariances by the innovation's squared distance (p,): Student's t."""
    return np.maximum(1.0, (TAIL + distance2) / (TAIL + 3.0))
