"""Where a lidar is mounted, by its motion: against filterpy, and from motions with known mounts."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, hypot, pi, radians, sin

import numpy as np
import pytest
from eigenscan.geometry.pose import compose, inverse
from eigenscan.schemas.health_pb2 import Health
from eigenscan.tracker.calibration import FIRST_INFORMATION, RIGHT, Calibration, _update
from eigenscan.tracker.mount import FIXED_RAD
from filterpy.kalman import update
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.services.tracker.conftest import MakeCore, PosesOf, Speaker
from tests.services.tracker.test_agreement import Step, drive, weaving

Array = NDArray[np.float64]

SPREAD = (1e-5, 0.0, 1e-5)


def seen_from(moved: Array, mount: Array, scale: float = 1.0) -> Array:
    """How a base seems to move whose lidar is at `mount` (3,), and stated at the base's origin."""
    found = compose(compose(inverse(mount), moved), mount)
    return np.array([scale * found[0], scale * found[1], found[2]])


def calibrated(mount: Array, scale: float = 1.0, noise: float = 0.01, back: bool = False) -> Calibration:
    """After 60 motions of 0.2 m ahead or back, with turns to both sides."""
    rng, calibration = np.random.default_rng(5), Calibration(FIXED_RAD)
    for number in range(60):
        moved = np.array([-0.2 if back and number > 30 else 0.2, 0.0, 0.15 * sin(0.5 * number)])
        x, y, turn = seen_from(moved, mount, scale) + noise * rng.standard_normal(3) * [1.0, 1.0, 0.2]
        stated = (abs(moved[0]), 0.0, moved[2])
        calibration.take((x, y, turn), SPREAD, stated, 0.2)
    return calibration


@given(st.integers(0, 2**16))
def test_an_update_is_that_of_a_kalman_filter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(4, 4))
    information, first = root @ root.T, FIRST_INFORMATION
    P = np.linalg.inv(first + information)
    found = rng.normal(size=4) * 0.1 + RIGHT
    sums = np.linalg.solve(P, found) - first @ RIGHT
    x, y, turn = rng.uniform(0.05, 0.3), rng.uniform(-0.02, 0.02), rng.uniform(-0.5, 0.5)
    H = np.array([[x, -y, cos(turn) - 1.0, -sin(turn)], [y, x, sin(turn), cos(turn) - 1.0]])
    scans = H @ found + 0.01 * rng.normal(size=2)
    R = np.array([[0.002, 0.0005], [0.0005, 0.003]]) + 0.01 * np.eye(2)
    direct, C = update(found[:, None], P, scans[:, None], R, H)
    # no tails: each innovation counts as what is usual
    _update(information, sums, (scans[0], scans[1], turn), (0.002, 0.0005, 0.003), 0.01, x, y, 1.0, 1e12)
    assert np.linalg.solve(first + information, first @ RIGHT + sums) == pytest.approx(direct.ravel())
    assert np.linalg.inv(first + information) == pytest.approx(C)


@given(st.floats(-0.6, 0.6), st.floats(0.0, 0.3), st.integers(1, 9), st.booleans(), st.integers(0, 2**16))
def test_however_often_a_knock_is_suspected_no_more_is_forgotten_than_motion_has_shown(
    turn: float, noise: float, every: int, by_turn: bool, seed: int
) -> None:
    rng, found = np.random.default_rng(seed), Calibration(FIXED_RAD)
    for number in range(100):
        x, y = (0.3, 0.0) + rng.normal(size=2) * noise
        found.take((0.3, 0.0, turn), SPREAD, (x, y, turn), 0.3)
        if number % every == 0:
            found.suspect_turn(0.5, 0.0) if by_turn else found.suspect_any()
        # as wide as before any motion at most
        assert all(0.0 < sigma < 1.01 for sigma in found.sigmas)
        assert 0.0 <= found.proven <= 1.0


