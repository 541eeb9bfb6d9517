"""Ranges of a wrong scale or with an offset show on the map, and beams stated too far apart or too near."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from eigenscan.projector.candidates import Candidates
from eigenscan.projector.observation import Observation, observe
from eigenscan.projector.projection import find_candidates
from eigenscan.projector.range_check import (
    BY_CHANCE,
    BY_TURNS,
    SCALES,
    Wrong,
    check,
    set_right,
    turn_of,
)
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import SensorView, Site
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.hypotheses_pb2 import RangeCheck
from eigenscan.schemas.scan_pb2 import Scan

from tests.services.projector.office import Array, free_poses, ready, receive, scan_at

POSES = free_poses(12, 3, clearance=0.8)
POSE = POSES[0]
RIGHT = Wrong()


def checked(pose: Array, wrong: Wrong = RIGHT, seed: int = 0, listed: Array | None = None) -> RangeCheck:
    seen = observe(measured(scan_at(pose, field_of_view=1.5 * np.pi, seed=seed), wrong))
    found = search(built().view(seen.sensor), seen)
    if listed is not None:
        found = replace(found, poses=listed[None], explained=np.zeros(1))
    return evidence(check(built(), seen, found))


def evidence(stated: RangeCheck | None) -> RangeCheck:
    assert stated is not None
    return stated


@cache
def built() -> Site:
    at = ready()._site
    assert at is not None
    return at


def measured(scan: Scan, wrong: Wrong) -> Scan:
    ranges = wrong.factor * np.asarray(scan.ranges) + wrong.offset
    scan.ranges[:] = np.maximum(ranges, 0.05).tolist()
    scan.angle_min *= wrong.apart
    scan.angle_increment *= wrong.apart
    return scan


@pytest.mark.parametrize("pose", POSES[:4])
def test_a_scan_that_fits_is_not_tried_otherwise(pose: Array) -> None:
    assert not checked(pose).errors


@pytest.mark.parametrize(
    "wrong",
    [
        Wrong(0.9),
        Wrong(1.1),
        Wrong(1.25),
        Wrong(offset=0.3),
        Wrong(offset=-0.3),
        Wrong(apart=0.9),
        Wrong(apart=1.1),
    ],
)
def test_where_the_pose_is_listed_the_error_is_found(wrong: Wrong) -> None:
    found = list[Wrong]()
    for number, pose in enumerate(POSES):
        (stated,) = checked(pose, wrong, seed=number, listed=pose).errors
        found.append(Wrong(stated.factor, stated.offset, stated.apart))
        assert stated.gain > 0.0
        # a tenth of a small room is much like an offset
        assert np.sign(stated.factor - 1.0 + stated.offset) == np.sign(wrong.factor - 1.0 + wrong.offset)
    assert found.count(wrong) > len(POSES) / 3


@pytest.mark.parametrize("too", [False, True])
def test_a_scan_that_fits_nowhere_is_no_evidence(too: bool) -> None:
    rng = np.random.default_rng(5)
    for pose in POSES:
        scan = scan_at(pose, field_of_view=2 * np.pi)
        scan.ranges[:] = rng.uniform(0.3, 12.0, len(scan.ranges)).tolist()
        seen = observe(scan)
        view = built().view(seen.sensor)
        found = search(view, seen)
        assert len(found.poses)
        assert found.log_likelihoods[0] < BY_CHANCE
        assert check(built(), seen, found, partial(search, view) if too else None) is None


def test_ranges_are_set_right() -> None:
    true = observe(scan_at(POSE, noise=0.0))
    wrong = Wrong(0.9, 0.3)
    right = set_right(observe(measured(scan_at(POSE, noise=0.0), wrong)), wrong)
    assert right.coarse == pytest.approx(true.coarse, abs=1e-4)


@pytest.mark.parametrize("off", [0.0, 0.3])
def test_beams_are_set_as_far_apart_as_they_are(off: float) -> None:
    """Whatever angle the driver begins with, the middle beam keeps its own."""
    seen = observe(scan_at(POSE, noise=0.0))
    middle = (seen.bearings[0] + seen.bearings[-1]) / 2.0
    wrong = replace(seen, bearings=1.1 * (seen.bearings - middle) + middle + off)
    assert set_right(wrong, Wrong(apart=1.1)).bearings == pytest.approx(seen.bearings + off)


def test_what_is_missing_or_empty_stays_so() -> None:
    scan = scan_at(POSE, noise=0.0)
    scan.ranges[10], scan.ranges[20] = float("nan"), float("inf")
    seen = observe(scan)
    right = set_right(seen, Wrong(0.9, 0.3))
    assert (np.isnan(right.coarse) == np.isnan(seen.coarse)).all()
    assert (np.isinf(right.coarse) == np.isinf(seen.coarse)).all()


@pytest.mark.parametrize("field_of_view", [1.5 * np.pi, 2 * np.pi])
def test_a_mirrored_scan_fits_the_map_only_mirrored(field_of_view: float) -> None:
    for number, pose in enumerate(POSES):
        scan = scan_at(pose, field_of_view=field_of_view, seed=number)
        for wrong in (False, True):
            if wrong:
                scan.ranges[:] = list(scan.ranges)[::-1]
            seen = observe(scan)
            view = built().view(seen.sensor)
            found = replace(search(view, seen), explained=np.zeros(1))
            _, stated = evidence(check(built(), seen, found, partial(search, view))).errors
            assert stated.mirrored
            assert (stated.gain > 1.0) == wrong


def search(view: SensorView, seen: Observation) -> Candidates:
    return find_candidates(built(), view, seen, ProjectorSettings())


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.25, 2.0])
def test_ranges_far_off_fit_the_map_only_set_right(factor: float) -> None:
    """A map of another resolution was taken for one of another floor."""
    gained = list[float]()
    for number, pose in enumerate(POSES):
        seen = observe(measured(scan_at(pose, field_of_view=2 * np.pi, seed=number), Wrong(factor)))
        view = built().view(seen.sensor)
        found = search(view, seen)
        if found.log_likelihoods[0] < BY_CHANCE:
            errors = {
                scale: check(built(), seen, found, partial(search, view), scale) or RangeCheck()
                for scale in SCALES
            }
            gains = {s: c.errors[1].gain for s, c in errors.items() if len(c.errors) > 1}
            gained.append(gains[Wrong(factor)])
            assert max(gains, key=gains.__getitem__) == Wrong(factor)
    assert np.median(gained) > 3.0


def test_a_scan_that_fits_some_place_is_searched_for_with_no_scale() -> None:
    seen = observe(measured(scan_at(POSE, field_of_view=2 * np.pi), Wrong(apart=1.1)))
    view = built().view(seen.sensor)
    found = replace(search(view, seen), explained=np.zeros(1), log_likelihoods=np.full(1, BY_CHANCE + 1.0))
    assert len(evidence(check(built(), seen, found, partial(search, view), SCALES[0])).errors) == 1


def test_the_errors_that_a_scan_is_searched_for_with_take_turns() -> None:
    turns = [turn_of(stamp) for stamp in range(0, 10**12, 10**8)]
    for error in set(BY_TURNS):
        assert np.mean([one == error for one in turns]) == pytest.approx(
            BY_TURNS.count(error) / len(BY_TURNS), rel=0.2
        )
    assert turn_of(2**70) in BY_TURNS


def test_a_list_states_by_turns_whether_the_scan_fits_mirrored() -> None:
    core, wrong = ready(), measured(scan_at(POSE, field_of_view=2 * np.pi), Wrong(apart=1.1))
    for second in range(20):
        wrong.timestamp.seconds = second
        first, *rest = receive(core, wrong)[0].range_check.errors
        assert not first.searched
        turn = turn_of(nanoseconds(wrong.timestamp))
        assert [(one.mirrored, one.factor) for one in rest if one.searched] == (
            [(True, 1.0)] if turn is None else [(False, turn.factor)][: len(rest)]
        )


def test_a_list_of_the_whole_map_states_the_check() -> None:
    wide = scan_at(POSE, field_of_view=2 * np.pi)
    core, by_eigenspace = ready(), ready(verification="eigenspace", obstacles="reconstruction")
    fits = receive(core, wide)[0]
    assert fits.HasField("range_check")
    assert not fits.range_check.errors
    assert receive(core, measured(wide, Wrong(apart=1.1)))[0].range_check.errors
    assert not receive(by_eigenspace, wide)[0].HasField("range_check")
