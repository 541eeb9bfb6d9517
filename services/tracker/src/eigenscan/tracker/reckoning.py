"""Dead reckoning by odometry and scan motion together: scan motion corrects odometry.

Odometry comes first and carries the tracks. Scan motion comes later, over some tenths of a second. Odometry
that slips or turns unnoticed is set right by it before it misleads a track that no hypothesis confirms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np
from eigenscan.geometry.symmetric import MATRICES, inverse, plus, put, square, times, triangle
from eigenscan.tracker.agreement import ScanInterval, Spread
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.planar import Pose, between, compose, scaled
from eigenscan.tracker.prediction import carried, motion_noise
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.symmetric import ROWS, widest
from eigenscan.tracker.tracks import Tracks, replace
from numba import njit, types
from numpy.typing import NDArray
from scipy.special import chdtri

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SCAN_SIGMA = np.array([0.015, 0.015, 0.008])
"""m, m, rad: error of a motion between two scans beyond that of the fit itself: the time within a
scan, people, glass."""
SLIPPED = float(chdtri(3, 1e-3))
"""Squared distance between odometry and scans from which on odometry has slipped."""

Motions = Callable[[int, int], Motion]
"""Odometry between two stamps, ns."""


@dataclass(frozen=True)
class Leg:
    """Motion from one stamp to another, ns, by odometry and scans; its noise (3, 3) is in the base frame.

    `correction` is what the scans change of odometry's motion, in the base frame at the end. `unchecked` is
    what part of its way and turn no scan has confirmed, 0 to 1.
    """

    since: int
    stamp: int
    delta: Pose
    noise: Array
    correction: Pose
    unchecked: tuple[float, float] = (1.0, 1.0)


def leg(interval: ScanInterval, driven: Motion, settings: TrackerSettings) -> Leg:
    """Odometry (`driven`) and scan motion over one interval: Kalman's update of the one by the other."""
    assert interval.moved is not None
    off = between(driven.delta, interval.moved)
    before = motion_noise(driven, settings)
    correction, noise, wide = _updated(before, interval.spread, interval.turn_variance, off, SLIPPED)
    # along a hallway scans confirm nothing of the way
    unchecked = _share(wide, max(before[0], before[1])), _share(float(noise[2, 2]), before[2])
    return Leg(
        interval.since, interval.stamp, compose(driven.delta, correction), noise, correction, unchecked
    )


def _share(left: float, before: float) -> float:
    """What part of a deviation is left, 0 to 1, by variances; 1 where these are no numbers."""
    return sqrt(max(min(1.0, left / before), 0.0)) if before > 0.0 else 1.0


_NUMBER, _MATRIX, _THREE = types.float64, types.float64[:, ::1], types.UniTuple(types.float64, 3)


@njit(  # pragma: no cover - compiled
    types.Tuple((_THREE, _MATRIX, _NUMBER))(_THREE, _THREE, _NUMBER, _THREE, _NUMBER), cache=True
)
def _updated(
    variances: Pose, spread: Spread, turn_variance: float, off: Pose, slipped: float
) -> tuple[Pose, Array, float]:
    """Kalman's update of odometry, its noise Q of these variances, by a scan motion that is off by a pose.

    gain = Q (Q + R)^-1; gives the correction, (I - gain) Q and its variance along the position's long axis.
    Where odometry has slipped, how far it is off is its noise, too.
    """
    (xx, xy, yy), (x, y, turn) = spread, off
    R = (xx + SCAN_SIGMA[0] ** 2, xy, 0.0, yy + SCAN_SIGMA[1] ** 2, 0.0, turn_variance + SCAN_SIGMA[2] ** 2)
    own = (variances[0], 0.0, 0.0, variances[1], 0.0, variances[2])
    if square(inverse(plus(own, R)), off) > slipped:
        own = plus(own, (x * x, x * y, x * turn, y * y, y * turn, turn * turn))
    certain, noise = inverse(plus(own, R)), np.empty((3, 3))
    correction = times(own, times(certain, off))
    put(own, noise)
    # (I - gain) Q = Q - Q (Q + R)^-1 Q
    before = noise.copy()
    for column in range(3):
        less = times(own, times(certain, (before[0, column], before[1, column], before[2, column])))
        for row in range(3):
            noise[row, column] -= less[row]
    noise = (noise + noise.T) / 2.0
    return correction, noise, widest(noise)


