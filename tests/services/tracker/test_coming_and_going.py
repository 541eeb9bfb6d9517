"""Robots that come and go: a tracker for many keeps those that it received lately."""

import gc

import numpy as np
import pytest
from eigenscan.schemas import recently_used
from eigenscan.schemas.channels import TRANSFORM
from eigenscan.schemas.envelope import Envelope
from eigenscan.tracker.robot import RobotTracker

from tests.services.tracker.conftest import MakeCore, Speaker

AMONG = 200


def of(robot: str, envelope: Envelope) -> Envelope:
    return Envelope(envelope.channel, {**envelope.address, "robot": robot}, envelope.message)


def trackers() -> int:
    gc.collect()
    return sum(type(one) is RobotTracker for one in gc.get_objects())


def test_who_is_gone_is_forgotten_and_starts_again_and_who_stays_does_not(
    make_core: MakeCore, speaker: Speaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recently_used, "AMONG", AMONG)
    before, core = trackers(), make_core()

    def knows(robot: str, time: float) -> bool:
        """Its odometry is placed in the map only once a pose was claimed."""
        output = core.handle(of(robot, speaker.odometry(time, np.zeros(3))))
        return any(each.channel is TRANSFORM for each in output)

    for robot in ("gone", "stays"):
        for time in np.arange(0.0, 2.0, 0.1).tolist():
            core.handle(of(robot, speaker.odometry(time, np.zeros(3))))
            core.handle(of(robot, speaker.hypotheses(time, [np.array([2.0, 3.0, 0.5])], [30.0])))
    assert knows("gone", 2.0)
    for number in range(4 * AMONG):
        core.handle(of(f"r{number}", speaker.odometry(0.0, np.zeros(3))))
        if number % (AMONG // 4) == 0:
            assert knows("stays", 2.0 + 0.1 * number)
    assert not knows("gone", 3.0)
    assert trackers() - before <= AMONG
