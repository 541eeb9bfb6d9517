"""How well a robot's set-up is proven by its motion, and what is stated before it is."""

from __future__ import annotations

from collections.abc import Callable
from math import log

import numpy as np
import pytest
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED
from eigenscan.tracker.faults import Faults
from eigenscan.tracker.odometry import OdometryTrail
from eigenscan.tracker.planar import Pose, compose
from eigenscan.tracker.set_up import PROVEN, WRONG, SetUp
from eigenscan.tracker.velocity_gate import VelocityGate

from tests.services.tracker.conftest import MakeCore, PosesOf, Speaker
from tests.services.tracker.test_agreement import STEP, drive

NS = 1_000_000_000
EVERY_S = 0.25
"""Between two compared scans."""

Velocity = Callable[[float], tuple[float, float]]
"""Of a time, s: m/s ahead and rad/s."""


def played(
    velocity: Velocity, seconds: float, late_s: float = 0.0, received_before_s: float = 0.0
) -> list[float]:
    """How well the set-up of scans is proven that show the motion of `late_s` ago, after each interval."""
    trail, pose, step = OdometryTrail(VelocityGate(2.0, 3.0)), (0.0, 0.0, 0.0), 0.05
    true = OdometryTrail(VelocityGate(2.0, 3.0))
    for number in range(round((seconds + 20.0) / step) + 1):
        time = 80.0 + number * step
        true.take(round(time * NS), pose)
        if time >= 100.0 - received_before_s - 1e-9:
            trail.take(round(time * NS), pose)
        ahead, turning = velocity(time - 100.0)
        pose = compose(pose, (step * ahead, 0.0, step * turning))
    faults, result = Faults(), list[float]()
    for number in range(round(seconds / EVERY_S)):
        since = round((100.0 + number * EVERY_S) * NS)
        until, ago = since + round(EVERY_S * NS), round(late_s * NS)
        seen: Pose = true.between(since - ago, until - ago).delta
        faults.take(seen, (1e-4, 0.0, 1e-4), 1e-5, trail.between(since, until), since, trail)
        result.append(faults.proven)
    return result


def test_of_a_robot_that_has_not_moved_nothing_is_proven() -> None:
    assert Faults().proven == pytest.approx(1.0 - WRONG)
    assert max(played(lambda _: (0.0, 0.0), 10.0)) <= 1.0 - WRONG


def test_a_robot_that_starts_and_turns_proves_its_set_up() -> None:
    proven = played(lambda time: (min(0.5 * time, 0.5), 0.3 if time > 2.0 else 0.0), 6.0)
    assert proven[3] <= 1.0 - WRONG
    assert proven[-1] > PROVEN


def test_a_robot_that_drives_straight_on_may_be_mirrored() -> None:
    assert max(played(lambda time: (min(0.5 * time, 0.5), 0.0), 20.0)) <= 1.0 - WRONG


def test_before_the_first_odometry_a_robot_may_have_driven_as_it_then_did() -> None:
    def steady(time: float) -> tuple[float, float]:
        return 0.5 if time < 6.0 else 0.0, 0.2 * (-1.0) ** int(time / 0.5)

    assert max(played(steady, 4.0, late_s=3.0)[:2]) <= 1.0 - WRONG
    # odometry came before: then the scans show at once that they are not of three seconds ago
    known = played(lambda time: (0.5, 0.3 if time > 0.0 else 0.0), 4.0, received_before_s=9.0)
    assert known[-1] > PROVEN


def test_scans_that_are_late_are_not_proven_by_driving_steadily() -> None:
    def steady(_: float) -> tuple[float, float]:
        return 0.5, 0.3

    assert max(played(steady, 5.0, late_s=5.0)) <= 1.0 - WRONG
    assert max(played(steady, 5.0)) <= 1.0 - WRONG


def test_a_late_lidar_does_no_harm_to_a_robot_that_stands() -> None:
    """Over the last 8 s it stood: whatever the delay, the scans are of here."""

    def turned_and_stood(time: float) -> tuple[float, float]:
        return (0.5, 0.0) if 1.0 < time < 3.0 else (0.0, 0.4 if 3.0 < time < 3.5 else 0.0)

    assert played(turned_and_stood, 14.0)[-1] > PROVEN


def test_the_worst_way_counts_and_chance_proves_nothing() -> None:
    set_up, all_wrong = SetUp(np.array([0, 1])), np.ones(2, dtype=np.bool_)
    set_up.take(np.array([-30.0, -log(10.0)]), 0.0, all_wrong)
    assert set_up.proven == pytest.approx(1.0 - WRONG)
    set_up.take(np.array([0.0, -log(2.0)]), 0.0, all_wrong)
    assert set_up.proven == pytest.approx(1.0 / (1.0 + 0.1 / 0.9 / 20.0))
    set_up.take(np.array([0.0, 1000.0]), 0.0, all_wrong)
    assert set_up.proven == pytest.approx(0.0)
    set_up.take(np.array([0.0, 0.0]), 0.0, np.array([True, False]))
    assert set_up.proven > PROVEN


def test_before_it_has_moved_a_robot_is_localized_at_nine_in_ten(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    output = drive(make_core(), speaker, poses_of, lambda _: STEP, lambda _: STEP, stands=6)
    assert output[0].state == STATE_LOCALIZED
    assert output[0].confidence == pytest.approx(1.0 - WRONG)
    assert output[-1].confidence > 0.99
