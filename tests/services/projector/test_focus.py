"""A projector that receives where the robot is searches there, and everything once a second."""

from typing import Any

import numpy as np
import pytest
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.focus import Reach
from eigenscan.schemas.channels import POSE, TRACKS
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.geometry_pb2 import Covariance3, Pose2
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, PoseEstimate

from tests.services.projector.office import free_poses, is_right, poses_of, ready, receive, scan_at

# written out, not taken from what is tested: a change there must show here
FULL_EVERY = 1_000_000_000
SETTLED = 300_000_000
STALE = 1_500_000_000

START = 10**15
FULL = 2 * np.pi


def pose_at(truth: np.ndarray, time: int, **change: Any) -> PoseEstimate:
    fields: dict[str, Any] = {
        "timestamp": stamp(time),
        "frame_id": "map",
        "pose": Pose2(x=truth[0], y=truth[1], theta=truth[2]),
        "covariance": Covariance3(xx=0.01, yy=0.01, tt=0.001),
        "state": STATE_LOCALIZED,
    }
    return PoseEstimate(**{**fields, **change})


def publish(core: ProjectorCore, estimate: PoseEstimate) -> None:
    assert list(core.handle(Envelope(POSE, {"site": "s", "robot": "r"}, estimate))) == []


def searched(message: Hypotheses) -> set[str]:
    return {projection.region for projection in message.projections}


def test_only_who_is_configured_so_receives_poses_and_tracks() -> None:
    assert {POSE, TRACKS} & {*ready(focus=True, advice=False).inputs} == {POSE}
    assert {POSE, TRACKS} & {*ready().inputs} == {TRACKS}
    for without in (ready(advice=False), ready(part="2/2")):
        assert not {POSE, TRACKS} & {*without.inputs}


def test_around_a_sure_pose_little_is_searched_and_the_place_is_found() -> None:
    core, whole = ready(focus=True), ready()
    found, shares = 0, []
    for i, truth in enumerate(free_poses(15, 161)):
        time = START + i * 10 * FULL_EVERY
        everywhere = receive(core, scan_at(truth, field_of_view=FULL, seed=i, time=time))[0]
        publish(core, pose_at(truth, time))
        scan = scan_at(truth, field_of_view=FULL, seed=i, time=time + SETTLED)
        focused, plain = receive(core, scan)[0], receive(whole, scan)[0]
        assert searched(focused) <= searched(everywhere)
        shares.append(focused.searched_area_m2 / everywhere.searched_area_m2)
        assert focused.unlisted_log_likelihood == 0.0
        if is_right(poses_of(focused)[:1], truth)[0]:
            found += 1
            # what is known of the rest of the site keeps the scale
            first, other = focused.hypotheses[0], plain.hypotheses[0]
            assert abs(first.log_likelihood - other.log_likelihood) < 4.0
    assert found >= 14
    assert np.mean(shares) < 0.8
    assert core.condition().counters["scan_focused"] == 15


def test_once_a_second_the_whole_site_is_searched() -> None:
    core = ready(focus=True)
    truth = free_poses(1, 162)[0]
    areas = []
    for i in range(30):
        time = START + i * 100_000_000
        message = receive(core, scan_at(truth, field_of_view=FULL, seed=i, time=time))[0]
        publish(core, pose_at(truth, time))
        areas.append(message.searched_area_m2)
    # three scans until the first pose counts
    assert np.flatnonzero(np.equal(areas, max(areas))).tolist() == [0, 1, 2, 12, 22]


@pytest.mark.parametrize(
    ("age", "change"),
    [
        (SETTLED - 1, {}),
        (STALE + 1, {}),
        (SETTLED, {"state": STATE_AMBIGUOUS}),
        (SETTLED, {"frame_id": "another"}),
        (SETTLED, {"pose": Pose2(x=np.nan)}),
        (SETTLED, {"pose": Pose2(x=500.0)}),
    ],
)
def test_a_pose_that_shows_nothing_narrows_nothing(age: int, change: dict[str, object]) -> None:
    core = ready(focus=True)
    truth = free_poses(1, 163)[0]
    everywhere = receive(core, scan_at(truth, time=START))[0]
    at = START + FULL_EVERY - 1
    publish(core, pose_at(truth, at - age, **change))
    later = receive(core, scan_at(truth, seed=1, time=at))[0]
    assert later.searched_area_m2 == everywhere.searched_area_m2
    assert "scan_focused" not in core.condition().counters


def test_a_lidars_first_scan_soon_after_the_epoch_is_searched_for_everywhere() -> None:
    """Simulated time begins at 0: who was never searched for counted as searched for then: an error."""
    core, truth = ready(focus=True), free_poses(1, 163)[0]
    publish(core, pose_at(truth, SETTLED))
    assert len(receive(core, scan_at(truth, time=2 * SETTLED))[0].hypotheses) > 1
    assert "scan_focused" not in core.condition().counters


def test_a_pose_may_come_before_or_after_the_scan() -> None:
    truth = free_poses(1, 164)[0]
    answers = []
    for early in (True, False):
        core = ready(focus=True)
        receive(core, scan_at(truth, time=START))
        publish(core, pose_at(truth, START))
        if early:
            publish(core, pose_at(truth + 3.0, START + SETTLED // 2))
        answers.append(receive(core, scan_at(truth, time=START + SETTLED))[0].SerializeToString())
    assert answers[0] == answers[1]


def test_reach_touches_the_boxes_within_its_radius() -> None:
    boxes = np.array([[0.0, 0.0, 1.0, 1.0], [4.0, 0.0, 5.0, 1.0], [3.0, 4.0, 9.0, 9.0]])
    assert Reach(0.5, 0.5, 0.1).regions(boxes).tolist() == [True, False, False]
    assert Reach(0.0, 0.0, 5.0).regions(boxes).tolist() == [True, True, True]
    assert Reach(0.0, 0.0, 4.5).regions(boxes).tolist() == [True, True, False]
