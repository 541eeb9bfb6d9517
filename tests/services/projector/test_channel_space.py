"""The eigenspace against its direct, slow formulas."""

import os
import subprocess
import sys

import numpy as np
import pytest
from eigenscan.projector.channel_space import ChannelSpaces, analyse_channels, coefficients, error_squares
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray


def _panoramas(channels: int, positions: int, turn: int, seed: int) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    return (rng.normal(size=(channels, positions, turn)) + rng.normal(size=(channels, 1, 1))).astype(
        np.float32
    )


def _every_window(panoramas: NDArray[np.float32], beams: int) -> NDArray[np.float64]:
    """All scans one by one, (P, N, F, J)."""
    _, positions, turn = panoramas.shape
    return np.array(
        [
            [panoramas[:, p, (k + np.arange(beams)) % turn].astype(np.float64) for k in range(turn)]
            for p in range(positions)
        ]
    )


sizes = st.tuples(
    st.integers(1, 2), st.integers(1, 5), st.integers(6, 24), st.integers(1, 6), st.integers(0, 2**16)
)


@settings(max_examples=40, deadline=None)
@given(sizes)
def test_covariance_and_vectors_are_those_of_all_scans_formed_one_by_one(
    size: tuple[int, int, int, int, int],
) -> None:
    channels, positions, turn, beams, seed = size
    panoramas = _panoramas(channels, positions, turn, seed)
    space = analyse_channels(panoramas, beams, count=channels * beams)
    scans = _every_window(panoramas, beams).reshape(positions * turn, channels * beams)
    mean = np.repeat(panoramas.astype(np.float64).mean(axis=(1, 2)), beams)
    direct = (scans - mean).T @ (scans - mean) / len(scans)
    vectors = space.vectors.reshape(-1, channels * beams)
    rebuilt = vectors.T @ np.diag(space.eigenvalues) @ vectors
    assert np.allclose(rebuilt, direct, atol=1e-9 * max(1.0, np.abs(direct).max()))
    assert np.allclose(vectors @ vectors.T, np.eye(len(vectors)), atol=1e-9)
    assert np.all(np.diff(space.eigenvalues) <= 1e-12)
    assert space.total_variance == pytest.approx(np.trace(direct))


@settings(max_examples=40, deadline=None)
@given(sizes, st.integers(1, 4))
def test_coefficients_are_inner_products(size: tuple[int, int, int, int, int], every: int) -> None:
    channels, positions, turn, beams, seed = size
    panoramas = _panoramas(channels, positions, turn, seed)
    space = analyse_channels(panoramas, beams, count=3)
    scans = _every_window(panoramas, beams)[:, ::every] - space.mean[:, None]
    direct = np.einsum("pkfj,mfj->pkm", scans, space.vectors)
    assert np.allclose(coefficients(panoramas, space, every), direct, atol=1e-4)


@settings(max_examples=40, deadline=None)
@given(sizes, st.integers(1, 4), st.integers(1, 4))
def test_error_squares_are_those_of_each_error_vector(
    size: tuple[int, int, int, int, int], every: int, kept: int
) -> None:
    channels, positions, turn, beams, seed = size
    panoramas = _panoramas(channels, positions, turn, seed)
    space = analyse_channels(panoramas, beams, count=kept)
    scans = _every_window(panoramas, beams)[:, ::every] - space.mean[:, None]
    rebuilt = np.einsum("pkm,mfj->pkfj", np.einsum("pkfj,mfj->pkm", scans, space.vectors), space.vectors)
    direct = ((scans - rebuilt) ** 2).mean(axis=(2, 3))
    found = error_squares(panoramas, space, coefficients(panoramas, space, every), every)
    assert np.allclose(found, direct, atol=1e-4)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**16), st.integers(0, 11))
def test_projection_without_the_missing_beams_is_regularised_least_squares(seed: int, missing: int) -> None:
    rng = np.random.default_rng(seed)
    spaces = [analyse_channels(_panoramas(2, 4, 24, seed + r), 12, count=5) for r in range(3)]
    scan = rng.normal(size=(2, 12)).astype(np.float32)
    seen = np.ones(12, dtype=bool)
    seen[rng.choice(12, missing, replace=False)] = False
    alpha, square = ChannelSpaces.of(spaces).project(scan, seen)
    for r, space in enumerate(spaces):
        basis = space.vectors[:, :, seen].reshape(5, -1).T
        target = (scan[:, seen] - space.mean[:, None]).ravel()
        rows = np.vstack([basis, np.diag(np.sqrt(space.noise / space.eigenvalues))])
        direct, *_ = np.linalg.lstsq(rows, np.concatenate([target, np.zeros(5)]), rcond=None)
        # the vectors are in single precision
        assert np.allclose(alpha[r], direct, atol=1e-4)
        assert square[r] == pytest.approx(np.mean((target - basis @ direct) ** 2), abs=1e-5)


def test_nothing_to_analyse_is_said() -> None:
    with pytest.raises(ValueError, match="no finite panoramas"):
        analyse_channels(np.empty((1, 0, 12), dtype=np.float32), 4, 2)
    with pytest.raises(ValueError, match="no finite panoramas"):
        analyse_channels(np.full((1, 2, 12), np.nan, dtype=np.float32), 4, 2)


def test_an_analysis_in_a_notebook_keeps_linear_algebra_to_one_thread() -> None:
    # more than one spin while they wait for a busy core, and sum in an order of their own
    code = (
        "import numpy as np, threadpoolctl; from eigenscan.projector.channel_space import analyse_channels;"
        "analyse_channels(np.random.default_rng(1).normal(size=(1, 2, 8)).astype(np.float32), 4, 2);"
        "print({p['num_threads'] for p in threadpoolctl.threadpool_info() if p['user_api'] == 'blas'})"
    )
    env = {**os.environ, "OMP_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "4"}
    told = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "{1}"
