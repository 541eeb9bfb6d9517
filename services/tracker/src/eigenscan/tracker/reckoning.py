"""Dead reckoning by odometry and scan motion together: scan motion corrects odometry.

Odometry comes first and carries the tracks. Scan motion comes later, over some tenths of a second. Odometry
that slips or turns unnoticed is set right by it before it misleads a track that no hypothesis confirms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from eigenscan.tracker.agreement import ScanInterval
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.planar import Pose, between, compose, scaled
from eigenscan.tracker.prediction import carry, motion_noise
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.tracks import Tracks, replace
from numpy.typing import NDArray
from scipy.special import chdtri

Array = NDArray[np.float64]

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

    `correction` is what the scans change of odometry's motion, in the base frame at the end.
    """

    since: int
    stamp: int
    delta: Pose
    noise: Array
    correction: Pose


def leg(interval: ScanInterval, driven: Motion, settings: TrackerSettings) -> Leg:
    """Odometry (`driven`) and scan motion over one interval: Kalman's update of the one by the other."""
    assert interval.moved is not None
    xx, xy, yy = interval.spread
    R = np.array([[xx, xy, 0.0], [xy, yy, 0.0], [0.0, 0.0, interval.turn_variance]])
    R += np.diag(SCAN_SIGMA**2)
    Q = motion_noise(driven, settings)
    off = np.array(between(driven.delta, interval.moved))
    if off @ np.linalg.solve(Q + R, off) > SLIPPED:
        Q += np.outer(off, off)
    gain = Q @ np.linalg.inv(Q + R)
    x, y, turn = (gain @ off).tolist()
    noise = (np.eye(3) - gain) @ Q
    noise = (noise + noise.T) / 2.0
    return Leg(interval.since, interval.stamp, compose(driven.delta, (x, y, turn)), noise, (x, y, turn))


def correct(tracks: Tracks, way: Leg, now: int, motions: Motions, settings: TrackerSettings) -> Tracks:
    """The tracks, predicted to `now`, as if odometry had been what it and the scans give together.

    Those that a hypothesis confirmed later stay as they are.
    """
    open_ = tracks.fixed_at < way.stamp
    if not open_.any():
        return tracks
    fixed_x, fixed_covariance, fixed_at = (
        tracks.fixed_x.copy(),
        tracks.fixed_covariance.copy(),
        tracks.fixed_at.copy(),
    )
    x, C = tracks.x.copy(), tracks.C.copy()
    for at in np.unique(fixed_at[open_]).tolist():
        these = fixed_at == at
        begun = max(at, way.since)
        if at < begun:
            moved = motions(at, begun)
            fixed_x[these], fixed_covariance[these] = carry(
                fixed_x[these], fixed_covariance[these], moved.delta, motion_noise(moved, settings)
            )
        share = (way.stamp - begun) / (way.stamp - way.since)
        delta = way.delta
        if begun > way.since:
            delta = compose(motions(begun, way.stamp).delta, scaled(way.correction, share))
        fixed_x[these], fixed_covariance[these] = carry(
            fixed_x[these], fixed_covariance[these], delta, way.noise * share
        )
    fixed_at[open_] = way.stamp
    rest = motions(way.stamp, now)
    x[open_], C[open_] = carry(
        fixed_x[open_], fixed_covariance[open_], rest.delta, motion_noise(rest, settings)
    )
    return replace(tracks, x=x, C=C, fixed_x=fixed_x, fixed_covariance=fixed_covariance, fixed_at=fixed_at)
