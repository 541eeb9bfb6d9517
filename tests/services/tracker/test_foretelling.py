"""A pose at once, on odometry carried on by its last velocity; what the tracker knows is as if it waited."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from eigenscan.geometry.pose import compose, from_message
from eigenscan.schemas.channels import POSE, RELOCATION, TRACKS, TRANSFORM, Channel
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Relocation
from eigenscan.schemas.wire import encode
from eigenscan.tracker.core import TrackerCore

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
    heard: list[tuple[float, Envelope]] = []
    for k in range(round(seconds / PERIOD)):
        heard.append((k * PERIOD, speaker.odometry(100.0 + k * PERIOD, at(k * PERIOD))))
    rng = np.random.default_rng(7)
    for k in range(round(seconds / 0.1) - 1):
        time = 0.1 * k + 0.053
        truth = compose(START, at(time)) + rng.normal(size=3) * 0.02
        heard.append((time, speaker.hypotheses(100.0 + time, [truth], [25.0])))
    return [envelope for _, envelope in sorted(heard, key=lambda one: one[0])]


def published(core: TrackerCore, heard: Iterable[Envelope]) -> dict[Channel, list[Envelope]]:
    found: dict[Channel, list[Envelope]] = {POSE: [], TRACKS: [], TRANSFORM: []}
    for envelope in [*(each for one in heard for each in core.handle(one)), *core.finish()]:
        found[envelope.channel].append(envelope)
    return found


def payloads(envelopes: Iterable[Envelope]) -> list[bytes]:
    return [encode(envelope.message) for envelope in envelopes]


def test_the_pose_comes_with_the_scan_and_the_tracks_with_the_odometry(
    make_core: MakeCore, speaker: Speaker
) -> None:
    core = make_core()
    for k in range(3):
        list(core.handle(speaker.odometry(10.0 + k * PERIOD, at(k * PERIOD))))
    first = list(core.handle(speaker.hypotheses(10.05, [compose(START, at(0.05))], [25.0])))
    assert [each.channel for each in first] == [POSE]
    assert first[0].open(PoseEstimate).extrapolated
    assert nanoseconds(first[0].open(PoseEstimate).timestamp) == 10_050_000_000
    then = list(core.handle(speaker.odometry(10.06, at(0.06))))
    assert [each.channel for each in then if each.channel is not TRANSFORM] == [TRACKS]


def test_the_trackers_own_state_is_as_if_it_had_waited(make_core: MakeCore, speaker: Speaker) -> None:
    heard = drive(speaker, 6.0)
    waiting, at_once = published(make_core(at_once=False), heard), published(make_core(), heard)
    for channel in (TRACKS, TRANSFORM):
        assert payloads(at_once[channel]) == payloads(waiting[channel])
    poses = [[e.open(PoseEstimate) for e in way[POSE]] for way in (waiting, at_once)]
    assert [p.timestamp for p in poses[0]] == [p.timestamp for p in poses[1]]
    assert sum(p.extrapolated for p in poses[1]) == len(poses[1])
    assert not any(p.extrapolated for p in poses[0])
    apart = [from_message(a.pose) - from_message(b.pose) for a, b in zip(*poses, strict=True)]
    # on an arc the last velocity is as good as the next message, but for the turn within one period
    assert np.abs(apart).max() < 1e-4
    assert [p.state for p in poses[0]] == [p.state for p in poses[1]]
    assert poses[1][-1].state == STATE_LOCALIZED


def test_odometry_that_came_meanwhile_changes_nothing(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    """A projector that takes its time: its lists arrive after the odometry of up to 0.15 s later."""
    heard = drive(speaker, 3.0)
    stamps = np.array([envelope.stamp for envelope in heard])
    late = np.array(["hypotheses" in envelope.key for envelope in heard]) * 150_000_000
    slow = [heard[k] for k in np.argsort(stamps + late, kind="stable")]
    expected, found = published(make_core(), heard), published(make_core(), slow)
    assert payloads(found[POSE]) == payloads(expected[POSE])
    assert payloads(found[TRACKS]) == payloads(expected[TRACKS])


def test_odometry_that_is_due_is_waited_for(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    for k in range(3):
        list(core.handle(speaker.odometry(10.0 + k * PERIOD, at(k * PERIOD))))
    # one of 10.06 s is under way
    assert not list(core.handle(speaker.hypotheses(10.065, [compose(START, at(0.065))], [25.0])))
    told = list(core.handle(speaker.odometry(10.06, at(0.06))))
    assert [e.open(PoseEstimate).extrapolated for e in told if e.channel is POSE] == [True]


@pytest.mark.parametrize(
    "before",
    [
        pytest.param([(10.0, 0.0), (10.02, 0.01), (10.04, 30.0)], id="jump"),
        pytest.param([(10.04, 0.0)], id="first"),
        pytest.param([(9.5, 0.0), (10.04, 0.2)], id="seldom"),
        pytest.param([(10.03, 0.0), (10.05, 0.01)], id="of that very stamp"),
    ],
)
def test_where_no_velocity_is_told_the_pose_is_not_marked(
    before: list[tuple[float, float]], make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    for time, x in before:
        list(core.handle(speaker.odometry(time, np.array([x, 0.0, 0.0]))))
    told = poses_of(core.handle(speaker.hypotheses(10.05, [START], [25.0])))
    told += poses_of(core.handle(speaker.odometry(10.06, np.array([before[-1][1], 0.0, 0.0]))))
    assert [pose.extrapolated for pose in told] == [False]


def test_it_is_said_once_also_at_the_end(make_core: MakeCore, speaker: Speaker, poses_of: PosesOf) -> None:
    core = make_core()
    for k in range(3):
        list(core.handle(speaker.odometry(10.0 + k * PERIOD, at(k * PERIOD))))
    assert len(poses_of(core.handle(speaker.hypotheses(10.05, [START], [25.0])))) == 1
    assert [envelope.channel for envelope in core.finish()] == [TRACKS]


def test_a_relocation_meanwhile_does_not_say_it_twice(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    for k in range(3):
        list(core.handle(speaker.odometry(10.0 + k * PERIOD, at(k * PERIOD))))
    assert len(poses_of(core.handle(speaker.hypotheses(10.05, [START], [25.0])))) == 1
    list(core.handle(Envelope(RELOCATION, {"site": "s", "robot": "r"}, Relocation())))
    assert not poses_of(core.handle(speaker.odometry(10.06, at(0.06))))
