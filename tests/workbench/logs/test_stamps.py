from __future__ import annotations

from collections import Counter

import numpy as np
from eigenscan.workbench.logs.stamps import repair_stamps
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

S = 1_000_000_000


def seconds(*values: float) -> NDArray[np.int64]:
    return np.round(np.array(values) * S).astype(np.int64)


def longest_increasing(values: list[int]) -> int:
    """Length, by trying every end: the slow formula."""
    best: list[int] = []
    for index, value in enumerate(values):
        best.append(1 + max((best[j] for j in range(index) if values[j] < value), default=0))
    return max(best)


def test_stamps_that_increase_stay() -> None:
    stamps = seconds(1, 2, 2.5, 100)
    assert repair_stamps(stamps, ["A"] * 4).tolist() == stamps.tolist()


def test_kinds_with_clocks_of_their_own_order_are_merged_by_stamp() -> None:
    """As in fr079: lasers are written down later than odometry of the same time."""
    stamps = seconds(1.0, 1.1, 1.2, 0.9, 1.3, 1.05)
    kinds = ["ODOM", "ODOM", "ODOM", "FLASER", "ODOM", "FLASER"]
    assert repair_stamps(stamps, kinds).tolist() == stamps.tolist()


def test_a_stray_stamp_is_put_between_its_neighbours() -> None:
    got = repair_stamps(seconds(1, 2, 9, 4, 5), ["A"] * 5)
    assert got.tolist() == seconds(1, 2, 3, 4, 5).tolist()


def test_a_true_gap_stays() -> None:
    got = repair_stamps(seconds(1, 2, 1.5, 100, 101), ["A"] * 5)
    assert got[-1] - got[0] == 100 * S
    assert np.diff(got).max() > 48 * S


def test_strays_at_both_ends_go_on_at_the_usual_pace() -> None:
    got = repair_stamps(seconds(50, 51, 10, 11, 12, 13, 2, 3), ["A"] * 8)
    assert got.tolist() == seconds(8, 9, 10, 11, 12, 13, 14, 15).tolist()


def test_a_clock_set_back_does_not_squeeze_what_follows() -> None:
    first, second = np.arange(100.0, 140.0), np.arange(110.0, 180.0)
    got = repair_stamps(seconds(*first, *second), ["A"] * 110)
    assert (np.diff(got) > 0).all()
    # 110 lines at a second each
    assert abs((got[-1] - got[0]) / S - 109) < 2
    assert np.diff(got).min() > 0.9 * S


def test_kinds_that_disagree_by_more_than_lag_follow_the_lines() -> None:
    stamps = seconds(1, 1001, 2, 1002, 3, 1003)
    got = repair_stamps(stamps, ["A", "B"] * 3)
    assert (np.diff(got) > 0).all()


def test_stamps_in_no_order_leave_the_lines_a_lone_step_apart() -> None:
    """As in a log whose stamps are leftovers of a register."""
    shuffled = np.random.default_rng(1).permutation(2000) * (S // 7)
    got = repair_stamps(shuffled, ["A"] * 2000)
    assert set(np.diff(got).tolist()) == {S // 10}


def test_rounded_stamps_still_show_the_pace() -> None:
    """Ten lines a second, written in whole seconds."""
    got = repair_stamps(seconds(*np.repeat(np.arange(500.0, 800.0), 10)), ["A"] * 3000)
    assert (np.diff(got) > 0).all()
    assert abs((got[-1] - got[0]) / S - 300) < 2


def test_a_clock_that_was_not_set_yet_makes_no_gap_of_years() -> None:
    drive = 1.1e9 + 0.1 * np.arange(500)
    logged = seconds(0.0, 0.1, *drive)
    got = repair_stamps(logged, ["A"] * 502)
    assert got[2:].tolist() == logged[2:].tolist()
    assert np.diff(got)[:2].tolist() == [S // 10, S // 10]


@given(st.lists(st.integers(0, 50), min_size=1, max_size=60))
def test_repaired_stamps_increase_and_as_many_as_can_be_are_kept(values: list[int]) -> None:
    logged = seconds(*values)
    got = repair_stamps(logged, ["A"] * len(values))
    assert (np.diff(got) > 0).all()
    assert got.min() >= 0
    if len(values) <= 10:
        # too few to have been set back: they are as logged, but for a common shift to a time after 0
        (_, kept) = Counter((got - logged).tolist()).most_common(1)[0]
        assert kept >= longest_increasing(values)
