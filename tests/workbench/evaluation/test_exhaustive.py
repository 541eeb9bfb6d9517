import numpy as np
import pytest
from eigenscan.geometry.pose import compose
from eigenscan.workbench.evaluation.exhaustive import best_pose, gallery
from hypothesis import given, settings
from hypothesis import strategies as st

# written out, not taken from what is tested: a change there must show here
TRUNCATION_M = 1.0

BEAMS = 24
STEP = 2 * np.pi / BEAMS
DIRECTIONS: np.ndarray = np.arange(BEAMS) * STEP


def direct(panoramas: np.ndarray, ranges: np.ndarray, bins: np.ndarray, cap: float) -> np.ndarray:
    """Cost (P, N) of every position and heading, by the definition."""
    cost = np.zeros(panoramas.shape)
    for row in range(panoramas.shape[0]):
        for heading in range(BEAMS):
            for seen, direction in zip(ranges, bins, strict=True):
                if not np.isnan(seen):
                    predicted = min(panoramas[row, (heading + direction) % BEAMS], cap)
                    cost[row, heading] += min(abs(min(seen, cap) - predicted), TRUNCATION_M)
    return cost


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000), beams=st.integers(1, BEAMS), first=st.integers(-BEAMS, BEAMS))
def test_it_finds_the_least_cost_of_all(seed: int, beams: int, first: int) -> None:
    rng = np.random.default_rng(seed)
    cap = 6.0
    # whole centimetres, so that sums are exact
    panoramas = np.round(rng.uniform(0.2, 8.0, (5, BEAMS)), 2)
    panoramas[rng.random(panoramas.shape) < 0.1] = np.inf
    ranges = np.round(rng.uniform(0.2, 8.0, beams), 2)
    ranges[rng.random(beams) < 0.2] = np.nan
    ranges[rng.random(beams) < 0.1] = np.inf
    bins: np.ndarray = first + np.arange(beams)
    positions = np.stack([np.arange(5.0), np.zeros(5)], axis=1)
    found = best_pose(gallery(positions, panoramas, cap), ranges, bins * STEP, np.zeros(3))
    if np.isnan(ranges).all():
        assert found is None
        return
    assert found is not None
    cost = direct(panoramas, ranges, bins, cap)
    row, heading = int(found[0]), round(found[2] / STEP) % BEAMS
    assert cost[row, heading] == pytest.approx(cost.min(), abs=1e-9)


def test_no_sum_of_a_dense_sensor_is_too_large_for_its_16_bits() -> None:
    panoramas = np.array([[0.3], [5.5]]).repeat(720, axis=1)  # in the first every beam is off by the most
    beams = 1966  # every third: 656 of 100 units each
    directions: np.ndarray = np.arange(beams) * (2 * np.pi / beams)
    shown = gallery(np.array([[0.0, 0.0], [5.0, 5.0]]), panoramas, 15.0)
    found = best_pose(shown, np.full(beams, 5.0), directions, np.zeros(3))
    assert found is not None
    np.testing.assert_allclose(found[:2], [5.0, 5.0], atol=0.01)


def test_the_answer_is_the_base_and_not_the_sensor() -> None:
    rng = np.random.default_rng(0)
    panoramas = rng.uniform(1, 5, (4, BEAMS))
    positions = rng.uniform(-3, 3, (4, 2))
    mount = np.array([0.3, -0.1, 2.0])
    # beams that lie between the grid's directions by a quarter step
    directions: np.ndarray = (np.arange(12) - 4.25) * STEP
    heading = 7
    ranges = panoramas[2, (heading + np.arange(12) - 4) % BEAMS]
    base = best_pose(gallery(positions, panoramas, 10.0), ranges, directions, mount)
    assert base is not None
    sensor = compose(base, mount)
    np.testing.assert_allclose(sensor[:2], positions[2], atol=1e-9)
    # beam 4 saw what lies in the world direction of step 7
    assert abs(np.exp(1j * (sensor[2] + directions[4])) - np.exp(1j * heading * STEP)) < 1e-9


def test_beyond_the_sensors_reach_nothing_counts() -> None:
    rng = np.random.default_rng(4)
    panoramas = rng.uniform(1, 20, (6, BEAMS))
    shown = gallery(np.stack([np.arange(6.0), np.zeros(6)], axis=1), panoramas, 15.0)
    # the sensor reaches 4 m: all that lies further comes back empty
    seen = panoramas[3, (np.arange(BEAMS) + 9) % BEAMS]
    ranges = np.where(seen > 4.0, np.inf, seen)
    found = best_pose(shown.up_to(4.0), ranges, DIRECTIONS, np.zeros(3))
    assert found is not None
    assert (found[0], round(found[2] / STEP) % BEAMS) == (3.0, 9)
    assert shown.up_to(0.0) is shown


def test_a_sensor_of_very_many_beams_does_not_overflow() -> None:
    rng = np.random.default_rng(2)
    panoramas = rng.uniform(1, 20, (3, BEAMS))
    directions = np.repeat(DIRECTIONS, 200)
    ranges = np.repeat(panoramas[1, (np.arange(BEAMS) + 5) % BEAMS], 200)
    found = best_pose(
        gallery(np.zeros((3, 2)) + np.arange(3)[:, None], panoramas, 30.0), ranges, directions, np.zeros(3)
    )
    assert found is not None
    assert found[0] == 1.0
    assert round(found[2] / STEP) % BEAMS == 5
