"""Ranges that are measured wrongly are named, by what scans of new places state."""

from __future__ import annotations

from math import inf, nan

import numpy as np
import pytest
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, RangeCheck
from eigenscan.schemas.hypotheses_pb2 import RangeError as Stated
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED
from eigenscan.tracker.range_errors import FOR, TRIED, RangeError, RangeErrors, gains
from hypothesis import given
from hypothesis import strategies as st

from tests.services.tracker.conftest import MakeCore, PosesOf, Speaker

SHORT, LONG = RangeError(0.9, 0.0), RangeError(1.0, 0.3)
MIRRORED, HALF = RangeError(mirrored=True, searched=True), RangeError(0.5, searched=True)
FITS: dict[RangeError, float] = {}


def after(gain: float, scans: int, new: float = 1.0) -> RangeErrors:
    found = RangeErrors()
    for _ in range(scans):
        found.take("front", {SHORT: gain, LONG: -1.0})
        found.move(new)
    return found


def test_scans_of_new_places_add_up() -> None:
    assert not after(FOR, 1).fault
    assert "1.11 times as long" in after(FOR, 4).fault
    assert after(FOR, 4).trust < 0.01


def test_what_a_displaced_wall_gives_does_not_add_up() -> None:
    assert not after(0.9, 1000).fault
    assert after(0.9, 1000).trust > 0.99


def test_scans_of_one_place_do_not() -> None:
    assert not after(FOR, 1000, new=0.0).fault


def test_no_scan_counts_more_than_others() -> None:
    assert not after(1000.0, 1).fault


@given(st.lists(st.tuples(st.floats(-20.0, 0.0), st.floats(0.0, 3.0)), max_size=50))
def test_ranges_that_fit_are_trusted(scans: list[tuple[float, float]]) -> None:
    found = RangeErrors()
    for gain, new in scans:
        found.take("front", {SHORT: gain, LONG: gain / 2.0} if gain < -1.0 else FITS)
        found.move(new)
    assert found.trust > 0.999
    assert not found.fault


def test_a_mirrored_map_is_named_by_the_scans_that_are_tried_so() -> None:
    found = RangeErrors()
    for scan in range(40):
        tried = {MIRRORED: FOR} if scan % 8 == 0 else FITS
        found.take("front", {LONG: -10.0, **tried})
        assert bool(found.fault) == (scan >= 8)
        found.move(0.2)
    assert found.fault.startswith("scans fit the map only mirrored: ")
    assert found.trust < 0.01


def test_a_map_of_another_resolution_is_named_by_the_scans_that_are_searched_for_so() -> None:
    found = RangeErrors()
    for scan in range(40):
        found.take("front", {LONG: -10.0, **({HALF: FOR} if scan % 8 == 0 else {})})
        found.move(0.2)
    assert "2.00 times as long" in found.fault
    assert found.trust < 0.01


def test_a_first_projector_states_no_search_for_mirrored_scans() -> None:
    assert gains(RangeCheck(errors=[Stated(factor=1.0, mirrored=True, gain=5.0)])) == {MIRRORED: 5.0}


def test_a_map_that_is_not_mirrored_is_trusted() -> None:
    found = RangeErrors()
    for scan in range(400):
        found.take("front", {LONG: -10.0, MIRRORED: 0.9} if scan % 8 == 0 else {LONG: -10.0})
        found.move(1.0)
    assert found.trust > 0.999


def test_an_error_that_is_not_stated_fits_no_better() -> None:
    found = after(FOR, 4)
    for gain, named in ((FOR, True), (-10.0, True), (-10.0, False)):
        for _ in range(4):
            found.take("front", {LONG: gain})
            found.move(1.0)
        assert bool(found.fault) == named


def test_what_is_mended_is_forgotten() -> None:
    found = after(FOR, 100)
    for _ in range(24):
        found.take("front", FITS)
        found.move(1.0)
    assert not found.fault
    assert found.trust > 0.99


def test_one_of_two_lidars_is_named() -> None:
    found = RangeErrors()
    for _ in range(4):
        found.take("front", FITS)
        found.take("rear", {LONG: FOR})
        found.move(1.0)
    assert found.fault.startswith("rear: scans fit the map only with ranges 0.3 m shorter: ")
    assert found.trust < 0.01


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (RangeError(1.25, 0.0), "0.80 times as long"),
        (RangeError(1.0, -0.6), "0.6 m longer"),
        (RangeError(1.0, 0.3), "0.3 m shorter"),
        (RangeError(apart=1.1), "with beams 0.91 times as far apart: is the lidar's angle_increment right?"),
    ],
)
def test_the_words_name_what_would_mend_it(error: RangeError, words: str) -> None:
    assert words in str(error)


def test_what_is_no_number_is_left_out() -> None:
    wrong = [(nan, 0.0, 1.0), (1.0, inf, 1.0), (0.9, 0.0, nan), (0.0, 0.3, 5.0), (-1.0, 0.0, 5.0)]
    wrong += [(1e300, 0.0, 5.0), (1.0, -1e300, 5.0)]
    errors = [Stated(factor=f, offset=o, gain=g) for f, o, g in [*wrong, (0.9, 0.0, 5.0)]]
    errors += [Stated(factor=1.0, apart=apart, gain=5.0) for apart in (nan, -1.0, 1e300)]
    assert gains(RangeCheck(errors=errors)) == {SHORT: 5.0}


def test_a_stranger_cannot_make_it_grow() -> None:
    found = RangeErrors()
    for start in range(0, 1000, TRIED):
        found.take("front", {RangeError(1.0, start + k): -1.0 for k in range(TRIED)})
    assert len(found._lidars.of("front").odds) <= TRIED


def test_a_robot_whose_ranges_are_wrong_is_not_localized(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core, states = make_core(), list[int]()
    for step in range(180):
        pose = np.array([0.1 * step, 0.0, 0.0])
        list(core.handle(speaker.odometry(0.1 * step, pose)))
        envelope = speaker.hypotheses(0.1 * step, [pose], [25.0])
        message = envelope.open(Hypotheses)
        message.range_check.SetInParent()
        if 30 <= step < 50:
            message.range_check.errors.add(factor=1.0, offset=0.3, gain=10.0)
        states += [pose.state for pose in poses_of(core.handle(envelope))]
        if step == 49:
            assert core.condition().status == Health.STATUS_DEGRADED
            assert "0.3 m shorter" in core.condition().detail
    assert states[29] == states[179] == STATE_LOCALIZED != states[49]
    assert core.condition().status == Health.STATUS_OK


@pytest.mark.parametrize(("turn", "beams", "named"), [(0.02, 90, True), (0.12, 90, False), (0.12, 162, True)])
def test_beams_of_a_robot_that_turned_during_the_sweep_are_no_evidence(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, turn: float, beams: int, named: bool
) -> None:
    """Of half a turn, 0.08 rad make beams seem 2.5 % too far apart; of a whole turn 0.16 rad do."""
    core = make_core()
    for step in range(60):
        pose = np.array([0.1 * step, 0.0, (turn * step + np.pi) % (2.0 * np.pi) - np.pi])
        list(core.handle(speaker.odometry(0.1 * step, pose)))
        envelope = speaker.hypotheses(0.1 * step, [pose], [25.0], used_beams=beams)
        envelope.open(Hypotheses).range_check.errors.add(factor=1.0, apart=0.95, gain=10.0)
        poses_of(core.handle(envelope))
    assert ("times as far apart" in core.condition().detail) == named
