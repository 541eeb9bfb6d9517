"""How sure the best pose is, and the state that follows from it."""

from __future__ import annotations

from dataclasses import dataclass
from math import erfc, log

import numpy as np
from eigenscan.geometry.inner import inner
from eigenscan.geometry.symmetric import Column
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, STATE_LOST, State
from eigenscan.tracker.belief import Belief
from eigenscan.tracker.evidence import NEAR_M, NEAR_RAD
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.symmetric import apart, widest
from eigenscan.tracker.tracks import Tracks
from numba import njit
from numpy.typing import NDArray
from scipy.special import chndtr, ndtri

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class Verdict:
    """The most believed track and the belief around it."""

    track: int
    """Index among the tracks, -1: none."""
    confidence: float
    """Probability that the true pose is within 0.5 m and 10 degrees of that track's."""
    proven: float = 1.0
    """The same at most, for a set-up that no motion has proven may be wrong."""

    @property
    def stated(self) -> float:
        """Confidence that is published; the state follows from map and motion alone."""
        return min(self.confidence, self.proven)


AS_PROBABLE = 0.05
"""Between tracks whose probabilities differ by less, the heavier one's pose is published.

Neighbours in one place have nearly the same probability around them. The claim would jump to and fro between
them, and one that jumps farther than odometry allows is withdrawn.
"""


def judge(tracks: Tracks) -> Verdict:
    """The track with the most probability within 0.5 m and 10 degrees of it; of several, the heaviest."""
    if not len(tracks):
        return Verdict(-1, 0.0)
    likely, (near, reach, heading, mass) = _around(
        tracks.x, tracks.C, tracks.frame, np.exp(tracks.log_weight)
    )
    within = mass * _shares(near, reach, heading)
    masses = within.reshape(len(likely), -1).sum(axis=1)
    best = int(np.where(masses >= masses.max() - AS_PROBABLE, tracks.log_weight[likely], -np.inf).argmax())
    return Verdict(int(likely[best]), min(float(masses[best]), 1.0))


def share_within(delta: Array, C: Array) -> Array:
    """Share of Gaussians centred at `delta` (n, 3) with C (n, 3, 3) within 0.5 m and 10 degrees of 0.

    Position by a circular Gaussian as wide as the ellipse's long axis, so rather too little than too much.
    """
    return _shares(*_reach(delta, C))


def _shares(near: Array, reach: Array, heading: Array) -> Array:
    position = chndtr(near, 2.0, reach)
    result: Array = np.fmin(np.fmax(position, 0.0), 1.0) * heading  # also where it is no number
    return result


@inner(error_model="numpy")  # pragma: no cover - compiled
def _reach_of(delta: Column, C: Array) -> Column:
    wide, sigma = widest(C), np.sqrt(2.0 * C[2, 2])
    # beyond this non-centrality nothing is within reach, and chndtr would only lose time
    reach = min((delta[0] ** 2 + delta[1] ** 2) / wide, 1e4)
    heading = 0.5 * (erfc((delta[2] - NEAR_RAD) / sigma) - erfc((delta[2] + NEAR_RAD) / sigma))
    return NEAR_M**2 / wide, reach, heading


@njit("UniTuple(f8[::1], 3)(f8[:,:], f8[:,:,:])", cache=True, error_model="numpy")  # pragma: no cover
def _reach(delta: Array, C: Array) -> tuple[Array, Array, Array]:
    """What the noncentral chi-squared needs for each position, and the share of each heading."""
    near, reach, heading = np.empty(len(C)), np.empty(len(C)), np.empty(len(C))
    for i in range(len(C)):
        near[i], reach[i], heading[i] = _reach_of((delta[i, 0], delta[i, 1], delta[i, 2]), C[i])
    return near, reach, heading


