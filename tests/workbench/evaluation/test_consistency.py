import numpy as np
import pytest
from eigenscan.workbench.evaluation import report
from eigenscan.workbench.evaluation.consistency import apart, bounds, consistency
from eigenscan.workbench.evaluation.figures import windows_figures
from eigenscan.workbench.evaluation.metrics import Judged, Stream, judge
from eigenscan.workbench.evaluation.reference import NS, Trajectory
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate, stats


@pytest.mark.parametrize("n", [1, 7, 80, 900])
def test_bounds_leave_a_fortieth_on_either_side(n: int) -> None:
    low, high = bounds(n)
    # the density of the mean of n: a gamma of shape 3 n / 2 and scale 2 / n
    density = stats.gamma(1.5 * n, scale=2 / n).pdf
    assert integrate.quad(density, 0, low)[0] == pytest.approx(0.025, abs=1e-6)
    assert integrate.quad(density, low, high)[0] == pytest.approx(0.95, abs=1e-6)


@given(
    st.lists(st.floats(0, 20), max_size=40),
    st.sampled_from([0.5, 1.0, 3.0]),
)
def test_the_chosen_are_apart_and_no_other_fits_behind_them(way: list[float], least: float) -> None:
    chosen = apart(np.asarray(way), least).tolist()
    kept: list[float] = []
    for at in sorted(way):
        if not kept or at >= kept[-1] + least:
            kept.append(at)
    assert [way[row] for row in chosen] == kept


def interval_and_mean(squares: np.ndarray) -> tuple[float, float, float]:
    """low, mean, high of squares half a metre apart."""
    found = consistency(squares, np.linspace(0.0, 0.5 * (len(squares) - 1), len(squares)), 0.5)
    assert found.low is not None
    assert found.mean is not None
    assert found.high is not None
    return found.low, found.mean, found.high


def test_covariances_that_are_true_pass_in_95_of_100_runs_and_others_fail() -> None:
    rng = np.random.default_rng(3)
    runs = rng.chisquare(3, (4000, 60))
    inside = [low <= mean <= high for low, mean, high in map(interval_and_mean, runs)]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.012)
    _, mean, high = interval_and_mean(2 * runs[0])
    assert mean > high
    low, mean, _ = interval_and_mean(0.5 * runs[0])
    assert mean < low


def test_scans_of_one_place_and_of_overlapping_windows_count_once() -> None:
    values, way = np.array([2.0, 4.0, 3.0]), np.array([0.0, 1.0, 2.0])
    alone = consistency(values, way, 0.5)
    # each scan ten times over, as a standing robot gives it, and the whole stretch by a second window
    repeated = consistency(np.tile(np.repeat(values, 10), 2), np.tile(np.repeat(way, 10), 2), 0.5)
    assert repeated == alone
    assert alone.n == 3
    assert alone.mean == pytest.approx(3.0)


def test_singular_covariances_do_not_count_and_nothing_has_no_bounds() -> None:
    found = consistency(np.array([np.nan, 5.0]), np.array([0.0, 0.1]), 0.5)
    assert (found.n, found.mean) == (1, 5.0)
    assert consistency(np.empty(0), np.empty(0), 0.5).low is None


def followed(truth: Trajectory, first: int, n: int) -> Judged:
    """A window from row `first` on that is right and claimed throughout, 0.2 m beside the truth."""
    rows = slice(first, first + n)
    offset, ones = np.array([0.0, 0.2, 0.0]), np.ones(n)
    covariances = np.tile(np.diag([0.01, 0.01, 0.01]), (n, 1, 1))
    claimed, count = ones.astype(np.bool_), np.arange(n)
    published = Stream(
        truth.stamps[rows],
        truth.poses[rows] + offset,
        count,
        claimed,
        claimed,
        ones,
        covariances,
        np.where(count % 2, np.nan, 2.5),
        ones,
        count,
    )
    return judge(published, truth)


def test_windows_of_one_log_are_tested_along_one_way() -> None:
    poses = np.stack([0.1 * np.arange(101), np.zeros(101), np.zeros(101)], axis=1)
    truth = Trajectory(np.arange(101) * (NS // 10), poses)
    overlapping = [followed(truth, 0, 61), followed(truth, 20, 61), followed(truth, 40, 61)]
    figures = windows_figures(overlapping, [])
    found = figures["normalised_error_squared"]["consistency"]
    # 10 m of way hold at most 21 scans 0.5 m apart; three windows hold 39
    assert 17 <= found["n"] <= 21
    assert found["mean"] == pytest.approx(0.2**2 / 0.01)
    # every other scan gave the track no hypothesis
    innovations = figures["normalised_innovation_squared"]
    assert innovations["mean"] == pytest.approx(2.5)
    assert 17 <= innovations["consistency"]["n"] <= 21


@pytest.mark.parametrize(
    ("n", "ends"), [(1, "too few to judge"), (9, "too few to judge"), (10, "would be right)")]
)
def test_few_scans_do_not_judge_the_stated_errors(n: int, ends: str) -> None:
    found = {"mean": 0.2, "low": 1.0, "high": 4.0, "n": n, "apart_m": 0.5}
    assert report._consistency(found).endswith(ends)
