"""A pose at once, on odometry carried on by its last velocity; the next motion takes back what it misses."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from eigenscan.geometry.pose import compose, from_message, yaw
from eigenscan.schemas.channels import POSE, RELOCATION, SEARCH, TRACKS, TRANSFORM, Channel
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Relocation
from eigenscan.schemas.wire import encode
from eigenscan.tracker.core import TrackerCore
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from tests.services.tracker.conftest import MakeCore, PosesOf, Speaker

PERIOD = 0.02
"""s between two odometry messages."""
START = np.array([5.0, 5.0, 0.3])


def at(time: float, speed: float = 0.5, turn: float = 0.4) -> np.ndarray:
    """Motion (3,) after `time` s on an arc, m, m, rad."""
    angle = turn * time
    return np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0]) * speed / turn + np.array([0.0, 0.0, angle])


def drive(speaker: Speaker, seconds: float) -> list[Envelope]:
    """Odometry of 50 Hz and lists of 10 Hz between, in order of their stamps."""
    received: list[tuple[float, Envelope]] = []
    for k in range(round(seconds / PERIOD)):
        received.append((k * PERIOD, speaker.odometry(100.0 + k * PERIOD, at(k * PERIOD))))
    rng = np.random.default_rng(7)
    for k in range(round(seconds / 0.1) - 1):
        time = 0.1 * k + 0.053
        truth = compose(START, at(time)) + rng.normal(size=3) * 0.02
        received.append((time, speaker.hypotheses(100.0 + time, [truth], [25.0])))
    return [envelope for _, envelope in sorted(received, key=lambda one: one[0])]


def published(core: TrackerCore, received: Iterable[Envelope]) -> dict[Channel, list[Envelope]]:
    found: dict[Channel, list[Envelope]] = {POSE: [], SEARCH: [], TRACKS: [], TRANSFORM: []}
    for envelope in [*(each for one in received for each in core.handle(one)), *core.finish()]:
        found[envelope.channel].append(envelope)
    return found


def payloads(envelopes: Iterable[Envelope]) -> list[bytes]:
    return [encode(envelope.message) for envelope in envelopes]


def test_the_pose_comes_with_the_scan(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    for k in range(3):
        list(core.handle(speaker.odometry(10.0 + k * PERIOD, at(k * PERIOD))))
    first = list(core.handle(speaker.hypotheses(10.05, [compose(START, at(0.05))], [25.0])))
    assert [each.channel for each in first] == [POSE, SEARCH, TRACKS]
    assert first[0].open(PoseEstimate).extrapolated
    assert nanoseconds(first[0].open(PoseEstimate).timestamp) == 10_050_000_000
    then = core.handle(speaker.odometry(10.06, at(0.06)))
    assert {each.channel for each in then} <= {TRANSFORM}


def test_poses_are_as_if_they_had_waited(make_core: MakeCore, speaker: Speaker) -> None:
    received = drive(speaker, 6.0)
    waiting, at_once = published(make_core(at_once=False), received), published(make_core(), received)
    poses = [[e.open(PoseEstimate) for e in way[POSE]] for way in (waiting, at_once)]
    assert [p.timestamp for p in poses[0]] == [p.timestamp for p in poses[1]]
    assert sum(p.extrapolated for p in poses[1]) == len(poses[1])
    assert not any(p.extrapolated for p in poses[0])
    apart = [from_message(a.pose) - from_message(b.pose) for a, b in zip(*poses, strict=True)]
    # on an arc the last velocity is as good as the next message, but for the turn within one period
    assert np.abs(apart).max() < 1e-4
    assert [p.state for p in poses[0]] == [p.state for p in poses[1]]
    assert poses[1][-1].state == STATE_LOCALIZED
    assert len(waiting[TRACKS]) == len(at_once[TRACKS])


def test_a_robot_that_brakes_hard_is_where_odometry_puts_it_in_the_end(
    make_core: MakeCore, speaker: Speaker
) -> None:
    """It stands from the message after the scan on: the velocity led 3 cm astray, the hypotheses none."""
    core = make_core()
    for k in range(50):
        core.handle(speaker.odometry(10.0 + k * PERIOD, np.array([2.0 * k * PERIOD, 0.0, 0.0])))
        if k % 5 == 2:
            where = compose(START, np.array([2.0 * (k * PERIOD + 0.015), 0.0, 0.0]))
            core.handle(speaker.hypotheses(10.015 + k * PERIOD, [where], [25.0]))
    stop = np.array([2.0 * 49 * PERIOD, 0.0, 0.0])
    output = list(core.handle(speaker.hypotheses(10.995, [compose(START, stop)], [25.0])))
    ahead = output[0].open(PoseEstimate)
    assert ahead.extrapolated
    for k in range(50, 60):
        output += core.handle(speaker.odometry(10.0 + k * PERIOD, stop))
    reported = [each.message for each in output if each.channel is TRANSFORM][-1]
    assert isinstance(reported, FrameTransform)
    theta = yaw(reported.rotation)
    found = compose(np.array([reported.translation.x, reported.translation.y, theta]), stop)
    right = compose(START, stop)
    # what is left of the 3 cm is the share that the last hypothesis took of them
    assert np.hypot(*(found - right)[:2]) < 0.01
    assert np.hypot(*(from_message(ahead.pose) - right)[:2]) > 0.015


def test_lists_of_two_projectors_are_taken_in_one_order(make_core: MakeCore, speaker: Speaker) -> None:
    """Their answers to one scan come in any order, and poses do not depend on it."""
    received: tuple[list[Envelope], list[Envelope]] = [], []
    for envelope in drive(speaker, 2.0):
        one = [envelope]
        if "hypotheses" in envelope.key:
            one.append(Envelope(envelope.channel, {**envelope.address, "projector": "1"}, envelope.message))
        received[0].extend(one)
        # until both have answered once nobody knows that there are two
        received[1].extend(one if envelope.stamp < 100_100_000_000 else reversed(one))
    either, other = (published(make_core(), way) for way in received)
    assert len(either[POSE]) == 38
    for channel in (POSE, TRACKS):
        assert payloads(either[channel]) == payloads(other[channel])


def test_odometry_that_came_meanwhile_changes_nothing(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    """A projector that takes its time: its lists arrive after the odometry of up to 0.15 s later."""
    received = drive(speaker, 3.0)
    stamps = np.array([envelope.stamp for envelope in received])
    late = np.array(["hypotheses" in envelope.key for envelope in received]) * 150_000_000
    slow = [received[k] for k in np.argsort(stamps + late, kind="stable")]
    expected, found = published(make_core(), received), published(make_core(), slow)
    assert payloads(found[POSE]) == payloads(expected[POSE])
    assert payloads(found[TRACKS]) == payloads(expected[TRACKS])


def test_odometry_that_is_due_is_waited_for(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    for k in range(3):
        list(core.handle(speaker.odometry(10.0 + k * PERIOD, at(k * PERIOD))))
    # one of 10.06 s is under way
    assert not list(core.handle(speaker.hypotheses(10.065, [compose(START, at(0.065))], [25.0])))
    reported = list(core.handle(speaker.odometry(10.06, at(0.06))))
    assert [e.open(PoseEstimate).extrapolated for e in reported if e.channel is POSE] == [True]


@pytest.mark.parametrize(
    "before",
    [
        pytest.param([(10.0, 0.0), (10.02, 0.01), (10.04, 30.0)], id="jump"),
        pytest.param([(10.04, 0.0)], id="first"),
        pytest.param([(9.5, 0.0), (10.04, 0.2)], id="seldom"),
        pytest.param([(10.03, 0.0), (10.05, 0.01)], id="of that very stamp"),
    ],
)
def test_where_no_velocity_is_known_the_pose_is_not_marked(
    before: list[tuple[float, float]], make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    for time, x in before:
        list(core.handle(speaker.odometry(time, np.array([x, 0.0, 0.0]))))
    reported = poses_of(core.handle(speaker.hypotheses(10.05, [START], [25.0])))
    reported += poses_of(core.handle(speaker.odometry(10.06, np.array([before[-1][1], 0.0, 0.0]))))
    assert [pose.extrapolated for pose in reported] == [False]


def test_it_is_published_once_also_at_the_end(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    for k in range(3):
        list(core.handle(speaker.odometry(10.0 + k * PERIOD, at(k * PERIOD))))
    assert len(poses_of(core.handle(speaker.hypotheses(10.05, [START], [25.0])))) == 1
    assert not list(core.finish())


def test_a_relocation_meanwhile_does_not_publish_it_twice(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    for k in range(3):
        list(core.handle(speaker.odometry(10.0 + k * PERIOD, at(k * PERIOD))))
    assert len(poses_of(core.handle(speaker.hypotheses(10.05, [START], [25.0])))) == 1
    list(core.handle(Envelope(RELOCATION, {"site": "s", "robot": "r"}, Relocation())))
    assert not poses_of(core.handle(speaker.odometry(10.06, at(0.06))))
