import numpy as np
import pytest
from eigenscan.eigenspace.components import all_coefficients, analyse, autocovariance
from eigenscan.eigenspace.panorama import windows
from eigenscan.eigenspace.ranges import RangeTransform
from eigenscan.eigenspace.symmetric_toeplitz import eigenpairs
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh, toeplitz


def panoramas(count: int, turn: int, seed: int = 0) -> np.ndarray:
    """Smooth rings with jumps, 1 to 12 m."""
    rng = np.random.default_rng(seed)
    angle = np.arange(turn) * (2 * np.pi / turn)
    rings = rng.uniform(2, 6, (count, 1)) + rng.normal(0, 0.6, (count, 5)) @ np.cos(
        np.outer(np.arange(1, 6), angle) + rng.uniform(0, 6, (5, 1))
    )
    rings += 3.0 * (rng.random((count, turn)) < 0.05)
    return rings.astype(np.float32)


def every_window(values: np.ndarray, beams: int) -> np.ndarray:
    """[p, k] is the window k of panorama p, (P, N, B)."""
    turn = values.shape[1]
    return np.stack([np.roll(values, -k, axis=1)[:, :beams] for k in range(turn)], axis=1)


def direct_covariance(values: np.ndarray, beams: int) -> tuple[np.ndarray, np.ndarray]:
    """All N P scans, one by one, and their covariance, as the paper has it."""
    scans = np.array(
        [np.roll(ring, -k)[:beams] for ring in values.astype(np.float64) for k in range(len(ring))]
    )
    mean = scans.mean(axis=0)
    centred = scans - mean
    return mean, centred.T @ centred / len(scans)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 999), turn=st.integers(8, 60), share=st.floats(0.2, 1.0), count=st.integers(1, 6))
def test_the_toeplitz_covariance_is_the_direct_one(seed: int, turn: int, share: float, count: int) -> None:
    values = panoramas(count, turn, seed)
    beams = max(1, int(turn * share))
    mean, covariance = autocovariance(values)
    direct_mean, direct = direct_covariance(values, beams)
    # every heading is in the set: the mean scan is one constant
    np.testing.assert_allclose(direct_mean, mean, rtol=1e-9)
    np.testing.assert_allclose(toeplitz(covariance[:beams]), direct, atol=1e-9 * direct.max())


def test_the_toeplitz_covariance_is_the_direct_one_at_half_a_degree() -> None:
    values = panoramas(3, 720)
    _, covariance = autocovariance(values)
    _, direct = direct_covariance(values, 361)
    np.testing.assert_allclose(toeplitz(covariance[:361]), direct, atol=1e-9 * direct.max())


def test_components_are_the_eigenvectors_of_the_direct_covariance_largest_first() -> None:
    values = panoramas(6, 90)
    space = analyse(values, 46, count=5)
    _, direct = direct_covariance(values, 46)
    np.testing.assert_allclose(
        direct @ space.vectors.T, space.vectors.T * space.eigenvalues, atol=1e-4 * space.eigenvalues[0]
    )
    np.testing.assert_allclose(space.vectors @ space.vectors.T, np.eye(5), atol=1e-5)
    np.testing.assert_allclose(space.eigenvalues, np.sort(np.linalg.eigvalsh(direct))[::-1][:5], rtol=1e-5)
    assert space.total_variance == pytest.approx(np.trace(direct), rel=1e-9)


@pytest.mark.parametrize("share", [0.3, 0.8, 0.95, 0.999])
def test_the_fewest_components_that_hold_the_share(share: float) -> None:
    values = panoramas(6, 90)
    space = analyse(values, 46, share=share)
    assert space.explained >= share - 1e-6
    assert space.eigenvalues[:-1].sum() / space.total_variance < share


