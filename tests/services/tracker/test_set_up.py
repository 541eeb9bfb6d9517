"""How well a robot's set-up is proven by its motion, and what is stated before it is."""

from __future__ import annotations

from collections.abc import Callable
from math import exp, log, pi, radians, sin

import numpy as np
import pytest
from eigenscan.schemas.channels import RELOCATION
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Relocation
from eigenscan.tracker.faults import AGREE, MIRRORED, Faults, _log_likelihoods, _predicted
from eigenscan.tracker.odometry import RESTART_AFTER, OdometryTrail
from eigenscan.tracker.planar import Pose, between, compose
from eigenscan.tracker.scan_motion import EXACT, SIGMA_M, SIGMA_RAD, SIGMA_SHARE
from eigenscan.tracker.set_up import PROVEN, WRONG, SetUp
from eigenscan.tracker.velocity_gate import VelocityGate

from tests.services.tracker.conftest import MakeCore, PosesOf, Speaker
from tests.services.tracker.test_agreement import drive, weaving

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
    proven = played(lambda time: (min(0.5 * time, 0.5), 0.3 if time > 5.0 else 0.0), 8.0)
    assert proven[3] <= 1.0 - WRONG
    assert proven[-1] > PROVEN


def test_a_robot_that_drives_straight_on_may_be_mirrored() -> None:
    assert max(played(lambda time: (min(0.5 * time, 0.5), 0.0), 20.0)) <= 1.0 - WRONG


def test_before_the_first_odometry_a_robot_may_have_driven_as_it_then_did() -> None:
    def steady(time: float) -> tuple[float, float]:
        return 0.5 if time < 6.0 else 0.0, 0.2 * (-1.0) ** int(time / 0.5)

    assert max(played(steady, 4.0, late_s=3.0)[:2]) <= 1.0 - WRONG
    # odometry came before: then the scans show at once that they are not of three seconds ago
    known = played(
        lambda time: (0.5, 0.5 * sin(3.0 * time) if time > 0.0 else 0.0), 4.0, received_before_s=9.0
    )
    assert known[-1] > PROVEN


def test_scans_that_are_late_are_not_proven_by_driving_steadily() -> None:
    def steady(_: float) -> tuple[float, float]:
        return 0.5, 0.3

    assert max(played(steady, 5.0, late_s=5.0)) <= 1.0 - WRONG
    assert max(played(steady, 5.0)) <= 1.0 - WRONG


def test_a_late_lidar_does_no_harm_to_a_robot_that_stands() -> None:
    """Over the last 8 s it stood: whatever the delay, the scans are of here."""

    def turned_and_stood(time: float) -> tuple[float, float]:
        return (0.5, 0.0) if 1.0 < time < 5.0 else (0.0, 0.5 if 5.0 < time < 7.0 else 0.0)

    assert played(turned_and_stood, 16.0)[-1] > PROVEN


def test_the_worst_way_counts_and_chance_proves_nothing() -> None:
    set_up, both = SetUp(2, 1), np.ones(2, dtype=np.bool_)
    set_up.take(np.array([[-30.0, -log(10.0)]]), np.zeros(1), both)
    assert set_up.proven == pytest.approx(1.0 - WRONG)
    set_up.take(np.array([[0.0, -log(2.0)]]), np.zeros(1), both)
    assert set_up.proven == pytest.approx(1.0 / (1.0 + 0.1 / 0.9 / 20.0))
    set_up.take(np.array([[0.0, 1000.0]]), np.zeros(1), both)
    assert set_up.proven == pytest.approx(0.0)
    set_up.take(np.zeros((1, 2)), np.zeros(1), np.array([True, False]))
    assert set_up.proven > PROVEN


def test_a_right_set_up_counts_as_the_mean_over_how_exact_it_may_be_and_a_wrong_one_as_the_likeliest() -> (
    None
):
    set_up, only = SetUp(1, 2), np.ones(1, dtype=np.bool_)
    set_up.take(np.array([[-5.0], [-2.5]]), np.array([0.0, -1000.0]), only)
    # half of it was likely, so the ratio is exp(2.5) / 2 = 6: eleven are no proof yet
    assert set_up.proven == pytest.approx(1.0 - WRONG)
    set_up.take(np.array([[0.0], [-5.0]]), np.zeros(2), only)
    assert set_up.proven == pytest.approx(1.0 / (1.0 + 0.1 / 0.9 * 2.0 * exp(-5.0)))


def test_turns_of_a_degree_prove_the_set_up_of_a_robot_that_is_exact() -> None:
    """Along 10 m, its heading goes to and fro by 1.4 degrees. Where it is mounted, that does not show."""
    assert swaying(noise_share=0.15)[-1] > PROVEN
    assert max(swaying(noise_share=1.0)) <= 1.0 - WRONG


