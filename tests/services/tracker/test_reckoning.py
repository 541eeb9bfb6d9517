"""Odometry and scan motion together carry the tracks that no hypothesis confirms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from eigenscan.geometry.pose import compose
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.scan_pb2 import ScanMotion
from eigenscan.tracker.agreement import ScanInterval, Spread
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.planar import IDENTITY, Pose, between, scaled
from eigenscan.tracker.planar import compose as compose_one
from eigenscan.tracker.prediction import motion_noise, predict
from eigenscan.tracker.reckoning import SCAN_SIGMA, correct, leg
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.tracks import Tracks, begin, replace
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.services.tracker.conftest import MakeCore, PosesOf, Speaker
from tests.services.tracker.test_agreement import motion

Array = NDArray[np.float64]

SETTINGS = TrackerSettings()
SECOND = 1_000_000_000
START = np.array([[2.0, 3.0, 0.5], [7.0, 1.0, -2.0]])


def reported(delta: Pose, seconds: float = 1.0, unknown: float = 0.0) -> Motion:
    return Motion(delta, float(np.hypot(*delta[:2])), abs(delta[2]), 0.0, unknown, 0.0, seconds)


def tracks(stamp: int) -> Tracks:
    C = np.tile(np.diag([0.01, 0.02, 0.003]), (2, 1, 1))
    return begin(START, C, np.log([0.5, 0.5]), np.zeros(2), np.zeros((2, 1)), 0, stamp)


def steady(delta: Pose) -> Callable[[int, int], Motion]:
    """Odometry of a robot that drives `delta` every second, straight ahead."""
    return lambda a, b: reported(scaled(delta, (b - a) / SECOND), (b - a) / SECOND)


@given(
    st.tuples(st.floats(-0.3, 0.3), st.floats(-0.05, 0.05), st.floats(-0.4, 0.4)),
    st.tuples(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02), st.floats(-0.02, 0.02)),
)
def test_a_leg_is_kalmans_update_of_odometry_by_scan_motion(way: Pose, off: Pose) -> None:
    seen = compose_one(way, off)
    found = leg(ScanInterval("front", 0, SECOND, seen, (1e-4, 2e-5, 4e-4), 1e-4), reported(way), SETTINGS)
    slow = KalmanFilter(3, 3)
    slow.x, slow.P, slow.H = np.zeros((3, 1)), np.diag(motion_noise(reported(way), SETTINGS)), np.eye(3)
    reported_by_fit = np.array([[1e-4, 2e-5, 0.0], [2e-5, 4e-4, 0.0], [0.0, 0.0, 1e-4]])
    slow.R = np.diag(SCAN_SIGMA**2) + reported_by_fit
    slow.update(np.array(off).reshape(3, 1))
    np.testing.assert_allclose(found.correction, slow.x[:, 0], atol=1e-9)
    np.testing.assert_allclose(found.noise, slow.P, atol=1e-9)
    np.testing.assert_allclose(between(way, found.delta), slow.x[:, 0], atol=1e-9)


def test_odometry_that_slips_gives_way_to_the_scans() -> None:
    seen = (0.2, 0.0, 0.0)
    found = leg(ScanInterval("front", 0, SECOND, seen), reported((0.0, 0.0, 0.8)), SETTINGS)
    np.testing.assert_allclose(found.delta, seen, atol=0.02)


def test_a_track_that_nothing_confirmed_is_where_odometry_and_scans_together_lead() -> None:
    step = (0.3, 0.0, 0.1)
    way = leg(ScanInterval("front", 0, SECOND, (0.25, 0.0, 0.2)), reported(step), SETTINGS)
    before = tracks(0)
    # predicted by odometry to 1.5 s, then set right over the first second
    rest = steady(step)(SECOND, 3 * SECOND // 2)
    after = correct(before, way, 3 * SECOND // 2, steady(step), SETTINGS)
    right = compose(compose(START, np.array(way.delta)), np.array(rest.delta))
    np.testing.assert_allclose(after.x, right, atol=1e-12)
    assert (after.fixed_at == SECOND).all()
    # surer than by odometry alone
    _, alone = predict(*predict(START, before.C, reported(step), SETTINGS), rest, SETTINGS)
    assert (np.linalg.det(after.C) < np.linalg.det(alone)).all()


def test_what_scans_confirm_of_a_way_no_longer_counts_as_unchecked() -> None:
    step = (0.3, 0.0, 0.1)
    driven = (0.3, 0.1)
    sharp, hallway = (1e-6, 0.0, 1e-6), (1e4, 0.0, 1e-6)

    def left(spread: Spread, turn_variance: float) -> Array:
        way = leg(ScanInterval("front", 0, SECOND, step, spread, turn_variance), reported(step), SETTINGS)
        before = replace(tracks(0), unchecked=np.tile(driven, (2, 2)))
        unchecked: Array = correct(before, way, SECOND, steady(step), SETTINGS).unchecked
        # lists have confirmed nothing
        np.testing.assert_allclose(unchecked[:, :2], [driven, driven])
        np.testing.assert_array_equal(unchecked[0], unchecked[1])
        return unchecked[0, 2:] / driven

    assert (left(sharp, 1e-6) < 0.75).all()
    way, turn = left(hallway, 1e-6)
    assert way == pytest.approx(1.0, abs=1e-3)
    assert turn < 0.75
    np.testing.assert_allclose(left(hallway, 1e4), 1.0, atol=1e-3)


@pytest.mark.parametrize("seconds", [1.0, 1e12])
@pytest.mark.parametrize("variance", [0.0, 1e-12, 1e300])
@pytest.mark.parametrize("far", [0.0, 1e8])
def test_what_is_unchecked_is_a_share(far: float, variance: float, seconds: float) -> None:
    spread = (variance, 0.0, variance)
    for step in ((0.0, 0.0, 0.0), (far, far, 3.0), (-far, 0.0, 0.0)):
        seen = ScanInterval("front", 0, SECOND, (0.1, 0.2, -0.5), spread, variance)
        way = leg(seen, reported(step, seconds), SETTINGS)
        assert all(0.0 <= share <= 1.0 for share in way.unchecked)


def test_scans_take_nothing_from_the_way_after_them() -> None:
    step = (0.3, 0.0, 0.1)
    way = leg(ScanInterval("front", 0, SECOND, step), reported(step), SETTINGS)
    later = replace(tracks(SECOND), unchecked=np.ones((2, 4)))
    after = correct(later, way, 2 * SECOND, steady(step), SETTINGS)
    np.testing.assert_array_equal(after.unchecked, later.unchecked)


@pytest.mark.parametrize(("confirmed", "share"), [(0.25, 0.75), (0.5, 0.5), (1.0, 0.0), (1.2, 0.0)])
def test_a_track_takes_the_part_of_a_correction_since_it_was_confirmed(
    confirmed: float, share: float
) -> None:
    step = (0.4, 0.0, 0.0)
    way = leg(ScanInterval("front", 0, SECOND, (0.4, 0.0, 0.1)), reported(step), SETTINGS)
    at = round(confirmed * SECOND)
    before = tracks(at)
    after = correct(before, way, max(at, SECOND), steady(step), SETTINGS)
    turned: NDArray[np.float64] = after.x[:, 2] - before.x[:, 2]
    np.testing.assert_allclose(turned, share * way.correction[2], atol=1e-9)


def test_a_turn_that_odometry_misses_does_not_lead_a_hidden_track_astray(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    """Odometry shows nothing of half a radian, in a place that the map does not show."""
    core, truth, stated = make_core(), np.array([2.0, 3.0, 0.0]), np.zeros(3)
    before = truth
    errors = list[float]()
    for scan in range(80):
        time, hidden = 10.0 + 0.1 * scan, 30 <= scan < 70
        turns = 0.05 if 30 <= scan < 40 else 0.0
        list(core.handle(speaker.odometry(time, stated)))
        if scan and scan % 3 == 0:
            list(core.handle(motion(time, time - 0.3, _since(truth, before))))
        if scan % 3 == 0:
            before = truth
        seen = ([], []) if hidden else ([truth], [17.0])
        (pose,) = poses_of(core.handle(speaker.hypotheses(time, *seen)))
        errors.append(float(np.hypot(pose.pose.x - truth[0], pose.pose.y - truth[1])))
        truth = compose(truth, np.array([0.05, 0.0, turns]))
        stated = compose(stated, np.array([0.05, 0.0, 0.0]))
    assert max(errors) < 0.25


@pytest.mark.parametrize(
    "ways", [{"alone"}, {"with hypotheses"}, {"alone", "with hypotheses"}, {"both, late"}]
)
def test_a_pose_has_the_turn_that_its_own_scan_shows(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, ways: set[str]
) -> None:
    """Odometry misses a quick turn, and the scan's list is empty."""
    core, truth = make_core(), np.array([2.0, 3.0, 0.0])
    for scan in range(10):
        list(core.handle(speaker.odometry(10.0 + 0.1 * scan, np.zeros(3))))
        list(core.handle(speaker.hypotheses(10.0 + 0.1 * scan, [truth], [17.0])))
    list(core.handle(speaker.odometry(11.0, np.zeros(3))))
    turn, seen = motion(11.0, 10.9, (0.0, 0.0, 0.25)), speaker.hypotheses(11.0, [], [])
    if "alone" in ways:
        list(core.handle(turn))
    if ways != {"alone"}:
        seen.open(Hypotheses).motion.CopyFrom(turn.open(ScanMotion))
    (pose,) = poses_of(core.handle(seen))
    assert abs(pose.pose.theta - 0.25) < 0.05
    if "both, late" in ways:
        list(core.handle(turn))
    list(core.handle(speaker.odometry(11.1, np.zeros(3))))
    (pose,) = poses_of(core.handle(speaker.hypotheses(11.1, [], [])))
    assert abs(pose.pose.theta - 0.25) < 0.05  # not taken twice


