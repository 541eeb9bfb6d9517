"""Odometry whose turns are off: reported, by how much, and no pose is lowered for it."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED
from eigenscan.tracker.turning import DRIFTS, Turning
from hypothesis import given
from hypothesis import strategies as st

from tests.services.tracker.conftest import MakeCore, PosesOf, Speaker
from tests.services.tracker.test_agreement import STEP, Step, drive

SECONDS = 0.3


def turned(scale: float, rate: float, noise: float = 0.002, count: int = 200, slips: float = 0.0) -> Turning:
    """After turns of up to 20 degrees; of some, odometry counts nothing."""
    rng, turning = np.random.default_rng(3), Turning()
    for number in range(count):
        scans = 0.35 * np.sin(0.3 * number)
        driven = 0.0 if rng.random() < slips else (scans - rate * SECONDS) / scale
        turning.take(scans + noise * rng.standard_normal(), 1e-6, driven, SECONDS)
    return turning


@given(st.floats(0.6, 1.6), st.floats(-0.1, 0.1))
def test_it_is_least_squares(scale: float, rate: float) -> None:
    rng, turning = np.random.default_rng(1), Turning()
    driven = rng.uniform(-0.4, 0.4, size=300)
    seen = scale * driven + rate * SECONDS + 0.001 * rng.standard_normal(300)
    for turn, way in zip(seen, driven, strict=True):
        turning.take(turn, 1e-6, way, SECONDS)
    H = np.stack([driven, np.full(300, SECONDS)], axis=1)
    direct, *_ = np.linalg.lstsq(H, seen, rcond=None)
    found = turning.scale, turning.rate
    assert found == pytest.approx(tuple(direct), abs=0.01)


@pytest.mark.parametrize("scale", [0.8, 1.3])
def test_wheels_too_near_or_too_far_apart_are_reported(scale: float) -> None:
    assert turned(scale, 0.0).note.startswith(f"scans turn {scale:.1f} times as far as odometry")


@pytest.mark.parametrize("rate", [-2.0 * DRIFTS, 2.0 * DRIFTS])
def test_a_heading_that_drifts_is_reported(rate: float) -> None:
    assert "drifts by 2.0°/s" in turned(1.0, rate).note


def test_noise_of_odometry_on_a_straight_way_is_no_scale() -> None:
    """Where half of what odometry turns is noise, scans turn by half of it: the wheels are right."""
    rng, turning = np.random.default_rng(4), Turning()
    for _ in range(300):
        turn = 0.005 * rng.standard_normal()
        turning.take(
            turn + 0.001 * rng.standard_normal(), 1e-6, turn + 0.005 * rng.standard_normal(), SECONDS
        )
        assert turning.note == ""


def test_one_steady_turn_does_not_tell_a_drift_from_wheels_too_near() -> None:
    """However exactly scans and odometry turn."""
    for scale in (0.9, 1.1):
        turning = Turning()
        for _ in range(12):
            turning.take(scale * 0.2, 1e-8, 0.2, SECONDS)
            assert turning.note == ""


def test_before_it_turned_enough_nothing_is_reported() -> None:
    assert turned(0.8, 0.0, count=5).note == ""


@pytest.mark.parametrize(
    ("scale", "noise", "slips"), [(1.0, 0.02, 0.0), (1.05, 0.002, 0.0), (1.0, 0.002, 0.1)]
)
def test_noise_a_small_error_and_slips_are_not_reported(scale: float, noise: float, slips: float) -> None:
    assert turned(scale, radians(0.5), noise, slips=slips).note == ""


def test_the_robot_is_localized_and_health_reports_it(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core, turns = make_core(), np.repeat(np.random.default_rng(2).uniform(-0.06, 0.06, size=20), 10)

    def step(scan: int) -> Step:
        return STEP[0], 0.0, turns[scan]

    def odometry(scan: int) -> Step:
        return STEP[0], 0.0, 0.75 * turns[scan]

    poses = drive(core, speaker, poses_of, odometry, step, count=200, step=step)
    assert core.condition().status == Health.STATUS_OK
    assert "scans turn 1.3" in core.condition().detail
    assert poses[-1].state == STATE_LOCALIZED