def swaying(noise_share: float) -> list[float]:
    """How well its set-up is proven; both motions differ by a share of what they may."""
    rng, faults, result = np.random.default_rng(2), Faults(), list[float]()
    trail, pose, step = OdometryTrail(VelocityGate(2.0, 3.0)), (0.0, 0.0, 0.0), 0.05
    for number in range(600):
        trail.take(round((100.0 + number * step) * NS), pose)
        time = number * step - 9.0
        turning = radians(0.7) * 2.0 * pi / 8.0 * sin(2.0 * pi * time / 8.0)
        pose = compose(pose, (step * min(max(time, 0.0), 0.5), 0.0, step * turning * (time > 0.0)))
    for number in range(33):
        since, every = round((109.0 + 0.6 * number) * NS), round(0.6 * NS)
        driven = trail.between(since, since + every)
        off = noise_share * rng.standard_normal(3) * [SIGMA_M, SIGMA_M, SIGMA_RAD]
        x, y, turn = np.array(driven.delta) + off
        faults.take((x, y, turn), (1e-5, 0.0, 1e-5), 4e-6, driven, since, trail)
        result.append(faults._set_up.proven)
        assert faults.proven < 0.92
    return result


@pytest.mark.parametrize(("way_share", "turn_share"), [(1.0, 1.0), (0.25, 1.0), (0.5, 0.25), (0.3, 0.6)])
def test_however_exact_a_robot_is_its_mirrored_lidar_is_rarely_taken_as_right(
    way_share: float, turn_share: float
) -> None:
    """At most in one drive in eleven, however long (Ville's inequality)."""
    rng, drives, taken = np.random.default_rng(3), 80, 0
    past = np.array([[0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
    for _ in range(drives):
        set_up, only, proven = SetUp(1, len(EXACT)), np.ones(1, dtype=np.bool_), False
        for _ in range(50):
            turn = radians(0.5) * float(rng.standard_normal())
            moved = 0.1, 0.0, turn
            predicted = _predicted(moved, past, moved, past, 50.0, 50.6)
            sigma = np.array([SIGMA_M, SIGMA_M, SIGMA_RAD]) + SIGMA_SHARE * np.array([0.1, 0.1, abs(turn)])
            off = rng.standard_normal(3) * sigma * [way_share, way_share, turn_share]
            x, y, turned = off + np.array([0.1, 0.0, -turn])
            found = _log_likelihoods((x, y, turned), (1e-8, 0.0, 1e-8), 1e-8, predicted, False)
            set_up.take(found[:, [MIRRORED]], found[:, AGREE], only)
            proven |= set_up.proven > PROVEN
        taken += proven
    assert taken <= drives / 11


def test_a_robot_without_a_sign_of_its_encoders_backs_out_without_losing_its_proof() -> None:
    """As far back as ahead: odometry counts on."""
    faults, trail, pose, since = Faults(), OdometryTrail(VelocityGate(2.0, 3.0)), (0.0, 0.0, 0.0), 100 * NS
    trail.take(since, pose)
    for number in range(52):
        before, way = pose, 0.0 if number < 4 else 0.1
        pose, until = compose(pose, (way, 0.0, 0.1 * (number % 3 == 0))), since + round(EVERY_S * NS)
        trail.take(until, pose)
        x, y, turn = between(before, pose)
        back = -1.0 if number >= 28 else 1.0
        driven = trail.between(since, until)
        faults.take((back * x, back * y, turn), (1e-5, 0.0, 1e-5), 4e-6, driven, since, trail)
        assert faults.proven > PROVEN or number < 28
        since = until


@pytest.mark.parametrize("restarts", [False, True])
def test_a_proof_outlasts_a_relocation_and_a_restart_of_odometry(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, restarts: bool
) -> None:
    """Lidar, mount and encoders are the same as before."""
    core = make_core()
    assert drive(core, speaker, poses_of, weaving, weaving, stands=6, step=weaving)[-1].confidence > 0.99
    truth = np.array([2.0, 3.0, 0.0])
    if restarts:
        for late in range(RESTART_AFTER):
            list(core.handle(speaker.odometry(9.0 + 0.1 * late, np.zeros(3))))
        assert core.condition().counters["odometry_restarted"] == 1
    else:
        list(core.handle(Envelope(RELOCATION, {"site": "s", "robot": "r"}, Relocation())))
        assert core.condition().counters["relocated"] == 1
    output = list[PoseEstimate]()
    for scan in range(4):
        time = 17.0 + 0.1 * scan
        list(core.handle(speaker.odometry(time, np.zeros(3))))
        output += poses_of(core.handle(speaker.hypotheses(time, [truth], [17.0])))
    assert output[-1].confidence > 0.95


def test_before_it_has_moved_a_robot_is_localized_at_nine_in_ten(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    output = drive(make_core(), speaker, poses_of, weaving, weaving, stands=6, step=weaving)
    assert output[0].state == STATE_LOCALIZED
    assert output[0].confidence == pytest.approx(1.0 - WRONG)
    assert output[-1].confidence > 0.99
