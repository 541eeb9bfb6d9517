"""The analysis against its direct, slow formulas: all windows of all panoramas, one by one."""

import os
import subprocess
import sys

import numpy as np
import pytest
from eigenscan.eigenspace.components import analyse, coefficients, error_squares
from eigenscan.eigenspace.embedding import CIRCUMFERENCE, Embedding
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray


def panoramas(channels: int, positions: int, turn: int, seed: int) -> NDArray[np.float32]:
    """Rings of 1 m or so with a trend over the bearing, so that neighbouring beams are alike."""
    rng = np.random.default_rng(seed)
    rough = rng.normal(size=(channels, positions, turn)) + rng.normal(size=(channels, 1, 1))
    smooth = np.cumsum(rng.normal(size=(channels, positions, turn)), axis=2) / np.sqrt(turn)
    return (rough + 2.0 * smooth).astype(np.float32)


def every_window(rings: NDArray[np.float32], beams: int) -> NDArray[np.float64]:
    """All scans one by one, (P, N, F, J)."""
    _, positions, turn = rings.shape
    return np.array(
        [
            [rings[:, p, (k + np.arange(beams)) % turn].astype(np.float64) for k in range(turn)]
            for p in range(positions)
        ]
    )


sizes = st.tuples(
    st.integers(1, 2), st.integers(1, 5), st.integers(6, 24), st.integers(1, 6), st.integers(0, 2**16)
)
Size = tuple[int, int, int, int, int]


@settings(max_examples=60, deadline=None)
@given(sizes, st.integers(1, 12))
def test_the_space_is_that_of_a_dense_analysis_of_all_windows(size: Size, kept: int) -> None:
    channels, positions, turn, beams, seed = size
    rings = panoramas(channels, positions, turn, seed)
    space = analyse(rings, beams, kept)
    scans = every_window(rings, beams).reshape(positions * turn, channels * beams)
    offset = scans - scans.mean(axis=0)
    covariance = offset.T @ offset / len(scans)
    values = np.linalg.eigvalsh(covariance)[::-1]
    kept = min(kept, channels * beams)
    scale = max(float(values[0]), 1e-3)
    # every heading is in the set: the mean scan is one number a channel
    np.testing.assert_allclose(np.repeat(space.mean, beams), scans.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(space.eigenvalues, np.maximum(values[:kept], 0), atol=1e-5 * scale)
    vectors = space.vectors.reshape(kept, -1).astype(np.float64)
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(kept), atol=1e-5)
    # what they leave out is what the dense analysis leaves out, however alike eigenvalues may be
    rest = offset - offset @ vectors.T @ vectors
    assert (rest**2).sum(axis=1).mean() == pytest.approx(values[kept:].sum(), abs=1e-5 * scale * len(values))
    np.testing.assert_allclose(covariance @ vectors.T, vectors.T * values[:kept], atol=2e-5 * scale)
    assert space.total_variance == pytest.approx(np.trace(covariance), rel=1e-5, abs=1e-6)
    assert space.noise == pytest.approx(values[kept:].sum() / (channels * beams), abs=1e-5 * scale)


def test_plain_ranges_of_half_a_turn_are_the_papers_case() -> None:
    rings = Embedding("range", 6.0)(np.abs(panoramas(1, 3, 180, 1)[0]) * 3.0)
    space = analyse(rings, 91, 8)
    scans = every_window(rings, 91).reshape(-1, 91)
    offset = scans - scans.mean(axis=0)
    direct = np.linalg.svd(offset / np.sqrt(len(scans)), full_matrices=False)
    np.testing.assert_allclose(space.eigenvalues, direct.S[:8] ** 2, rtol=1e-4)
    assert np.all(np.abs(np.sum(space.vectors[:3, 0] * direct.Vh[:3], axis=1)) > 0.999)


@settings(max_examples=40, deadline=None)
@given(sizes, st.integers(1, 4))
def test_coefficients_are_inner_products(size: Size, every: int) -> None:
    channels, positions, turn, beams, seed = size
    rings = panoramas(channels, positions, turn, seed)
    space = analyse(rings, beams, count=3)
    scans = every_window(rings, beams)[:, ::every] - space.mean[:, None]
    direct = np.einsum("pkfj,mfj->pkm", scans, space.vectors)
    assert np.allclose(coefficients(rings, space, every), direct, atol=1e-4)


