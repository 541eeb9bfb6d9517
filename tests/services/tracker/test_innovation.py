"""The normalised innovation squared that a track shows: filterpy's, and as large as the covariances state."""

from __future__ import annotations

from itertools import pairwise
from math import inf

import numpy as np
import pytest
from eigenscan.geometry.pose import compose, covariance_from_message, from_message
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.tracking_pb2 import Tracks
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.covariance import residual
from eigenscan.tracker.observation import limit_sigma
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.prediction import motion_noise
from eigenscan.tracker.settings import TrackerSettings
from filterpy.kalman import KalmanFilter
from scipy.stats import chi2

from tests.services.tracker.conftest import MakeCore, Speaker, TracksOf

SETTINGS = TrackerSettings()
STEP = np.array([0.6, 0.0, 0.2])
"""So far that each scan counts in full."""
R = np.diag([0.05, 0.04, 0.02]) ** 2
AWAY = np.array([9.0, 9.0, 1.0])
"""Of a second hypothesis, in nobody's gate."""


def noise() -> np.ndarray:
    return np.diag(motion_noise(Motion((*STEP,), 0.6, 0.2, 0.0, 0.0, 0.0, 0.5), SETTINGS))


def oracle(before: np.ndarray, C: np.ndarray, seen: np.ndarray) -> float:
    """By filterpy: its prediction from a track, by derivatives taken in small steps, and its innovation."""
    small, after = 1e-6 * np.eye(3), compose(before, STEP)
    F = np.stack([residual(compose(before + h, STEP), after) for h in small], axis=1) / 1e-6
    G = np.stack([residual(compose(before, STEP + h), after) for h in small], axis=1) / 1e-6
    kalman = KalmanFilter(dim_x=3, dim_z=3)
    kalman.x, kalman.P, kalman.H = before.copy(), C.copy(), np.eye(3)
    kalman.predict(F=F, Q=G @ noise() @ G.T)
    kalman.x = after
    kalman.update(seen, R=limit_sigma(R[None])[0])
    return float(kalman.y @ kalman.SI @ kalman.y)


def drive(
    core: TrackerCore, speaker: Speaker, tracks_of: TracksOf, scans: int, seed: int
) -> list[tuple[Tracks, np.ndarray]]:
    """A robot whose odometry and hypotheses err as their covariances state; (tracks, what was seen)."""
    rng = np.random.default_rng(seed)
    truth, odometry = np.array([2.0, 3.0, 0.1]), np.zeros(3)
    speaker.covariance, speaker.clutter, received = R, 0, []
    for scan in range(scans):
        time = 10.0 + 0.5 * scan
        seen = truth + rng.multivariate_normal(np.zeros(3), R)
        core.handle(speaker.odometry(time, odometry))
        output = core.handle(speaker.hypotheses(time, [seen, compose(seen, AWAY)], [17.0, 5.0]))
        received += [(tracks, seen) for tracks in tracks_of(output)]
        odometry = compose(odometry, STEP)
        truth = compose(truth, STEP + rng.multivariate_normal(np.zeros(3), noise()))
    assert len(received) == scans
    return received


def test_it_is_filterpys(make_core: MakeCore, speaker: Speaker, tracks_of: TracksOf) -> None:
    received = drive(make_core(), speaker, tracks_of, 12, 1)
    assert not received[0][0].tracks[0].HasField("nis")
    for (earlier, _), (later, seen) in pairwise(received):
        before = next(track for track in earlier.tracks if track.id == later.tracks[0].id)
        pose, C = from_message(before.pose), covariance_from_message(before.covariance)
        assert later.tracks[0].nis == pytest.approx(oracle(pose, C, seen), rel=1e-5)


def test_a_scan_that_gives_a_track_no_hypothesis_leaves_none(
    make_core: MakeCore, speaker: Speaker, tracks_of: TracksOf
) -> None:
    core = make_core(tracks_hz=inf)
    drive(core, speaker, tracks_of, 3, 1)
    (unusable,) = tracks_of(
        core.handle(speaker.hypotheses(11.0, [], [], status=Hypotheses.STATUS_UNUSABLE_SCAN, lidar="rear"))
    )
    (away,) = tracks_of(core.handle(speaker.hypotheses(11.0, [AWAY], [17.0], lidar="side")))
    assert len(unusable.tracks) > 0
    assert not any(track.HasField("nis") for message in (unusable, away) for track in message.tracks)


def test_right_covariances_give_innovations_within_their_bounds(
    make_core: MakeCore, speaker: Speaker, tracks_of: TracksOf
) -> None:
    received = drive(make_core(), speaker, tracks_of, 400, 2)
    squares = [tracks.tracks[0].nis for tracks, _ in received[1:]]
    low, high = chi2.interval(0.95, 3 * len(squares))
    assert low < sum(squares) < high
