"""Prediction of poses and covariances, beside matrix products and filterpy."""

from __future__ import annotations

import numpy as np
import pytest
from eigenscan.geometry.pose import compose
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.prediction import motion_noise, predict
from eigenscan.tracker.settings import TrackerSettings
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st

SETTINGS = TrackerSettings()


@given(st.integers(0, 10_000))
def test_it_is_filterpys_prediction(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = rng.uniform(-3.0, 3.0, (6, 3))
    root = rng.normal(size=(6, 3, 3)) * 0.1
    C = root @ np.swapaxes(root, 1, 2) + 1e-4 * np.eye(3)
    dx, dy, turn = rng.uniform(-0.5, 0.5, 3)
    moved = Motion((dx, dy, turn), 0.6, abs(turn), rng.uniform(0, 0.3), rng.uniform(0, 0.3), 0.0, 0.2)
    moved_x, moved_C = predict(x, C, moved, SETTINGS)
    assert moved_x == pytest.approx(compose(x, moved.delta), abs=1e-12)
    for row in range(6):
        cos, sin = np.cos(x[row, 2]), np.sin(x[row, 2])
        rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        F = np.eye(3)
        F[:2, 2] = [-sin * dx - cos * dy, cos * dx - sin * dy]
        oracle = KalmanFilter(dim_x=3, dim_z=3)
        oracle.P = C[row].copy()
        oracle.predict(F=F, Q=rotation @ np.diag(motion_noise(moved, SETTINGS)) @ rotation.T)
        assert moved_C[row] == pytest.approx(oracle.P, abs=1e-9)
        assert np.array_equal(moved_C[row], moved_C[row].T)


def test_without_odometry_a_pose_may_be_as_far_as_the_robot_is_fast() -> None:
    moved = Motion((0.0, 0.0, 0.0), way=0.0, turn=0.0, slip=0.0, unknown=0.5, breaks=0.0, seconds=0.0)
    W = motion_noise(moved, TrackerSettings(v_max=2.0, turn_max=3.0))
    np.testing.assert_allclose(np.sqrt(W), [1.0, 1.0, 1.5])