def test_without_odometry_scans_carry_a_hidden_track(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core, truth, before = make_core(), np.array([2.0, 3.0, 0.0]), np.array([2.0, 3.0, 0.0])
    errors = list[float]()
    for scan in range(60):
        time = 10.0 + 0.1 * scan
        if scan:
            list(core.handle(motion(time, time - 0.1, _since(truth, before))))
        before = truth
        for pose in poses_of(
            core.handle(speaker.hypotheses(time, *(([], []) if scan >= 30 else ([truth], [17.0]))))
        ):
            # waits for odometry that does not come: it is of an earlier scan
            errors.append(float(np.hypot(pose.pose.x - truth[0], pose.pose.y - truth[1])))
        truth = compose(truth, np.array([0.03, 0.0, 0.02]))
    assert len(errors) > 50
    assert max(errors) < 0.3


def _since(now: NDArray[np.float64], before: NDArray[np.float64]) -> Pose:
    (x, y, heading), (a, b, c) = before.tolist(), now.tolist()
    return between((x, y, heading), (a, b, c))


def test_no_report_leaves_the_tracks() -> None:
    before = tracks(5 * SECOND)
    way = leg(ScanInterval("front", 0, SECOND, IDENTITY), reported(IDENTITY), SETTINGS)
    assert correct(before, way, 6 * SECOND, steady(IDENTITY), SETTINGS) is before
