"""The second search of a scan, by what its beams differ from the predicted scans."""

import numpy as np
import pytest
from eigenscan.eigenspace.analysis import ANALYSIS_TURN
from eigenscan.projector.candidates import Candidates, Projected
from eigenscan.projector.observation import by_reach, observe
from eigenscan.projector.projection import find_candidates
from eigenscan.projector.second_search import is_unsure, most_alike
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.subspaces import SeenPart
from eigenscan.projector.verification import UNLIKE, predicted
from hypothesis import given
from hypothesis import strategies as st

from tests.services.projector.office import Array, free_poses, is_right, ready, scan_at


@given(st.integers(0, 10_000), st.sampled_from([36, 91, 180]), st.integers(1, 400))
def test_the_poses_that_differ_least_are_given(seed: int, beams: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    enter = rng.uniform(0.5, 9.0, (8, ANALYSIS_TURN)).astype(np.float32)
    leave = enter + rng.uniform(0.0, 1.0, enter.shape).astype(np.float32)
    coarse = rng.uniform(0.5, 9.0, beams).astype(np.float32)
    coarse[rng.random(beams) < 0.3] = np.nan
    positions = np.sort(rng.permutation(8)[:5])
    at, window = most_alike(
        predicted(enter, beams, 0.0), predicted(leave, beams, 0.0), positions, coarse, 0.0, count
    )
    few = np.flatnonzero(np.isfinite(coarse[::3])) * 3
    if not len(few):
        assert not len(at)
        return
    weight = by_reach(coarse[few]) / len(few)

    def direct(p: int, w: int) -> float:
        seen, along = coarse[few], (few + w) % ANALYSIS_TURN
        off = np.maximum(np.maximum(seen - leave[p, along], enter[p, along] - seen), 0.0)
        return float(weight @ np.minimum(off, UNLIKE))

    every = {(p, w): direct(p, w) for p in positions.tolist() for w in range(0, ANALYSIS_TURN, 3)}
    given = list(zip(at.tolist(), window.tolist(), strict=True))
    assert len(set(given)) == len(given) <= count
    rest = [cost for pose, cost in every.items() if pose not in set(given)]
    step = (max(every.values()) - min(every.values())) / 2000
    # weights and ranges are rounded to whole numbers
    assert max((every[pose] for pose in given), default=0.0) <= min(rest, default=np.inf) + step + 0.002


def test_a_scan_without_a_beam_to_compare_is_like_nothing() -> None:
    nothing = np.full(91, np.nan, dtype=np.float32)
    nothing[1] = 2.0  # not of every third beam
    shown = predicted(np.ones((1, ANALYSIS_TURN), dtype=np.float32), 91, 0.0)
    assert not len(most_alike(shown, shown, np.zeros(1, dtype=np.int64), nothing, 0.0, 10)[0])


def candidates(poses: list[tuple[float, float, float]], nats: list[float]) -> Candidates:
    part = SeenPart(np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1, 1)))
    all_of_them = np.ones(1, dtype=bool)
    return Candidates(
        np.array(poses, dtype=np.float64).reshape(-1, 3),
        np.zeros((len(poses), 3, 3)),
        np.array(nats),
        np.ones(len(poses)),
        np.zeros(len(poses), dtype=np.int64),
        Projected(np.zeros((1, 1)), np.zeros(1), all_of_them, all_of_them, part, 0.0),
        0.0,
        0.0,
    )


@pytest.mark.parametrize(
    ("others", "nats", "unsure"),
    [
        ([(9.0, 0.0, 0.0)], [8.0, 3.5], True),
        ([(9.0, 0.0, 0.0)], [8.0, 2.5], False),
        ([(0.0, 0.3, 0.0), (9.0, 0.0, 0.0)], [8.0, 7.9, 2.5], False),  # the same place, and another
        ([(0.0, 0.0, np.pi)], [8.0, 7.0], True),  # the other way round
        ([(0.0, 0.0, 2 * np.pi - 0.05)], [8.0, 7.9], False),  # the same heading
        ([], [6.0], False),
    ],
)
def test_unsure_is_of_which_place(
    others: list[tuple[float, float, float]], nats: list[float], unsure: bool
) -> None:
    assert is_unsure(candidates([(0.0, 0.0, 0.0), *others], nats)) is unsure


def test_where_nothing_is_found_nothing_is_searched_again() -> None:
    assert not is_unsure(candidates([], []))


def test_it_finds_a_pose_that_half_of_the_beams_contradict() -> None:
    """The other half is of another place: four times as many poses near to the whole scan hold fewer."""
    built = ready()._site
    assert built is not None
    by_first, by_second = 0, 0
    for i, (truth, other) in enumerate(zip(free_poses(24, 12), free_poses(24, 99), strict=True)):
        scan = scan_at(truth, seed=i)
        wrong = scan_at(other, seed=100 + i).ranges
        first = 37 * i % len(wrong)
        of_other = (first + np.arange(len(wrong) // 2)) % len(wrong)
        ranges = np.array(scan.ranges)
        ranges[of_other] = np.array(wrong)[of_other]
        scan.ranges[:] = ranges.tolist()
        seen = observe(scan)
        view = built.view(seen.sensor).complete()
        stages: dict[str, Array] = {}
        find_candidates(built, view, seen, ProjectorSettings(candidates=60), stages.__setitem__)
        if "associated again" in stages:
            by_second += bool(is_right(stages["associated again"], truth).any())
            find_candidates(built, view, seen, ProjectorSettings(candidates=240), stages.__setitem__)
            by_first += bool(is_right(stages["associated"], truth).any())
    assert by_second > 1.5 * by_first
