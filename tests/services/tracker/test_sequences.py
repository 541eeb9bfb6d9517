"""The paper's tracking (section 7), beside its formulas written out."""

from __future__ import annotations

import numpy as np
import pytest
from eigenscan.geometry.pose import compose, covariance_from_message, from_message
from eigenscan.schemas.tracking_pb2 import Track, Tracks
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings

from tests.services.tracker.conftest import MakeCore, Speaker, TracksOf

SPACING, STEP = 0.5, 0.1
CP = np.diag([SPACING, SPACING, STEP]) ** 2
PAPER = {"method": "paper", "grid_spacing": SPACING, "grid_step": STEP}
HERE = np.array([2.0, 3.0, 3.1])


@pytest.fixture
def tracker(make_core: MakeCore, speaker: Speaker) -> TrackerCore:
    speaker.clutter = 0
    return make_core(**PAPER)


def pose_and_covariance(track: Track) -> tuple[np.ndarray, np.ndarray]:
    return from_message(track.pose), covariance_from_message(track.covariance)


def after(tracker: TrackerCore, speaker: Speaker, tracks_of: TracksOf, *lists: list[np.ndarray]) -> Tracks:
    """Tracks after lists a second apart, without odometry, every hypothesis as likely as another."""
    output = [
        tracks
        for number, poses in enumerate(lists)
        for tracks in tracks_of(tracker.handle(speaker.hypotheses(float(number), poses, [20.0] * len(poses))))
    ]
    output += tracks_of(tracker.finish())
    assert len(output) == len(lists)
    return output[-1]


def test_a_new_track_has_the_grids_covariance(
    tracker: TrackerCore, speaker: Speaker, tracks_of: TracksOf
) -> None:
    """Cp, no matter what the projector states."""
    (track,) = after(tracker, speaker, tracks_of, [HERE]).tracks
    pose, C = pose_and_covariance(track)
    assert pose == pytest.approx(HERE)
    assert pytest.approx(CP) == C


def test_an_observed_pose_is_joined_in_information_form(
    tracker: TrackerCore, speaker: Speaker, tracks_of: TracksOf
) -> None:
    """C* = C + W; C^ = (C*^-1 + C^-1)^-1; X^ = C^ (C*^-1 X* + C^-1 Y), here across the heading's +-pi."""
    seen = HERE + np.array([0.3, -0.2, 0.1])
    (track,) = after(tracker, speaker, tracks_of, [HERE], [seen]).tracks
    settings = TrackerSettings.model_validate(PAPER)
    velocity = np.array([settings.v_max, settings.v_max, settings.turn_max])
    predicted = CP + np.diag((1.0 * velocity) ** 2)
    creep = np.array([0.005, 0.005, 0.002])  # what standing still adds
    predicted += np.diag(creep**2)
    information = np.linalg.inv(predicted) + np.linalg.inv(CP)
    joined = np.linalg.inv(information)
    expected = joined @ (np.linalg.inv(predicted) @ HERE + np.linalg.inv(CP) @ seen)
    pose, C = pose_and_covariance(track)
    assert pytest.approx(joined, abs=1e-9) == C
    assert pose[:2] == pytest.approx(expected[:2])
    assert np.cos(pose[2] - expected[2]) == pytest.approx(1.0)
    assert -np.pi <= pose[2] < np.pi


def test_a_track_without_a_pose_keeps_its_prediction_and_fades(
    tracker: TrackerCore, speaker: Speaker, tracks_of: TracksOf
) -> None:
    far = HERE + np.array([50.0, 0.0, 0.0])
    tracks = after(tracker, speaker, tracks_of, [HERE, far], [HERE]).tracks
    kept = {round(track.pose.x): track for track in tracks}
    assert kept[52].observations == 1
    assert pose_and_covariance(kept[52])[0] == pytest.approx(far)
    assert kept[2].probability / kept[52].probability == pytest.approx(np.exp(1.0), rel=1e-6)


def test_forks_share_their_tracks_probability(
    tracker: TrackerCore, speaker: Speaker, tracks_of: TracksOf
) -> None:
    """Two volumes of one place that hold the scan make it no likelier than another place with one."""
    far = HERE + np.array([50.0, 0.0, 0.0])
    shift = np.array([1.2, 0.0, 0.0])
    tracks = after(tracker, speaker, tracks_of, [HERE, far], [HERE + shift, HERE - shift, far + shift]).tracks
    here = [track for track in tracks if track.pose.x < 10.0]
    there = [track for track in tracks if track.pose.x > 10.0]
    assert len(here) == 2
    assert sum(t.probability for t in here) == pytest.approx(sum(t.probability for t in there))
    assert sum(t.probability for t in tracks) == pytest.approx(1.0)


def test_new_tracks_share_the_default_minimum_probability(
    tracker: TrackerCore, speaker: Speaker, tracks_of: TracksOf
) -> None:
    others = [HERE + np.array([20.0 * k, 0.0, 0.0]) for k in range(1, 11)]
    tracks = after(tracker, speaker, tracks_of, [HERE], [HERE, *others]).tracks
    new = [track.probability for track in tracks if track.observations == 1]
    assert len(new) == 10
    assert sum(new) == pytest.approx(0.01 / 1.01)


@pytest.mark.parametrize("seed", range(5))
def test_poses_that_err_by_centimetres_are_no_evidence(
    tracker: TrackerCore, speaker: Speaker, tracks_of: TracksOf, seed: int
) -> None:
    """Four places that look alike stay four: pose estimates differ by less than the grid's spacing."""
    rng = np.random.default_rng(seed)
    places = np.array([[5.0 * k, 0.0, 0.5 * k] for k in range(4)])
    driven, output = np.zeros(3), []
    for number in range(60):
        time = 1.0 + 0.5 * number
        list(tracker.handle(speaker.odometry(time, driven)))
        seen = compose(places, driven) + rng.normal(0.0, [0.03, 0.03, 0.01], (4, 3))
        output += tracks_of(tracker.handle(speaker.hypotheses(time, seen, [20.0] * 4)))
        driven = compose(driven, np.array([0.05, 0.0, 0.02]))
    assert len(output) == 60
    assert [track.probability for track in output[-1].tracks] == pytest.approx([0.25] * 4, abs=0.06)
