"""What was wrong with a lidar that no longer sends scans counts no more; in bounded memory."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.pose import compose
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.lidars import MOST, Lidars

from tests.services.tracker.conftest import MakeCore, PosesOf, Speaker
from tests.services.tracker.test_agreement import motion, weaving

FROZEN = (0.0, 0.0, 0.0)


def drive(
    core: TrackerCore, speaker: Speaker, poses_of: PosesOf, scans: int, rear: range, *, frozen: range
) -> list[PoseEstimate]:
    """Poses of a robot with a front lidar, and a `rear` one that sends scans then, and is `frozen` then."""
    output, truth = list[PoseEstimate](), np.array([2.0, 3.0, 0.0])
    for scan in range(scans):
        time, moved = 10.0 + 0.1 * scan, weaving(scan - 1)
        list(core.handle(speaker.odometry(time, truth)))
        list(core.handle(motion(time, time - 0.1, moved)))
        if scan in rear:
            list(core.handle(motion(time, time - 0.1, FROZEN if scan in frozen else moved, lidar="rear")))
            list(core.handle(speaker.hypotheses(time, [truth], [17.0], lidar="rear")))
        output += poses_of(core.handle(speaker.hypotheses(time, [truth], [17.0])))
        truth = compose(truth, np.array(weaving(scan)))
    return output


def test_a_faulty_lidar_that_is_switched_off_holds_no_claim_back(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    output = drive(core, speaker, poses_of, 180, rear=range(60), frozen=range(30, 60))
    assert output[-1].state == STATE_LOCALIZED
    assert core.condition().status == Health.STATUS_OK


def test_a_faulty_lidar_holds_claims_back_while_it_pauses(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    output = drive(core, speaker, poses_of, 150, rear=range(60), frozen=range(30, 60))
    assert output[-1].state != STATE_LOCALIZED
    assert "rear: scans stay the same" in core.condition().detail


def test_what_is_wrong_with_a_lidar_holds_again_once_it_is_back() -> None:
    known = Lidars(list[str])
    known.of("front")
    known.of("rear").append("frozen")
    for known.now in (5 * 10**9, 20 * 10**9):
        known.see("front", known.now)
        assert [name for name, _ in known.present()] == (
            ["front", "rear"] if known.now < 10**10 else ["front"]
        )
    known.see("rear", known.now)
    assert [*known.present()] == [("front", []), ("rear", ["frozen"])]


def test_scans_alone_show_nothing_of_a_lidar() -> None:
    """A lidar that has shown no motion yet makes nobody doubt one that has."""
    known = Lidars(list[str])
    known.of("front")
    known.see("rear", 0)
    assert [name for name, _ in known.present()] == ["front"]


def test_invented_names_leave_no_more_than_a_robot_has_lidars() -> None:
    known = Lidars(list[int])
    for number in range(1000):
        known.now = number
        known.see("front", number)
        known.of("front").append(number)
        known.of(f"invented {number}")
    assert len([*known.all()]) == MOST
    assert known.get("front") == [*range(1000)]
    assert known.get("invented 0") is None
