"""Word from outside about where the robot is: it overrules the belief, and scans overrule it."""

from __future__ import annotations

import numpy as np
import pytest
from eigenscan.geometry.pose import covariance_to_message, to_message
from eigenscan.schemas.channels import POSE, RELOCATION, TRACKS, TRANSFORM
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, PoseEstimate, Relocation, Tracks
from eigenscan.tracker.core import TrackerCore

from tests.services.tracker.conftest import MakeCore, Speaker

HERE, THERE = np.array([2.0, 3.0, 0.5]), np.array([12.0, -4.0, -2.0])
SURE, ALIASES = [30.0], [20.0, 20.0]


def word(
    time: float, pose: np.ndarray | None = None, sigma: float | None = None, frame: str = ""
) -> Envelope:
    message = Relocation(timestamp=stamp(round(time * 1e9)), frame_id=frame)
    if pose is not None:
        message.pose.CopyFrom(to_message(pose))
    if sigma is not None:
        message.covariance.CopyFrom(covariance_to_message(np.diag([sigma**2, sigma**2, 0.1**2])))
    return Envelope(RELOCATION, {"site": "s", "robot": "r"}, message)


def stand(
    core: TrackerCore, speaker: Speaker, times: np.ndarray, poses: list[np.ndarray], merits: list[float]
) -> PoseEstimate:
    """The last estimate of a robot that stands at the odometry's origin."""
    output: list[Envelope] = []
    for time in times.tolist():
        output += core.handle(speaker.odometry(time, np.zeros(3)))
        output += core.handle(speaker.hypotheses(time, poses, merits))
    return [each.open(PoseEstimate) for each in output if each.channel is POSE][-1]


def is_near(message: PoseEstimate, pose: np.ndarray) -> bool:
    return bool(np.hypot(message.pose.x - pose[0], message.pose.y - pose[1]) < 0.2)


@pytest.mark.parametrize("method", ["mixture", "paper"])
@pytest.mark.parametrize("which", [0, 1])
def test_a_click_settles_which_of_two_rooms_alike(
    make_core: MakeCore, speaker: Speaker, method: str, which: int
) -> None:
    core = make_core(method=method)
    aliases = [HERE, THERE]
    assert stand(core, speaker, np.arange(0, 1, 0.1), aliases, ALIASES).state == STATE_AMBIGUOUS
    core.handle(word(1.0, aliases[which] + [0.4, -0.3, 0.2]))
    after = stand(core, speaker, np.arange(1.0, 2.0, 0.1), aliases, ALIASES)
    assert after.state == STATE_LOCALIZED
    assert is_near(after, aliases[which])


def test_a_precise_word_is_enough_to_claim(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    core.handle(word(0.0, HERE, sigma=0.1))
    output = stand(core, speaker, np.arange(0, 1, 0.1), [HERE, THERE], ALIASES)
    assert output.state == STATE_LOCALIZED
    assert is_near(output, HERE)


def test_a_wrong_click_does_not_last(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    core.handle(word(0.0, THERE))
    output = stand(core, speaker, np.arange(0, 1, 0.1), [HERE], SURE)
    assert output.state == STATE_LOCALIZED
    assert is_near(output, HERE)


def test_asked_to_forget_it_begins_as_at_the_start(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    before = stand(core, speaker, np.arange(0, 1, 0.1), [HERE], SURE)
    assert before.state == STATE_LOCALIZED
    core.handle(word(1.0))
    assert [each.channel for each in core.handle(speaker.odometry(1.0, np.zeros(3)))] == []
    after = stand(core, speaker, np.arange(1.05, 1.15, 0.1), [HERE, THERE], ALIASES)
    assert after.state == STATE_AMBIGUOUS
    assert after.track_id > before.track_id
    found = stand(core, speaker, np.arange(1.2, 2.0, 0.1), [THERE], SURE)
    assert found.state == STATE_LOCALIZED
    assert is_near(found, THERE)
    assert [each.channel for each in core.handle(speaker.odometry(2.0, np.zeros(3)))] == [TRANSFORM]


def test_a_word_is_moved_on_to_the_scan(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    for time in np.arange(0, 1.05, 0.1):
        core.handle(speaker.odometry(time, np.array([time, 0.0, 0.0])))
    core.handle(word(0.2, np.array([5.0, 5.0, np.pi / 2]), sigma=0.1))
    output = [*core.handle(speaker.hypotheses(1.0, [], []))]
    tracks = next(each.open(Tracks) for each in output if each.channel is TRACKS)
    assert tracks.tracks[0].pose.x == pytest.approx(5.0, abs=1e-6)
    assert tracks.tracks[0].pose.y == pytest.approx(5.8, abs=1e-6)
    assert tracks.tracks[0].observations == 0


def test_a_stamp_of_another_clock_counts_as_now(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    core.handle(word(1e6, HERE, sigma=0.1))
    assert is_near(stand(core, speaker, np.arange(0, 0.5, 0.1), [HERE, THERE], ALIASES), HERE)


def test_a_word_waits_for_a_scan_of_its_floor(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    core.handle(word(0.0, HERE, sigma=0.1, frame="upstairs"))
    other = stand(core, speaker, np.arange(0, 0.5, 0.1), [HERE, THERE], ALIASES)
    assert other.state == STATE_AMBIGUOUS
    output = [*core.handle(speaker.hypotheses(0.5, [HERE, THERE], ALIASES, frame="upstairs"))]
    output += core.handle(speaker.odometry(0.5, np.zeros(3)))
    tracks = next(each.open(Tracks) for each in output if each.channel is TRACKS)
    assert np.hypot(tracks.tracks[0].pose.x - HERE[0], tracks.tracks[0].pose.y - HERE[1]) < 0.2


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_a_word_that_is_no_pose_changes_nothing(make_core: MakeCore, speaker: Speaker, bad: float) -> None:
    core = make_core()
    before = stand(core, speaker, np.arange(0, 1, 0.1), [HERE], SURE)
    core.handle(word(1.0, np.array([bad, 0.0, 0.0])))
    after = stand(core, speaker, np.arange(1.0, 1.2, 0.1), [HERE], SURE)
    assert core.condition().counters["relocation_not_a_pose"] == 1
    assert after.track_id == before.track_id
    assert after.state == STATE_LOCALIZED