def correct(tracks: Tracks, way: Leg, now: int, motions: Motions, settings: TrackerSettings) -> Tracks:
    """The tracks, predicted to `now`, as if odometry had been what it and the scans give together.

    Those that a hypothesis confirmed later stay as they are.
    """
    fixed = sorted({at for at in tracks.fixed_at.tolist() if at < way.stamp})
    if not fixed:
        return tracks
    legs, unchecked = np.zeros((len(fixed), _LEG)), tracks.unchecked.copy()
    for row, at in zip(legs, fixed, strict=True):
        begun = max(at, way.since)
        if at < begun:
            moved = motions(at, begun)
            row[0:3], row[3:6] = moved.delta, motion_noise(moved, settings)
        share, driven = (way.stamp - begun) / (way.stamp - way.since), motions(begun, way.stamp)
        delta = way.delta
        if begun > way.since:
            delta = compose(driven.delta, scaled(way.correction, share))
        row[6:9], row[9] = delta, share
        unchecked[tracks.fixed_at == at, 2:] -= (1.0 - np.array(way.unchecked)) * (driven.way, driven.turn)
    rest = motions(way.stamp, now)
    x, C, fixed_x, fixed_covariance, fixed_at = _corrected(
        tracks.x, tracks.C, tracks.fixed_x, tracks.fixed_covariance, tracks.fixed_at, way.stamp,
        np.array(fixed), legs, way.noise, rest.delta, motion_noise(rest, settings),
    )  # fmt: skip
    return replace(
        tracks, x=x, C=C, fixed_x=fixed_x, fixed_covariance=fixed_covariance, fixed_at=fixed_at,
        unchecked=np.maximum(unchecked, 0.0),
    )  # fmt: skip


_LEG = 10
"""Numbers for the tracks that were fixed at one stamp: odometry's motion to where the leg begins for them,
and the diagonal of its noise; their part of the leg's motion, and its share of the leg."""
_POSES, _COVARIANCES = types.float64[:, ::1], types.float64[:, :, ::1]
_STAMPS = types.Array(types.int64, 1, "A", readonly=True)


@njit(  # pragma: no cover - compiled
    types.Tuple((_POSES, _COVARIANCES, _POSES, _COVARIANCES, types.int64[::1]))(
        ROWS, MATRICES, ROWS, MATRICES, _STAMPS, types.int64, types.int64[::1], _MATRIX, _MATRIX, _THREE,
        _THREE,
    ),
    cache=True,
)  # fmt: skip
def _corrected(
    now_x: Array, now_C: Array, old_x: Array, old_covariance: Array, old_at: Index, stamp: int, fixed: Index,
    legs: Array, noise: Array, rest: Pose, rest_noise: Pose,
) -> tuple[Array, Array, Array, Array, Index]:  # fmt: skip
    """Tracks that were `fixed` before `stamp`: `legs` lead them there, then odometry and its noise."""
    x, C, fixed_x, fixed_covariance = now_x.copy(), now_C.copy(), old_x.copy(), old_covariance.copy()
    fixed_at, of_rest = old_at.copy(), (rest_noise[0], 0.0, 0.0, rest_noise[1], 0.0, rest_noise[2])
    for i in range(len(x)):
        if fixed_at[i] >= stamp:
            continue
        way = legs[np.searchsorted(fixed, fixed_at[i])]
        Q = (way[3], 0.0, 0.0, way[4], 0.0, way[5])
        pose, covariance = carried(fixed_x[i], triangle(fixed_covariance[i]), (way[0], way[1], way[2]), Q)
        fixed_x[i, 0], fixed_x[i, 1], fixed_x[i, 2] = pose
        part = triangle(noise * way[9])
        pose, covariance = carried(fixed_x[i], covariance, (way[6], way[7], way[8]), part)
        fixed_x[i, 0], fixed_x[i, 1], fixed_x[i, 2] = pose
        put(covariance, fixed_covariance[i])
        pose, covariance = carried(fixed_x[i], covariance, rest, of_rest)
        x[i, 0], x[i, 1], x[i, 2] = pose
        put(covariance, C[i])
        fixed_at[i] = stamp
    return x, C, fixed_x, fixed_covariance, fixed_at
