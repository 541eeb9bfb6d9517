"""How sure the best pose is, and the state that follows from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, STATE_LOST, State
from eigenscan.tracker.belief import Belief
from eigenscan.tracker.covariance import residual
from eigenscan.tracker.evidence import NEAR_M, NEAR_RAD
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.tracks import Tracks
from numpy.typing import NDArray
from scipy.special import chndtr, ndtr, ndtri

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Verdict:
    """The most believed track and the belief around it."""

    track: int
    """Index among the tracks, -1: none."""
    confidence: float
    """Probability that the true pose is within 0.5 m and 10 degrees of that track's."""


def judge(tracks: Tracks) -> Verdict:
    """The track with the most probability within 0.5 m and 10 degrees of it."""
    if not len(tracks):
        return Verdict(-1, 0.0)
    weight = np.exp(tracks.log_weight)
    # a track with less than half of the heaviest cannot win unless neighbours lend it their mass
    likely = np.flatnonzero(weight >= 0.25 * weight.max())
    masses = np.array([mass_near(tracks, weight, int(index)) for index in likely])
    best = int(np.argmax(masses))
    return Verdict(int(likely[best]), float(min(masses[best], 1.0)))


def mass_near(tracks: Tracks, weight: Array, index: int) -> float:
    """Probability mass of all tracks within 0.5 m and 10 degrees of track `index`."""
    delta = residual(tracks.x, tracks.x[index])
    same = tracks.frame == tracks.frame[index]
    return float((weight * same * share_within(delta, tracks.C)).sum())


def share_within(delta: Array, C: Array) -> Array:
    """Share of Gaussians centred at `delta` (n, 3) with C (n, 3, 3) within 0.5 m and 10 degrees of 0.

    Position by a circular Gaussian as wide as the ellipse's long axis, so rather too little than too much.
    """
    half = (C[:, 0, 0] + C[:, 1, 1]) / 2
    wide = half + np.hypot((C[:, 0, 0] - C[:, 1, 1]) / 2, C[:, 0, 1])
    distance2 = delta[:, 0] ** 2 + delta[:, 1] ** 2
    # beyond this non-centrality nothing is within reach, and chndtr would only lose time
    reach = np.minimum(distance2 / wide, 1e4)
    position = chndtr(NEAR_M**2 / wide, 2.0, reach)
    sigma = np.sqrt(C[:, 2, 2])
    heading = ndtr((NEAR_RAD - delta[:, 2]) / sigma) - ndtr((-NEAR_RAD - delta[:, 2]) / sigma)
    result: Array = np.nan_to_num(position).clip(0.0, 1.0) * heading
    return result


PLACE_M, PLACE_RAD = 1.0, 0.35
"""Tracks this near to the best are of its place: their poses widen the level, others are risk."""


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
    weight = np.exp(tracks.log_weight)
    delta = residual(tracks.x, tracks.x[best])
    off = np.hypot(delta[:, 0], delta[:, 1])
    here = (tracks.frame == tracks.frame[best]) & (off <= PLACE_M) & (np.abs(delta[:, 2]) <= PLACE_RAD)
    left = risk - (1.0 - float(weight[here].sum()))
    if left <= 0.0:
        return None
    # each track that is left out costs its mass
    order = np.flatnonzero(here)[np.argsort(weight[here], kind="stable")]
    dropped = np.cumsum(weight[order]) <= 0.25 * left
    C, kept = tracks.C, order[~dropped]
    half = (C[kept, 0, 0] + C[kept, 1, 1]) / 2
    wide = half + np.hypot((C[kept, 0, 0] - C[kept, 1, 1]) / 2, C[kept, 0, 1])
    share = 0.375 * left
    radius = off[kept] + np.sqrt(-2.0 * np.log(share) * wide)
    angle = np.abs(delta[kept, 2]) - ndtri(share / 2.0) * np.sqrt(C[kept, 2, 2])
    return Protection(float(radius.max()), float(angle.max()))


def next_state(state: State, belief: Belief, confidence: float, settings: TrackerSettings) -> State:
    """Lost, ambiguous or localized; a claim once made is held down to a lower confidence."""
    needed = settings.released_below if state == STATE_LOCALIZED else settings.localized_above
    if confidence >= needed:
        return STATE_LOCALIZED
    return STATE_LOST if belief.none_probability > 0.5 else STATE_AMBIGUOUS