@njit(  # pragma: no cover - compiled
    "Tuple((i8[::1], f8[:,::1]))(f8[:,:], f8[:,:,:], i8[:], f8[::1])", cache=True, error_model="numpy"
)
def _around(x: Array, C: Array, frame: Index, weight: Array) -> tuple[Index, Array]:
    """Tracks (k,) that may be the best; around each, of all n, (4, k * n): what `_reach` gives, and the mass.

    A track with less than half of the heaviest cannot win unless neighbours lend it their mass.
    """
    heaviest, count, at = 0.0, 0, 0
    for own in weight:
        heaviest = max(heaviest, own)
    likely = np.empty(len(x), dtype=np.int64)
    for best in range(len(x)):
        if weight[best] >= 0.25 * heaviest:
            likely[count], count = best, count + 1
    out = np.empty((4, count * len(x)))
    for best in likely[:count]:
        for i in range(len(x)):
            out[0, at], out[1, at], out[2, at] = _reach_of(apart(x[i], x[best]), C[i])
            out[3, at] = weight[i] if frame[i] == frame[best] else 0.0
            at += 1
    return likely[:count], out


PLACE_M, PLACE_RAD = 1.0, 0.35
"""Tracks this near to the best are of its place: their poses widen the level, others are risk."""


TAILS = 1.5
"""How much farther than a normal distribution's the tails of errors may reach.

Without it 73 of 35,600 levels were exceeded, on intel and fr079, where it was chosen, by up to 1.4 times
(benchmarks/integrity.py --fault none).
"""


@dataclass(frozen=True)
class Protection:
    """A radius, m, and an angle, rad, that hold with a stated risk."""

    radius: float
    angle: float


def protect(tracks: Tracks, best: int, risk: float) -> Protection | None:
    """The level that the belief puts at most `risk` beyond; None where other places hold as much.

    Mass of other tracks and of "none" is risk that no radius covers. What is left is shared by position, as
    wide as the ellipses' long axes, and heading.
    """
    here = _here(tracks.x, tracks.C, tracks.log_weight, tracks.frame, best)
    left = risk - (1.0 - float(here[:, 0].sum()))
    if left <= 0.0:
        return None
    share = 0.375 * left
    lightest_first = np.argsort(here[:, 0], kind="stable")
    level = _level(here, lightest_first, 0.25 * left, -2.0 * log(share), -float(ndtri(share / 2.0)))
    return Protection(*level)


def mass_of_place(tracks: Tracks, best: int) -> float:
    """Probability of the best track's place, however wide odometry has made its tracks."""
    return float(_here(tracks.x, tracks.C, tracks.log_weight, tracks.frame, best)[:, 0].sum())


@njit("f8[:,:](f8[:,:], f8[:,:,:], f8[:], i8[:], i8)", cache=True)  # pragma: no cover - compiled
def _here(x: Array, C: Array, log_weight: Array, frame: Index, best: int) -> Array:
    """Of the tracks of the best one's place: mass, how far off in position and heading, both variances."""
    count, out = 0, np.empty((len(x), 5))
    for i in range(len(x)):
        ahead, left, turn = apart(x[i], x[best])
        off = np.hypot(ahead, left)
        if frame[i] == frame[best] and off <= PLACE_M and abs(turn) <= PLACE_RAD:
            out[count, 0], out[count, 1], out[count, 2] = np.exp(log_weight[i]), off, abs(turn)
            out[count, 3], out[count, 4] = widest(C[i]), C[i, 2, 2]
            count += 1
    return out[:count]


@njit("UniTuple(f8, 2)(f8[:,:], i8[:], f8, f8, f8)", cache=True)  # pragma: no cover - compiled
def _level(here: Array, order: Index, spare: float, rayleigh: float, normal: float) -> tuple[float, float]:
    """Radius and angle that hold all but `spare` of the mass: each track that is left out costs its own."""
    radius, angle, dropped = 0.0, 0.0, 0.0
    for i in order:
        dropped += here[i, 0]
        if dropped > spare:
            radius = max(radius, here[i, 1] + TAILS * np.sqrt(rayleigh * here[i, 3]))
            angle = max(angle, here[i, 2] + TAILS * normal * np.sqrt(here[i, 4]))
    return radius, angle


def next_state(
    state: State, belief: Belief, confidence: float, settings: TrackerSettings, *, confirmed: bool
) -> State:
    """Lost, ambiguous or localized; a claim once made is held at a lower confidence while `confirmed`."""
    held = confirmed and state == STATE_LOCALIZED
    needed = settings.released_below if held else settings.localized_above
    if confidence >= needed:
        return STATE_LOCALIZED
    return STATE_LOST if belief.none_probability > 0.5 else STATE_AMBIGUOUS
