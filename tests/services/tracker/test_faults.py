"""The hidden Markov model of faults, against the plain forward algorithm, and the delay of scans' stamps."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np
import pytest
from eigenscan.tracker import faults as model
from eigenscan.tracker.faults import Faults
from eigenscan.tracker.lateness import STEP_NS, Lateness
from eigenscan.tracker.odometry import OdometryTrail
from eigenscan.tracker.planar import Pose, between, compose, inverse
from eigenscan.tracker.velocity_gate import VelocityGate
from hypothesis import given
from hypothesis import strategies as st

STEP_S = 0.2
NS = 1_000_000_000


def swerving(time: float) -> Pose:
    """A robot that drives at 0.5 m/s and swerves: its pose at a time, s."""
    pose: Pose = (0.0, 0.0, 0.0)
    for step in range(round(time / 0.01)):
        pose = compose(pose, (0.005, 0.0, 0.006 * np.sin(0.01 * step * 2.0)))
    return pose


@pytest.fixture(scope="module")
def trail() -> OdometryTrail:
    trail = OdometryTrail(VelocityGate(2.0, 3.0))
    pose: Pose = (0.0, 0.0, 0.0)
    for step in range(3000):
        if step % 2 == 0:
            trail.take(10 * NS + step * 10_000_000, pose)
        pose = compose(pose, (0.005, 0.0, 0.006 * np.sin(0.01 * step * 2.0)))
    return trail


def play(faults: Faults, trail: OdometryTrail, steps: range, late_s: float = 0.0, noise: float = 0.0) -> None:
    """Scans that show the motion of `late_s` ago."""
    rng = np.random.default_rng(1)
    for step in steps:
        since = 10 * NS + round(step * STEP_S * NS)
        driven = trail.between(since, since + round(STEP_S * NS))
        ago = round(late_s * NS)
        seen = trail.between(since - ago, since - ago + round(STEP_S * NS)).delta
        x, y, turn = np.array(seen) + noise * rng.standard_normal(3) * [0.02, 0.02, 0.015]
        faults.take((x, y, turn), (1e-6, 0.0, 1e-6), 1e-6, driven, since, trail)


def test_chances_of_each_state_sum_to_one() -> None:
    prior, change = model._start()
    assert prior.sum() == pytest.approx(1.0)
    assert change.sum(axis=1) == pytest.approx(np.ones(len(prior)))
    assert (change >= 0.0).all()


@given(
    st.lists(
        st.lists(st.floats(-30.0, 0.0), min_size=len(model._start()[0]), max_size=len(model._start()[0])),
        min_size=1,
        max_size=5,
    ),
    st.lists(st.booleans(), min_size=5, max_size=5),
)
def test_the_forward_algorithm_is_bayes_over_all_sequences_of_states(
    rows: list[list[float]], following: list[bool]
) -> None:
    """While scans follow from each other, they do not become another robot's, or late by more than a step."""
    prior, freely = model._start()
    bound, count = freely.copy(), len(model.LATE_BY)
    for state in (model.AGREE, model.SLIPPING, model.BACKWARDS):
        for first, size, least in (
            (model.UNRELATED, 2, model.AGREE),
            (model.LATE, count, model.LATE),
            (model.EARLY, count, model.EARLY),
        ):
            bound[state, first : first + size] = 0.0
            bound[state, least] += freely[state, first : first + size].sum()
    joint = prior
    faults = Faults()
    for row, follows in zip(rows, following, strict=False):
        faults._weigh(np.array(row), follows=follows)
        change = bound if follows else freely
        # unnormalised, and without the shift by the largest
        joint = np.array([sum(joint[i] * change[i, j] for i in range(len(prior))) for j in range(len(prior))])
        joint = joint * np.exp(np.array(row))
    assert faults.probability == pytest.approx(joint / joint.sum(), rel=1e-9, abs=1e-300)


