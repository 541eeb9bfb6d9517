"""The second search of a scan, by halves of its beams."""

import numpy as np
import pytest
from eigenscan.projector.candidates import Candidates, Projected
from eigenscan.projector.halves import halves, is_unsure
from eigenscan.projector.observation import observe
from eigenscan.projector.projection import find_candidates
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.subspaces import SeenPart
from hypothesis import given
from hypothesis import strategies as st

from tests.services.projector.office import Array, free_poses, is_right, ready, scan_at


@given(st.lists(st.booleans(), min_size=1, max_size=200).filter(any))
def test_each_half_is_a_run_of_half_the_beams_and_has_its_other_half(beams: list[bool]) -> None:
    returned = np.array(beams)
    count = np.count_nonzero(returned)
    found = halves(returned)
    for half in found:
        assert half.shape == returned.shape
        assert not half[~returned].any()
        among = half[returned]
        assert np.count_nonzero(among) == (count + 1) // 2
        # in one piece: around the scan it begins once at most
        assert np.count_nonzero(among & ~np.roll(among, 1)) <= 1
    assert np.array_equal(found[0] | found[2], returned)
    assert np.array_equal(found[1] | found[3], returned)


def candidates(poses: list[tuple[float, float, float]], nats: list[float]) -> Candidates:
    part = SeenPart(np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1, 1)))
    all_of_them = np.ones(1, dtype=bool)
    return Candidates(
        np.array(poses, dtype=np.float64).reshape(-1, 3),
        np.zeros((len(poses), 3, 3)),
        np.zeros(len(poses)),
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
        ([(9.0, 0.0, 0.0)], [8.0, 5.5], True),
        ([(9.0, 0.0, 0.0)], [8.0, 4.5], False),
        ([(0.0, 0.3, 0.0), (9.0, 0.0, 0.0)], [8.0, 7.9, 4.5], False),  # the same place, and another
        ([(0.0, 0.0, np.pi)], [8.0, 7.0], True),  # the other way round
        ([(0.0, 0.0, 2 * np.pi - 0.05)], [8.0, 7.9], False),  # the same heading
        ([], [1.0], False),
    ],
)
def test_unsure_is_of_which_place(
    others: list[tuple[float, float, float]], nats: list[float], unsure: bool
) -> None:
    assert is_unsure(candidates([(0.0, 0.0, 0.0), *others], nats)) is unsure


def test_where_nothing_is_found_halves_are_not_searched() -> None:
    assert not is_unsure(candidates([], []))


def test_halves_find_a_pose_that_half_of_the_beams_contradict() -> None:
    """The other half is of another place: four times as many poses near to the whole scan hold fewer."""
    built = ready()._site
    assert built is not None
    by_whole, by_halves = 0, 0
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
            by_halves += bool(is_right(stages["associated again"], truth).any())
            find_candidates(built, view, seen, ProjectorSettings(candidates=240), stages.__setitem__)
            by_whole += bool(is_right(stages["associated"], truth).any())
    assert by_halves > 1.5 * by_whole
