"""A claim that jumps is withdrawn first."""

from __future__ import annotations

import numpy as np
import pytest
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, STATE_LOST, PoseEstimate
from eigenscan.tracker.claim import Claim
from eigenscan.tracker.odometry import Motion, OdometryTrail
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.tracks import Tracks, begin
from eigenscan.tracker.velocity_gate import VelocityGate
from hypothesis import given
from hypothesis import strategies as st

from tests.services.tracker.conftest import MakeCore, PosesOf, Speaker, TracksOf


def at(x: float, y: float, heading: float = 0.0, sigma: float = 0.05, frame: int = 1) -> Tracks:
    pose, spread = np.array([[x, y, heading]]), np.diag([sigma, sigma, 0.05])[None] ** 2
    return begin(pose, spread, np.zeros(1), np.zeros(1), np.zeros((1, 1)), frame, 0)


def driven(way: float) -> Motion:
    trail = OdometryTrail(VelocityGate(2.0, 3.0))
    trail.take(0, (0.0, 0.0, 0.0))
    trail.take(1_000_000_000, (way, 0.0, 0.0))
    return trail.between(0, 1_000_000_000)


def test_a_claim_follows_odometry() -> None:
    claim = Claim(TrackerSettings())
    for step in range(5):
        assert claim.held_back(STATE_LOCALIZED, at(step * 0.8, 0.0), 0) == STATE_LOCALIZED
        claim.predict(driven(0.8))


@given(st.floats(0.9, 40.0), st.floats(-3.0, 3.0))
def test_a_jump_is_not_claimed_until_it_has_held_for_a_step(away: float, bearing: float) -> None:
    claim, there = Claim(TrackerSettings()), at(away * np.cos(bearing), away * np.sin(bearing))
    claim.held_back(STATE_LOCALIZED, at(0.0, 0.0), 0)
    assert claim.held_back(STATE_LOCALIZED, there, 0) == STATE_AMBIGUOUS
    claim.advance(0.1, 0.6)
    assert claim.held_back(STATE_LOCALIZED, there, 0) == STATE_AMBIGUOUS
    claim.advance(0.1, 0.6)
    assert claim.held_back(STATE_LOCALIZED, there, 0) == STATE_LOCALIZED


def test_going_to_and_fro_is_never_claimed() -> None:
    claim = Claim(TrackerSettings())
    claim.held_back(STATE_LOCALIZED, at(0.0, 0.0), 0)
    for place in (5.0, 0.0, 5.0, 0.0):
        claim.advance(0.1, 0.6)
        assert claim.held_back(STATE_LOCALIZED, at(place, 0.0), 0) == STATE_AMBIGUOUS


def test_a_turn_or_another_map_frame_is_a_jump_too() -> None:
    for there in (at(0.0, 0.0, heading=np.pi), at(0.0, 0.0, frame=2)):
        claim = Claim(TrackerSettings())
        claim.held_back(STATE_LOCALIZED, at(0.0, 0.0), 0)
        assert claim.held_back(STATE_LOCALIZED, there, 0) == STATE_AMBIGUOUS


def test_what_odometry_and_the_claims_own_spread_allow_is_no_jump() -> None:
    claim = Claim(TrackerSettings())
    claim.held_back(STATE_LOCALIZED, at(0.0, 0.0, sigma=0.4), 0)
    assert claim.held_back(STATE_LOCALIZED, at(0.9, 0.0), 0) == STATE_LOCALIZED


def test_after_a_claim_was_withdrawn_a_new_one_may_be_elsewhere() -> None:
    claim = Claim(TrackerSettings())
    claim.held_back(STATE_LOCALIZED, at(0.0, 0.0), 0)
    assert claim.held_back(STATE_LOST, at(0.0, 0.0), 0) == STATE_LOST
    assert claim.held_back(STATE_LOCALIZED, at(9.0, 0.0), 0) == STATE_LOCALIZED


def test_a_robot_that_stands_is_claimed_again_after_its_memory() -> None:
    claim = Claim(TrackerSettings())
    claim.held_back(STATE_LOCALIZED, at(0.0, 0.0), 0)
    states = []
    for _ in range(15):
        states.append(claim.held_back(STATE_LOCALIZED, at(9.0, 0.0), 0))
        claim.advance(0.101, 0.0)
    assert states == [STATE_AMBIGUOUS] * 5 + [STATE_LOCALIZED] * 10


def test_where_scans_show_that_the_robot_was_carried_away_nothing_is_held_back() -> None:
    claim = Claim(TrackerSettings())
    claim.held_back(STATE_LOCALIZED, at(0.0, 0.0), 0)
    claim.forget()
    assert claim.held_back(STATE_LOCALIZED, at(9.0, 0.0), 0) == STATE_LOCALIZED


def test_a_claim_that_no_list_confirms_any_more_ends_where_other_places_are_likely(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, tracks_of: TracksOf
) -> None:
    """The robot drives on from what the map shows, by good odometry; from then on another place is listed."""
    core = make_core(odometry_slip=0.01, odometry_turn=0.01, odometry_veer=0.001)
    settings = TrackerSettings()
    held, halfway = settings.released_below, (settings.released_below + settings.localized_above) / 2.0
    doubtful = list[PoseEstimate]()
    for scan in range(150):
        time, pose = 10.0 + 0.1 * scan, np.array([0.1 * scan, 0.0, 0.0])
        list(core.handle(speaker.odometry(time, pose)))
        place, likelihood = (pose, 17.0) if scan < 30 else (pose + np.array([0.0, 50.0, 0.0]), 13.0)
        output = list(core.handle(speaker.hypotheses(time, [place], [likelihood])))
        (estimate,), (beside,) = poses_of(output), tracks_of(output)
        if scan == 50:  # two metres on, odometry still carries it
            assert estimate.state == STATE_LOCALIZED
        likely = sum(track.probability for track in beside.tracks if abs(track.pose.y) < 1.0)
        if held <= estimate.confidence and likely < halfway and abs(estimate.pose.y) < 1.0:
            doubtful.append(estimate)
    assert doubtful
    assert all(estimate.state != STATE_LOCALIZED for estimate in doubtful)


@pytest.mark.parametrize("likelihood", [9.5, 14.0])
def test_the_place_that_is_ahead_again_and_again_is_claimed_however_poor_the_fits(
    make_core: MakeCore, poses_of: PosesOf, likelihood: float
) -> None:
    core, speaker = make_core(), Speaker(clutter=0)
    believed, elsewhere = [], np.random.default_rng(1)
    for scan in range(80):
        pose = np.array([0.1 * scan, 0.0, 0.0])
        others = elsewhere.uniform([-9.0, 2.0, -3.0], [9.0, 9.0, 3.0], (4, 3))
        for message in (
            speaker.odometry(0.1 * scan, pose),
            speaker.hypotheses(0.1 * scan, [pose, *others], [likelihood, *[likelihood - 2.0] * 4]),
        ):
            believed += [each.confidence for each in poses_of(core.handle(message))]
    assert believed[-1] > 0.8