@given(st.sampled_from([0.0, 0.3, 1.6, 2.0]), st.integers(1, 40), st.integers(0, 2**16))
def test_wheels_that_slipped_are_no_fault_once_they_grip_again(
    slip: float, intervals: int, seed: int
) -> None:
    """As they slip on an arc, another scale or a displaced mount may explain it; other arcs show neither."""
    rng, found = np.random.default_rng(seed), Calibration(FIXED_RAD)
    for number in range(intervals + 40):
        counted = 0.3 * (slip if number < intervals else 1.0)
        turn = 0.2 * (1.0 if number < intervals else sin(0.5 * number))
        x, y, seen = np.array([0.3, 0.0, turn]) + rng.normal(size=3) * [0.01, 0.01, 0.002]
        found.take((x, y, seen), SPREAD, (counted, 0.0, turn), 0.3)
    assert found.fault == ""
    assert found.lever < 0.2


@pytest.mark.parametrize("angle", [12.0, -12.0])
def test_a_turned_mount_is_measured_and_named(angle: float) -> None:
    found = calibrated(np.array([0.0, 0.0, -radians(angle)]))
    assert found.yaw == pytest.approx(radians(angle), abs=4.0 * found.sigmas[0])
    assert f"{angle:.0f}°" in found.fault
    assert found.within < 0.1


@pytest.mark.parametrize("mount", [(0.7, 0.0, 0.0), (-0.3, 0.6, 0.0)])
def test_a_displaced_mount_is_measured_and_named(mount: tuple[float, float, float]) -> None:
    found = calibrated(np.array(mount))
    assert found.lever == pytest.approx(hypot(*mount[:2]), abs=4.0 * found.sigmas[1])
    assert "0.7 m" in found.fault
    assert found.within < 0.1


@pytest.mark.parametrize(
    ("mount", "words"),
    [
        ((0.0, 0.0, 0.0), ""),
        ((0.05, 0.05, radians(1.0)), ""),  # as far off as those of ten logs
        ((0.0, 0.3, 0.0), "0.3 m away"),
        ((0.0, 0.0, radians(-6.0)), "scans move 6° off"),
    ],
)
def test_a_mount_that_is_off_by_less_than_a_claim_allows_is_noted(
    mount: tuple[float, float, float], words: str
) -> None:
    found = calibrated(np.array(mount), noise=0.005)
    assert found.fault == ""
    assert (words in found.note) if words else found.note == ""


@pytest.mark.parametrize("scale", [0.7, 1.4])
def test_another_scale_is_named_and_the_mount_is_right(scale: float) -> None:
    found = calibrated(np.zeros(3), scale)
    assert found.scale == pytest.approx(scale, abs=0.02)
    assert f"{found.scale:.1f} times" in found.fault
    assert found.within > 0.99


@pytest.mark.parametrize("scale", [0.9, 1.1])
def test_ranges_a_tenth_off_are_never_proven(scale: float) -> None:
    assert calibrated(np.zeros(3), scale).proven == pytest.approx(0.9)


@pytest.mark.parametrize("scale", [0.96, 1.0, 1.04])
def test_wheels_a_little_off_prove_the_ranges_all_the_same(scale: float) -> None:
    assert calibrated(np.zeros(3), scale).proven > 0.99


def straight_on(found: Calibration, yaw: Callable[[int], float], intervals: int) -> None:
    """Takes motions straight on, seen by a lidar whose mount is turned."""
    for number in range(intervals):
        seen = (0.2 * cos(yaw(number)), 0.2 * sin(yaw(number)), 0.0)
        found.take(seen, SPREAD, (0.2, 0.0, 0.0), 0.2)


def test_a_knocked_mount_is_not_proven_until_motion_has_measured_it_again() -> None:
    found = calibrated(np.zeros(3))
    assert found.proven > 0.99
    found.suspect_turn(radians(15.0), 0.0)
    assert found.proven <= 0.9
    straight_on(found, lambda _: radians(15.0), 4)
    assert found.yaw == pytest.approx(radians(15.0), abs=radians(3.0))
    assert found.proven < 0.5


def test_a_turn_that_was_the_robots_costs_the_proof_only_for_a_while() -> None:
    found = calibrated(np.zeros(3))
    found.suspect_any()
    assert found.proven <= 0.9
    assert found.yaw == pytest.approx(0.0, abs=radians(2.0))
    assert not found.fault
    straight_on(found, lambda _: 0.0, 20)
    assert found.proven > 0.99