@given(st.tuples(st.floats(-0.4, 0.4), st.floats(-0.1, 0.1), st.floats(-0.5, 0.5)), st.floats(0.1, 3.0))
def test_each_fault_predicts_its_motion(moved: Pose, since: float) -> None:
    passed = np.column_stack([np.arange(-9.0, 4.0, 0.1), np.zeros((130, 2)), np.zeros(130)])
    passed[:, 1] = 0.5 * passed[:, 0] ** 2
    scans, seen = (0.1, 0.02, -0.03), passed * [1.0, 2.0, 0.0, 0.0]
    got = model._predicted(moved, passed, scans, seen, since, since + 0.2)
    x, y, turn = moved
    assert got[model.AGREE] == pytest.approx(moved)
    assert got[model.FROZEN] == pytest.approx((0, 0, 0))
    assert got[model.REVERSED] == pytest.approx((-x, -y, turn))
    assert got[model.MIRRORED] == pytest.approx((x, -y, -turn))
    for state, angle in enumerate(model.TURNED, model.MOUNT_TURNED):
        assert got[state, :2] == pytest.approx(
            np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ [x, y]
        )
    for state, late in enumerate(model.LATE_BY, model.LATE):
        at = since - late
        way = 0.5 * (at + 0.2) ** 2 - 0.5 * at**2
        assert got[state] == pytest.approx((way, 0, 0), abs=0.002)
        off = np.array(scans) - got[model.EARLY + state - model.LATE]
        assert off == pytest.approx((x - 2.0 * way, y, turn), abs=0.004)


def test_what_agrees_is_trusted_and_a_delay_of_seconds_is_named(trail: OdometryTrail) -> None:
    right, late = Faults(), Faults()
    play(right, trail, range(60, 120), noise=1.0)
    play(late, trail, range(60, 120), late_s=2.0, noise=1.0)
    assert right.trust > 0.99
    assert late.trust < 0.01
    assert "2.0 s after" in late.cause


def test_scans_of_a_clock_that_is_behind_are_named() -> None:
    trail, early = OdometryTrail(VelocityGate(2.0, 3.0)), Faults()
    pose: Pose = (0.0, 0.0, 0.0)
    for step in range(1500):
        trail.take(10 * NS + step * 20_000_000, pose)
        pose = compose(pose, (0.01, 0.0, 0.012 * np.sin(2e-4 * step**2)))  # never the same again
    play(early, trail, range(30, 90), late_s=-2.0, noise=1.0)
    assert early.trust < 0.01
    assert "2.0 s before odometry" in early.cause