def test_projection_reconstruction_and_error_are_the_papers() -> None:
    values = panoramas(5, 80, 3)
    space = analyse(values, 41, count=7)
    scans = windows(values, [3, 70, 79, 0, 41], 41)
    coefficients = space.project(scans)
    expected = np.array(
        [[v @ (scan - space.mean) for v in space.vectors] for scan in scans.astype(np.float64)]
    )
    np.testing.assert_allclose(coefficients, expected, atol=1e-4)
    best = np.array([np.linalg.lstsq(space.vectors.T, scan - space.mean)[0] for scan in scans])
    np.testing.assert_allclose(coefficients, best, atol=1e-4)
    np.testing.assert_allclose(space.error(scans), scans - (best @ space.vectors + space.mean), atol=1e-4)
    np.testing.assert_allclose(space.energy(scans), np.linalg.norm(space.error(scans), axis=1), rtol=1e-5)
    # the error is orthogonal to the subspace
    assert np.abs(space.error(scans) @ space.vectors.T).max() < 1e-3


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 999),
    turn=st.integers(4, 70),
    part=st.floats(0.05, 1.0),
    share=st.floats(0.1, 1.0),
    count=st.integers(1, 6),
)
def test_scan_is_reconstruction_and_error_at_right_angles_for_any_beam_count(
    seed: int, turn: int, part: float, share: float, count: int
) -> None:
    values = panoramas(count, turn, seed)
    space = analyse(values, max(1, int(turn * part)), share=share)
    every = every_window(values, space.beams).reshape(-1, space.beams).astype(np.float64)
    vectors = space.vectors.astype(np.float64)
    direct = np.zeros_like(every)
    for vector in vectors:
        direct += np.outer((every - space.mean) @ vector, vector)
    np.testing.assert_allclose(space.reconstruct(space.project(every)), direct + space.mean, atol=2e-3)
    error = every - space.mean - direct
    np.testing.assert_allclose(space.error(every), error, atol=2e-3)
    np.testing.assert_allclose(space.energy(every), np.sqrt((error**2).sum(axis=1)), atol=5e-3)
    # what the components leave out is what all errors hold on average (eq. 4, summed over the training set)
    left_over = space.total_variance - space.eigenvalues.sum(dtype=np.float64)
    assert (error**2).sum(axis=1).mean() == pytest.approx(
        left_over, rel=1e-3, abs=1e-3 * space.total_variance
    )


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 999), turn=st.integers(4, 70), part=st.floats(0.05, 1.0), count=st.integers(1, 70))
def test_coefficients_of_all_headings_are_those_of_each_window(
    seed: int, turn: int, part: float, count: int
) -> None:
    values = panoramas(count, turn, seed)
    space = analyse(values, max(1, int(turn * part)), share=0.8)
    every = every_window(values, space.beams)
    np.testing.assert_allclose(all_coefficients(values, space), space.project(every), atol=2e-3)


def test_signs_do_not_depend_on_the_solver() -> None:
    values = panoramas(6, 90)
    few, many = analyse(values, 46, count=3), analyse(values, 46, share=0.9999)
    np.testing.assert_allclose(few.vectors, many.vectors[:3], atol=1e-4)


def test_beams_without_a_wall_count_as_the_cap_and_leave_it_exact() -> None:
    values = panoramas(4, 60, 5)
    values[1, 7:30], values[2] = np.inf, np.inf
    clipped = RangeTransform(5.0)(values)
    assert clipped.max() == 5.0
    _, covariance = autocovariance(clipped)
    np.testing.assert_allclose(toeplitz(covariance[:31]), direct_covariance(clipped, 31)[1], atol=1e-9)


def test_what_cannot_be_analysed_is_refused() -> None:
    values = panoramas(2, 20)
    for bad in (np.inf, np.nan):
        broken = values.copy()
        broken[1, 3] = bad
        with pytest.raises(ValueError, match="not finite"), np.errstate(invalid="ignore"):
            analyse(broken, 10)
    with pytest.raises(ValueError, match="no panoramas"):
        analyse(np.empty((0, 20), np.float32), 10)
    for beams in (0, 21):
        with pytest.raises(ValueError, match=f"{beams} beams"):
            analyse(values, beams)


def test_a_round_room_has_no_variance_and_is_no_fault() -> None:
    space = analyse(np.full((3, 24), 4.0, np.float32), 13)
    assert len(space.eigenvalues) == 1
    np.testing.assert_allclose(space.reconstruct(space.project(np.full(13, 4.0))), 4.0, rtol=1e-6)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 999), beams=st.integers(1, 40), count=st.integers(1, 40))
def test_the_halved_eigenproblem_is_the_whole_one(seed: int, beams: int, count: int) -> None:
    row = np.random.default_rng(seed).normal(size=beams) + beams * (np.arange(beams) == 0)
    matrix, count = toeplitz(row), min(count, beams)
    values, vectors = eigenpairs(row, count)
    np.testing.assert_allclose(values, eigh(matrix, eigvals_only=True)[::-1][:count], rtol=1e-9)
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(count), atol=1e-9)
    np.testing.assert_allclose(matrix @ vectors.T, vectors.T * values, atol=1e-9 * beams)