@settings(max_examples=40, deadline=None)
@given(sizes, st.integers(1, 4), st.integers(1, 4))
def test_error_squares_are_those_of_each_error_vector(size: Size, every: int, kept: int) -> None:
    channels, positions, turn, beams, seed = size
    rings = panoramas(channels, positions, turn, seed)
    space = analyse(rings, beams, count=kept)
    scans = every_window(rings, beams)[:, ::every] - space.mean[:, None]
    alphas = np.einsum("pkfj,mfj->pkm", scans, space.vectors)
    rebuilt = np.einsum("pkm,mfj->pkfj", alphas, space.vectors)
    direct = ((scans - rebuilt) ** 2).mean(axis=(2, 3))
    found = error_squares(rings, space, coefficients(rings, space, every), every)
    assert np.allclose(found, direct, atol=1e-4)
    one = space.reconstruct(alphas[0, 0].astype(np.float32)) - space.mean[:, None]
    assert np.allclose(one, rebuilt[0, 0], atol=1e-4)


@given(st.integers(0, 2**16))
@settings(max_examples=10, deadline=None)
def test_signs_do_not_depend_on_how_many_components_are_asked_for(seed: int) -> None:
    rings = panoramas(2, 4, 24, seed)
    few, many = analyse(rings, 12, count=2), analyse(rings, 12, count=24)
    apart = np.abs(np.diff(many.eigenvalues[:3])) > 0.05 * many.eigenvalues[0]
    if apart.all():
        np.testing.assert_allclose(few.vectors, many.vectors[:2], atol=1e-4)


def test_what_cannot_be_analysed_is_refused() -> None:
    with pytest.raises(ValueError, match="no finite panoramas"):
        analyse(np.empty((1, 0, 12), dtype=np.float32), 4, 2)
    with pytest.raises(ValueError, match="no finite panoramas"):
        analyse(np.full((1, 2, 12), np.nan, dtype=np.float32), 4, 2)
    for beams in (0, 21):
        with pytest.raises(ValueError, match=f"{beams} beams"):
            analyse(np.ones((1, 2, 20), dtype=np.float32), beams, 2)


def test_a_round_room_has_no_variance_and_is_no_fault() -> None:
    space = analyse(np.full((1, 3, 24), 4.0, np.float32), 13, 3)
    assert space.eigenvalues.max() == pytest.approx(0.0, abs=1e-9)
    assert space.noise > 0


def test_an_analysis_in_a_notebook_keeps_linear_algebra_to_one_thread() -> None:
    # more than one spin while they wait for a busy core, and sum in an order of their own
    code = (
        "import numpy as np, threadpoolctl; from eigenscan.eigenspace.components import analyse;"
        "analyse(np.random.default_rng(1).normal(size=(1, 2, 8)).astype(np.float32), 4, 2);"
        "print({p['num_threads'] for p in threadpoolctl.threadpool_info() if p['user_api'] == 'blas'})"
    )
    env = {**os.environ, "OMP_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "4"}
    reported = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
    )
    assert reported.stdout.strip() == "{1}"


def test_on_the_ring_a_range_is_a_place_and_no_wall_counts_as_the_cap() -> None:
    ring = Embedding.of("ring")
    radius = CIRCUMFERENCE / (2 * np.pi)
    ranges = np.array([0.0, CIRCUMFERENCE / 4, CIRCUMFERENCE / 2, np.inf, 99.0])
    cosine, sine = ring(ranges)
    np.testing.assert_allclose(cosine[:3], [radius, 0.0, -radius], atol=1e-5)
    np.testing.assert_allclose(sine[:3], [0.0, radius, 0.0], atol=1e-5)
    assert cosine[3] == cosine[4]
    np.testing.assert_allclose(cosine**2 + sine**2, radius**2, rtol=1e-5)
    np.testing.assert_array_equal(Embedding("range", 5.0)([1.0, np.inf, 7.0]), [[1.0, 5.0, 5.0]])
    for cap in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="range cap"):
            Embedding("range", cap)
    with pytest.raises(ValueError, match="embedding"):
        Embedding("cube", 5.0)  # type: ignore[arg-type]
