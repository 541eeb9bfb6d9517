from __future__ import annotations

import filterpy.stats
import numpy as np
import pytest
from eigenscan.geometry.symmetric import inverse_each
from eigenscan.tracker.association import crowding_each
from eigenscan.tracker.covariance import is_covariance, mahalanobis_squared
from eigenscan.tracker.symmetric import fuse_each, moments_of
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from tests.services.tracker.readable import associate


def covariances(seed: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(count, 3, 3)) * np.array([0.1, 0.2, 0.05])[:, None]
    return root @ np.swapaxes(root, 1, 2) + np.eye(3) * 1e-4


@given(st.integers(0, 10_000))
def test_batched_fusion_is_filterpys_update(seed: int) -> None:
    rng = np.random.default_rng(seed)
    C, R = covariances(seed, 7), covariances(seed + 1, 7)
    x = rng.uniform(-2.0, 2.0, (7, 3))
    y = x + rng.normal(size=(7, 3)) * 0.2
    fused_x, fused_C = fuse_each(x, C, y, R)
    for row in range(7):
        oracle = KalmanFilter(dim_x=3, dim_z=3)
        oracle.x, oracle.P, oracle.H = x[row].copy(), C[row].copy(), np.eye(3)
        oracle.update(y[row], R=R[row])
        assert fused_x[row] == pytest.approx(oracle.x, abs=1e-9)
        assert fused_C[row] == pytest.approx(oracle.P, abs=1e-9)


@given(st.integers(0, 10_000))
def test_distance_is_filterpys_mahalanobis(seed: int) -> None:
    rng = np.random.default_rng(seed)
    C = covariances(seed, 5)
    delta = rng.normal(size=(5, 3))
    squared = mahalanobis_squared(delta, C)
    for row in range(5):
        expected = filterpy.stats.mahalanobis(delta[row], np.zeros(3), C[row]) ** 2
        assert squared[row] == pytest.approx(expected, rel=1e-8)
    assert inverse_each(C) @ C == pytest.approx(np.tile(np.eye(3), (5, 1, 1)), abs=1e-7)


def test_fusion_across_the_turn_takes_the_short_way() -> None:
    C = np.eye(3)[None] * 0.01
    x, _ = fuse_each(np.array([[0.0, 0.0, np.pi - 0.02]]), C, np.array([[0.0, 0.0, -np.pi + 0.04]]), C)
    assert x[0, 2] == pytest.approx(-np.pi + 0.01, abs=1e-12)


def test_moments_across_the_turn() -> None:
    C = np.tile(np.eye(3) * 1e-4, (2, 1, 1))
    mean, covariance = moments_of(np.array([[1.0, 0.0, 3.1], [1.0, 0.2, -3.1]]), C, np.array([1.0, 1.0]))
    half = np.pi - 3.1
    assert mean == pytest.approx([1.0, 0.1, -np.pi], abs=1e-12)
    assert covariance[2, 2] == pytest.approx(1e-4 + half**2)
    assert covariance[1, 2] == pytest.approx(0.1 * half)


@pytest.mark.parametrize(
    ("matrix", "good"),
    [
        (np.eye(3), True),
        (np.diag([1e-6, 1e-6, 1e-8]), True),
        (np.zeros((3, 3)), False),
        (np.diag([1.0, -1.0, 1.0]), False),
        (np.diag([-1.0, -1.0, 1.0]), False),
        (np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), False),
        (np.full((3, 3), np.nan), False),
        (np.diag([1.0, np.inf, 1.0]), False),
        (np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), False),
    ],
)
def test_what_is_a_covariance(matrix: np.ndarray, good: bool) -> None:
    assert bool(is_covariance(matrix)) is good


@given(st.integers(0, 10_000))
def test_gate_finds_the_pairs_that_all_pairs_would(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-1, 1, (6, 3)) * [1, 1, np.pi], rng.uniform(-1, 1, (9, 3)) * [1, 1, np.pi]
    C, R = covariances(seed, 6), covariances(seed + 1, 9)
    pairs = associate(x, C, y, R, gate=12.0)
    expected = []
    for i in range(6):
        for k in range(9):
            delta = y[k] - x[i]
            delta[2] = (delta[2] + np.pi) % (2 * np.pi) - np.pi
            if delta @ np.linalg.inv(C[i] + R[k]) @ delta <= 12.0:
                expected.append((i, k))
    assert list(zip(pairs.track.tolist(), pairs.hypothesis.tolist(), strict=True)) == expected


def test_overlap_is_the_expected_bump_under_the_track() -> None:
    C, R = covariances(3, 1), covariances(4, 1)
    x, y = np.zeros((1, 3)), np.array([[0.05, -0.02, 0.01]])
    pairs = associate(x, C, y, R, gate=100.0)
    rng = np.random.default_rng(0)
    drawn = rng.multivariate_normal(np.zeros(3), C[0], 400_000) - y[0]
    bump = np.exp(-0.5 * np.einsum("ni,ij,nj->n", drawn, np.linalg.inv(R[0]), drawn))
    assert np.exp(pairs.log_overlap[0]) == pytest.approx(bump.mean(), rel=0.02)
    # and it is the paper's p(Y|X) up to the volume of the bump
    density = multivariate_normal(np.zeros(3), C[0] + R[0]).pdf(y[0])
    volume = np.sqrt(np.linalg.det(2 * np.pi * R[0]))
    assert np.exp(pairs.log_overlap[0]) == pytest.approx(density * volume, rel=1e-9)


def test_one_peak_listed_twice_counts_once() -> None:
    R = np.tile(np.diag([0.05, 0.05, 0.02]) ** 2, (3, 1, 1))
    y = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    assert crowding_each(y, R) == pytest.approx([2.0, 2.0, 1.0])
