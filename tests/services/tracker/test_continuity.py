"""Lists of neighbouring scans go on from each other; those of a robot that was carried away do not."""

from __future__ import annotations

import numpy as np
import pytest
from eigenscan.geometry.pose import compose
from eigenscan.tracker.continuity import carried_ratio, goes_on, is_broken
from eigenscan.tracker.odometry import Motion
from hypothesis import given
from hypothesis import strategies as st

# written out, not taken from what is tested: a change there must show here
COMPARED = 10


def moved(x: float, turn: float, unknown: float = 0.0) -> Motion:
    return Motion((x, 0.0, turn), abs(x), abs(turn), 0.0, unknown, 0.0, 0.1)


def somewhere(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform([0, 0, -np.pi], [40, 40, np.pi], (count, 3))


@given(st.integers(0, 10_000), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.integers(0, 9))
def test_one_that_goes_on_is_enough(seed: int, x: float, turn: float, which: int) -> None:
    rng = np.random.default_rng(seed)
    before, after = somewhere(rng, 20), somewhere(rng, 20)
    after[17] = compose(before[which], np.array([x, 0.0, turn])) + rng.uniform(-1, 1, 3) * [0.15, 0.15, 0.09]
    assert goes_on(before, after, moved(x, turn))


def test_a_list_of_elsewhere_breaks_off() -> None:
    rng = np.random.default_rng(0)
    broken = [goes_on(somewhere(rng, 20), somewhere(rng, 20), moved(0.05, 0.02)) == 0 for _ in range(100)]
    assert np.mean(broken) > 0.95


def test_the_same_place_by_wrong_odometry_breaks_off() -> None:
    before = somewhere(np.random.default_rng(1), 10)
    assert goes_on(before, compose(before, np.array([0.9, 0.0, 0.0])), moved(0.05, 0.0)) == 0


@given(st.integers(0, 10_000), st.integers(0, COMPARED))
def test_those_that_go_on_are_counted(seed: int, stay: int) -> None:
    """Of ten places far apart as many as have a neighbour in the next list, wherever they stand in it."""
    rng = np.random.default_rng(seed)
    before = np.column_stack([10.0 * np.arange(COMPARED), np.zeros(COMPARED), np.zeros(COMPARED)])
    step = np.array([0.05, 0.0, 0.02])
    strange = before + np.array([0.0, 50.0, 0.0])
    after = rng.permutation(np.vstack([compose(before, step)[:stay], strange]))
    assert goes_on(before, after, moved(0.05, 0.02)) == stay


NEAR, TURNED = moved(0.05, 0.02), moved(0.05, 0.3)


@pytest.mark.parametrize(
    ("count", "way", "parts", "broken"),
    [
        (0, NEAR, True, True),
        (0, NEAR, False, False),  # a door that opens
        (0, TURNED, True, True),  # what the scans show holds for any way
        (0, TURNED, False, False),
        (1, NEAR, True, False),
        (None, NEAR, True, False),  # not to be compared
        (0, NEAR, None, True),  # nobody watches: the lists alone show it
        (0, TURNED, None, False),
        (1, NEAR, None, False),
    ],
)
def test_a_robot_was_carried_off_where_neither_lists_nor_scans_go_on(
    count: int | None, way: Motion, parts: bool | None, broken: bool
) -> None:
    assert is_broken(count, way, parts) == broken


def test_the_more_go_on_the_less_was_the_robot_carried_away() -> None:
    near, far = moved(0.05, 0.02), moved(0.8, 0.02)
    ratios = [carried_ratio(count, near, None) for count in range(COMPARED + 1)]
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[2] > 1.0 > ratios[8]
    # a metre or a turn on, fewer go on anyhow: their number shows little, but that there is none does
    for moved_on in (far, moved(0.05, 0.4)):
        none, *some = (carried_ratio(count, moved_on, None) for count in range(COMPARED + 1))
        assert none > 1.0 > some[0]
        assert none < ratios[0]
        assert len(set(some)) == 1
    assert carried_ratio(None, near, None) == carried_ratio(None, near, parts=False) == 1.0


def test_scans_that_do_not_follow_speak_for_a_kidnap_however_many_go_on() -> None:
    for count in (None, *range(COMPARED + 1)):
        for motion in (moved(0.05, 0.02), moved(0.8, 0.02)):
            follows, apart = (carried_ratio(count, motion, parts) for parts in (False, True))
            assert apart > 10.0 * follows


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
def test_what_cannot_be_compared_shows_nothing(before: int, after: int, motion: Motion) -> None:
    rng = np.random.default_rng(2)
    assert goes_on(somewhere(rng, before), somewhere(rng, after), motion) is None