def drive(turns: Sequence[float], seen: Sequence[Pose], ahead2: float) -> list[tuple[float, str]]:
    """Trust and cause after each interval: odometry turns by `turns`, rad, on 0.2 m, and scans show `seen`.

    `ahead2`: variance of the scans' way ahead, m^2.
    """
    trail, faults, result = OdometryTrail(VelocityGate(2.0, 3.0)), Faults(), list[tuple[float, str]]()
    pose: Pose = (0.0, 0.0, 0.0)
    for number, (turn, scans) in enumerate(zip(turns, seen, strict=True)):
        before, since = pose, 10 * NS + number * NS // 2
        pose = compose(pose, (0.2, 0.0, turn))
        trail.take(since, before)
        trail.take(since + NS // 2, pose)
        driven = trail.between(since, since + NS // 2)
        faults.take(scans, (ahead2, 0.0, 1e-5), 1e-6, driven, since, trail)
        result.append((faults.trust, faults.cause))
    return result


def test_a_mirrored_lidar_of_an_exact_robot_is_named_within_three_seconds_of_turns_of_half_a_degree() -> None:
    trust, cause = drive([0.01] * 6, [(0.2, 0.0, -0.01)] * 6, 1e-5)[-1]
    assert trust < 0.1
    assert "upside down" in cause


def test_odometry_that_trembles_on_a_straight_way_makes_no_lidar_frozen_or_late() -> None:
    rng, turns, seen = np.random.default_rng(3), list[float](), list[Pose]()
    for number in range(200):
        turn = 0.3 * (number < 20)
        turns.append(turn + 0.005 * rng.standard_normal())
        seen.append((0.2, 0.0, turn + 0.001 * rng.standard_normal()))
    trust = [each for each, _ in drive(turns, seen, 1.0)]
    assert min(trust[40:]) > 0.97


def test_a_fit_that_finds_no_motion_once_is_no_fault() -> None:
    seen: list[Pose] = [(0.2, 0.0, 0.01)] * 40
    seen[20] = (0.0, 0.0, 0.0)
    trust = [each for each, _ in drive([0.01] * 40, seen, 1e-5)]
    assert min(trust) > 0.8
    assert trust[-1] > 0.95


def test_wheels_that_slip_for_a_second_are_named_meanwhile_and_the_scans_are_trusted(
    trail: OdometryTrail,
) -> None:
    faults = Faults()
    play(faults, trail, range(60, 80))
    for step in range(80, 85):
        since = 10 * NS + round(step * STEP_S * NS)
        driven = trail.between(since, since + round(STEP_S * NS))
        x, y, turn = driven.delta
        faults.take((x, y, turn + 0.4), (1e-6, 0.0, 1e-6), 1e-6, driven, since, trail)
        assert faults.trust > 0.85
    assert "do wheels slip" in faults.fault
    play(faults, trail, range(85, 105))
    assert faults.trust > 0.9
    assert not faults.fault


def test_a_straight_way_does_not_clear_a_lidar_that_lied_in_a_turn(trail: OdometryTrail) -> None:
    """Another robot drives straight on as fast: that shows nothing."""
    faults, straight = Faults(), OdometryTrail(VelocityGate(2.0, 3.0))
    pose: Pose = (0.0, 0.0, 0.0)
    for step in range(1000):
        turn = 0.015 if step < 500 else 0.0
        straight.take(10 * NS + step * 20_000_000, pose)
        pose = compose(pose, (0.01, 0.0, turn))
    for step in range(90):
        since = 10 * NS + round(step * STEP_S * NS)
        driven = straight.between(since, since + round(STEP_S * NS))
        faults.take((driven.delta[0], 0.0, 0.0), (1e-6, 0.0, 1e-6), 1e-6, driven, since, straight)
    assert faults.trust < 0.6


@pytest.mark.parametrize("late_ns", [0, 120_000_000, 200_000_000])
def test_the_delay_of_stamps_is_learned_to_a_step(trail: OdometryTrail, late_ns: int) -> None:
    lateness, rng = Lateness(), np.random.default_rng(3)
    for step in range(20, 130):
        since = 10 * NS + round(step * STEP_S * NS)
        until = since + round(STEP_S * NS)
        a, b = trail.as_stamped(since - late_ns), trail.as_stamped(until - late_ns)
        assert a is not None
        assert b is not None
        moved = between(a.chained, b.chained)
        x, y, turn = np.array(moved) + rng.standard_normal(3) * [0.01, 0.01, 0.005]
        lateness.take(since, until, (x, y, turn), trail)
    assert abs(lateness.delay - late_ns) <= STEP_NS / 2


def test_a_delayed_trail_gives_what_odometry_stated_as_long_before(trail: OdometryTrail) -> None:
    at = 20 * NS
    before = trail.as_stamped(at - 150_000_000)
    trail.delay(150_000_000)
    now = trail.at(at)
    trail.delay(0)
    assert before is not None
    assert now == before
    off = compose(inverse(before.chained), swerving(9.85))
    assert np.hypot(off[0], off[1]) < 0.01
    assert abs((off[2] + pi) % (2.0 * pi) - pi) < 0.01


def test_a_long_straight_way_makes_no_set_up_likelier_than_the_right_one() -> None:
    """A mirrored lidar, and a clock that is behind, show the same there; odometry's turns are mere noise."""
    rng, trail, faults = np.random.default_rng(0), OdometryTrail(VelocityGate(2.0, 3.0)), Faults()
    pose: Pose = (0.0, 0.0, 0.0)
    trail.take(10 * NS, pose)
    for step in range(400):
        since, turn = 10 * NS + step * NS // 5, 0.05 * np.sin(0.4 * step) * (step < 60)
        pose = compose(pose, (0.12, 0.0, turn + 0.0035 * rng.standard_normal()))
        trail.take(since + NS // 5, pose)
        x, y, heading = np.array([0.12, 0.0, turn]) + [0.003, 0.003, 0.002] * rng.standard_normal(3)
        driven = trail.between(since, since + NS // 5)
        faults.take((x, y, heading), (9e-6, 0.0, 9e-6), 4e-6, driven, since, trail)
    assert faults.trust > 0.985
    assert faults.proven >= 0.9