def test_turns_that_odometry_shows_too_are_no_knocks() -> None:
    found = calibrated(np.zeros(3))
    found.suspect_turn(radians(15.0), radians(13.0))
    assert found.proven > 0.99


def test_a_mount_that_works_loose_is_found_however_long_it_was_right() -> None:
    found = calibrated(np.zeros(3))
    straight_on(found, lambda _: 0.0, 2000)
    straight_on(found, lambda number: radians(min(0.2 * number, 12.0)), 100)
    assert found.proven <= 0.9
    assert found.yaw == pytest.approx(radians(12.0), abs=radians(3.0))


@pytest.mark.parametrize("back", [False, True])
def test_a_right_mount_is_proven_also_where_encoders_have_no_sign(back: bool) -> None:
    found = calibrated(np.array([0.05, 0.0, radians(1.0)]), back=back)
    assert not found.fault
    assert found.within > 0.99


def test_a_straight_way_shows_the_angle_and_not_the_place() -> None:
    found = Calibration(FIXED_RAD)
    for _ in range(60):
        found.take((0.2, 0.0, 0.0), SPREAD, (0.2, 0.0, 0.0), 0.2)
    yaw, lever, _ = found.sigmas
    assert yaw < radians(2.0)
    assert lever > 0.5
    assert found.within < 0.9
    assert not found.fault


def test_one_odd_turn_is_no_doubt_however_exact_the_straight_way_after_it() -> None:
    found = Calibration(FIXED_RAD)
    found.take((0.035, 0.014, 0.113), SPREAD, (0.09, 0.004, 0.037), 0.09)
    straight_on(found, lambda _: 0.0, 60)
    assert found.proven > 0.7
    assert not found.fault
    for turn in 10 * (0.15, -0.15):
        found.take((0.2, 0.8 * sin(turn), turn), SPREAD, (0.2, 0.0, turn), 0.2)
    assert "0.7 m away" in found.fault


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_arc_without_end_shows_no_scale_however_noisy_odometry_is(seed: int) -> None:
    rng, found = np.random.default_rng(seed), Calibration(FIXED_RAD)
    for _ in range(600):
        x, y = (0.36, 0.01) + rng.normal(size=2) * (0.018, 0.002)
        found.take((0.36, 0.01, 0.057), SPREAD, (x, y, 0.057), x)
        assert not found.fault
    assert found.lever < 0.25
    assert found.scale == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("mount", "words"), [((0.0, 0.0, -pi / 15.0), "12° off"), ((0.8, 0.0, 0.0), "0.8 m away")]
)
def test_a_wrong_mount_is_named_and_never_claimed_above_nine_in_ten(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, mount: Step, words: str
) -> None:
    def scans(scan: int) -> Step:
        x, y, turn = seen_from(np.array(weaving(scan)), np.array(mount)).tolist()
        return x, y, turn

    core = make_core()
    output = drive(core, speaker, poses_of, weaving, scans, count=160, step=weaving)
    assert max(pose.confidence for pose in output) <= 0.9 + 1e-9
    assert core.condition().status == Health.STATUS_DEGRADED
    assert words in core.condition().detail
    assert output[-1].confidence < 0.5


@pytest.mark.parametrize("still", [30, 300])
def test_a_loose_mount_that_turns_on_is_never_claimed_above_nine_in_ten_once_it_is_ten_degrees_off(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, still: int
) -> None:
    def mount(scan: int) -> Array:
        return np.array([0.0, 0.0, radians(0.1) * max(scan - still, 0)])

    def scans(scan: int) -> Step:
        moved = compose(compose(inverse(mount(scan)), np.array(weaving(scan))), mount(scan + 1))
        x, y, turn = (moved + rng.normal(size=3) * (0.008, 0.008, 0.002)).tolist()
        return x, y, turn

    core, rng = make_core(), np.random.default_rng(4)
    output = drive(core, speaker, poses_of, weaving, scans, count=still + 250, step=weaving)
    assert max(pose.confidence for pose in output[still + 100 :]) <= 0.9 + 1e-9
    assert "is the lidar's mount turned" in core.condition().detail
