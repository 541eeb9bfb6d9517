"""Odometry that counts backwards as forwards: noticed by how lists go on from each other."""

from __future__ import annotations

import numpy as np
import pytest
from eigenscan.geometry.pose import compose
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED
from eigenscan.tracker.belief import Belief
from eigenscan.tracker.direction import Direction
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.tracks import begin
from hypothesis import given
from hypothesis import strategies as st

from tests.services.tracker.conftest import MakeCore, PosesOf, Speaker

STEP = np.array([0.06, 0.0, 0.03])
BACK = STEP * [-1.0, -1.0, 1.0]


def told(scans: float) -> Motion:
    """What such odometry says of `scans` steps: all ahead."""
    turn = 0.03 * scans
    pose = np.zeros(3)
    for _ in range(round(scans)):
        pose = compose(pose, STEP)
    return Motion((*pose[:2].tolist(), turn), 0.06 * scans, abs(turn), 0.0, 0.0, 0.0, 0.1 * scans)


def lists(rng: np.random.Generator, steps: list[np.ndarray], persist: float) -> list[np.ndarray]:
    """Lists of a robot that moves by `steps`; a share of the hypotheses goes on, the others are new."""
    poses = rng.uniform([0, 0, -3], [40, 40, 3], (30, 3))
    said = []
    for step in steps:
        stays = rng.random(30) < persist
        poses = np.where(stays[:, None], compose(poses, step), rng.uniform([0, 0, -3], [40, 40, 3], (30, 3)))
        said.append(poses + rng.normal(size=(30, 3)) * [0.02, 0.02, 0.01])
    return said


def heard(said: list[np.ndarray]) -> tuple[list[bool], list[Motion]]:
    direction, states, mistaken = Direction(), [], []
    for number, poses in enumerate(said):
        found = direction.hear("0", number * 10**8, poses, lambda a, b: told((b - a) / 1e8))
        states.append(direction.reversed)
        mistaken += [] if found is None else [found]
    return states, mistaken


@given(st.integers(0, 10_000), st.sampled_from([0.5, 0.9]))
def test_the_sign_follows_the_lists_and_back_again(seed: int, persist: float) -> None:
    drive = [STEP] * 20 + [BACK] * 20 + [STEP] * 20
    states, mistaken = heard(lists(np.random.default_rng(seed), drive, persist))
    assert not any(states[:20])
    assert all(states[30:40])
    assert not any(states[50:])
    ahead, back = mistaken
    # what was believed of the way up to the moment at which it was found out
    assert ahead.delta[0] > 0.1 > -0.1 > back.delta[0]


def test_lists_that_have_nothing_in_common_say_nothing() -> None:
    states, mistaken = heard(lists(np.random.default_rng(0), [BACK] * 60, 0.0))
    assert not any(states)
    assert not mistaken


def test_a_robot_that_stands_is_not_compared_with_itself() -> None:
    direction, poses = Direction(), np.zeros((30, 3))
    still = Motion((0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0, 0.0, 0.1)
    for number in range(50):
        assert direction.hear("0", number * 10**8, poses, lambda _a, _b: still) is None
    assert not direction.reversed


def test_what_odometry_alone_carried_is_taken_back_and_what_a_scan_confirmed_is_not() -> None:
    belief = Belief(TrackerSettings())
    start = np.array([[2.0, 3.0, 0.5], [7.0, 1.0, -2.0], [4.0, 4.0, 3.1]])
    belief.source_index("0")
    belief.tracks = begin(
        start,
        np.tile(np.eye(3) * 1e-3, (3, 1, 1)),
        np.log([0.5, 0.3, 0.2]),
        np.zeros(3),
        np.zeros((3, 1)),
        0,
        0,
    )
    belief.predict(told(5))
    belief.tracks.unchecked[1] = 0.0
    carried = belief.tracks.x.copy()
    belief.take_back(told(5))
    x, y, turn = told(5).delta
    right = compose(start, np.array([-x, -y, turn]))
    np.testing.assert_allclose(belief.tracks.x[[0, 2]], right[[0, 2]], atol=1e-12)
    np.testing.assert_allclose(belief.tracks.x[1], carried[1], atol=1e-12)


@pytest.mark.parametrize("hidden", [False, True])
def test_backing_out_of_a_place_that_the_map_hardly_shows(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, hidden: bool
) -> None:
    """Where the right pose is in no list, wrong ones that go on tell the way's sign all the same."""
    core, rng = make_core(), np.random.default_rng(9)
    truth, odometry, aliases = (
        np.array([2.0, 3.0, 0.0]),
        np.zeros(3),
        [*rng.uniform([0, 0, -3], [40, 40, 3], (12, 3))],
    )
    errors, speaker.clutter = [], 0
    for scan in range(60):
        backing = 20 <= scan < 40
        step = BACK if backing else STEP
        truth, odometry = compose(truth, step), compose(odometry, STEP)
        aliases = [compose(pose, step) + rng.normal(size=3) * [0.02, 0.02, 0.01] for pose in aliases]
        core.handle(speaker.odometry(10.0 + 0.1 * scan, odometry))
        seen = truth + rng.normal(size=3) * [0.03, 0.03, 0.01]
        shown = not (hidden and 15 <= scan < 45)
        poses, logs = [*([seen] if shown else []), *aliases], [17.0] * shown + [6.0] * 12
        (message,) = poses_of(core.handle(speaker.hypotheses(10.0 + 0.1 * scan, poses, logs)))
        errors.append(np.hypot(message.pose.x - truth[0], message.pose.y - truth[1]))
    # 2.4 m, were odometry believed
    assert max(errors[5:]) < 0.5
    assert np.median(errors[30:]) < 0.1
    assert message.state == STATE_LOCALIZED
    assert core.condition().counters["odometry_sign_turned"] == 2
