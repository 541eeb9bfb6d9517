"""Lists of neighbouring scans go on from each other; those of a robot that was carried away do not."""

from __future__ import annotations

import numpy as np
import pytest
from eigenscan.geometry.pose import compose
from eigenscan.tracker.continuity import goes_on
from eigenscan.tracker.odometry import Motion
from hypothesis import given
from hypothesis import strategies as st


def moved(x: float, turn: float, unknown: float = 0.0) -> Motion:
    return Motion((x, 0.0, turn), abs(x), abs(turn), 0.0, unknown, 0.0, 0.1)


def somewhere(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform([0, 0, -np.pi], [40, 40, np.pi], (count, 3))


@given(st.integers(0, 10_000), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.integers(0, 9))
def test_one_that_goes_on_is_enough(seed: int, x: float, turn: float, which: int) -> None:
    rng = np.random.default_rng(seed)
    before, after = somewhere(rng, 20), somewhere(rng, 20)
    after[17] = compose(before[which], np.array([x, 0.0, turn])) + rng.uniform(-1, 1, 3) * [0.15, 0.15, 0.09]
    assert goes_on(before, after, moved(x, turn)) is True


def test_a_list_of_elsewhere_breaks_off() -> None:
    rng = np.random.default_rng(0)
    broken = [goes_on(somewhere(rng, 20), somewhere(rng, 20), moved(0.05, 0.02)) is False for _ in range(100)]
    assert np.mean(broken) > 0.95


def test_the_same_place_by_wrong_odometry_breaks_off() -> None:
    before = somewhere(np.random.default_rng(1), 10)
    assert goes_on(before, compose(before, np.array([0.9, 0.0, 0.0])), moved(0.05, 0.0)) is False


@pytest.mark.parametrize(
    ("before", "after", "motion"),
    [
        (4, 20, moved(0.1, 0.0)),
        (20, 4, moved(0.1, 0.0)),
        (20, 0, moved(0.1, 0.0)),
        (20, 20, moved(2.0, 0.0)),
        (20, 20, moved(0.1, 2.0)),
        (20, 20, moved(0.0, 0.0, unknown=1.0)),
    ],
)
def test_what_cannot_be_compared_tells_nothing(before: int, after: int, motion: Motion) -> None:
    rng = np.random.default_rng(2)
    assert goes_on(somewhere(rng, before), somewhere(rng, after), motion) is None
