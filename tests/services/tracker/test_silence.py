"""Hypotheses that end without a pose for more than 2 s: health is degraded and states why."""

from __future__ import annotations

from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

import numpy as np
from eigenscan.schemas.channels import POSE, RELOCATION, SCAN_MOTION
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.scan_pb2 import ScanMotion
from eigenscan.schemas.tracking_pb2 import PoseEstimate, Relocation
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.silence import Silence
from eigenscan.tracker.timeline import Outcome

from tests.services.tracker.conftest import MakeCore, Speaker

HERE = np.array([2.0, 3.0, 0.0])
RATE_S = 0.1


def published_poses(core: TrackerCore, received: Iterable[Envelope]) -> int:
    """How many estimates with a pose came of it."""
    output = [each for message in received for each in core.handle(message)]
    return sum(each.open(PoseEstimate).track_id != 0 for each in output if each.channel is POSE)


def lists(speaker: Speaker, seconds: float, start: float = 0.0, **reported: object) -> list[Envelope]:
    times = start + np.arange(0.0, seconds, RATE_S)
    return [speaker.hypotheses(float(time), [HERE], [20.0], **reported) for time in times]  # type: ignore[arg-type]


def degraded(core: TrackerCore) -> str:
    """Why the tracker is degraded; empty: it is not."""
    condition = core.condition()
    return condition.detail if condition.status == Health.STATUS_DEGRADED else ""


def test_while_poses_come_nothing_is_wrong(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    assert published_poses(core, lists(speaker, 5.0)) > 40
    assert degraded(core) == ""


def test_odometry_that_is_behind(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core(patience=10.0)
    for time in np.arange(20.0, 23.0, RATE_S):
        list(core.handle(speaker.odometry(float(time) - 7.0, HERE)))
        assert not published_poses(core, [speaker.hypotheses(float(time), [HERE], [20.0])])
    assert "odometry stamps are 7.0 s behind the scans" in degraded(core)
    # it catches up: the lists that waited are answered
    assert published_poses(core, [speaker.odometry(23.0, HERE)])
    assert degraded(core) == ""


def test_odometry_that_never_comes(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core(patience=10.0)
    assert not published_poses(core, lists(speaker, 3.0))
    assert degraded(core).endswith("wait for odometry, no pose: none has come")


def test_odometry_that_ends_while_poses_come(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    for time in np.arange(0.0, 1.0, RATE_S):
        list(core.handle(speaker.odometry(float(time), HERE)))
        list(core.handle(speaker.hypotheses(float(time), [HERE], [20.0])))
    assert published_poses(core, lists(speaker, 1.5, 1.0))
    assert degraded(core) == ""
    assert published_poses(core, lists(speaker, 1.0, 2.5))
    assert degraded(core) == "r: no odometry of the last 2.5 s: does its driver still run?"
    list(core.handle(speaker.odometry(3.5, HERE)))
    assert degraded(core) == ""


def test_odometry_that_ended_before_the_first_scan(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    for time in np.arange(0.0, 1.0, RATE_S):
        list(core.handle(speaker.odometry(float(time), HERE)))
    published_poses(core, lists(speaker, 3.0, 1.0))
    assert "does its driver still run?" in degraded(core)


def test_scans_of_a_clock_ahead_are_not_odometry_that_ended(make_core: MakeCore, speaker: Speaker) -> None:
    """Poses come without waiting, for the scans' stamps are 100 s ahead: odometry comes all the same."""
    core = make_core(patience=0.2)
    for time in np.arange(0.0, 4.0, RATE_S):
        list(core.handle(speaker.odometry(float(time), HERE)))
        list(core.handle(speaker.hypotheses(float(time) + 100.0, [HERE], [20.0])))
    assert degraded(core) == "r: odometry stamps are 100.0 s behind the scans: do their clocks differ?"


def test_a_lidar_without_odometry_is_reported_and_no_fault(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    assert published_poses(core, lists(speaker, 3.0))
    condition = core.condition()
    assert condition.status == Health.STATUS_OK
    assert "no odometry has come" in condition.detail
    list(core.handle(speaker.odometry(3.0, HERE)))
    assert core.condition().detail == ""


def test_stamps_that_stand_still(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    published_poses(core, [speaker.hypotheses(5.0, [HERE], [20.0]) for _ in range(30)])
    assert "each repeats an earlier stamp" in degraded(core)
    published_poses(core, lists(speaker, 0.5, start=5.1))
    assert degraded(core) == ""


def test_stamps_that_stand_still_are_noticed_by_odometrys(make_core: MakeCore, speaker: Speaker) -> None:
    """Also of a lidar of 1 Hz, whose 20 lists take 20 s."""
    core = make_core()
    for time in (5.0, 6.0, 7.0, 8.0, 9.0):
        list(core.handle(speaker.odometry(time, HERE)))
        published_poses(core, [speaker.hypotheses(5.0, [HERE], [20.0])])
    assert "each repeats an earlier stamp" in degraded(core)


def test_stamps_too_far_apart_to_confirm_each_other(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    received = [speaker.hypotheses(100.0 * k, [HERE], [20.0]) for k in range(4)]
    assert not published_poses(core, received)
    assert "none within 60 s confirms it" in degraded(core)


def test_one_lidar_of_two_whose_clock_is_behind(make_core: MakeCore, speaker: Speaker) -> None:
    """The other one's poses are published as if it were alone."""
    core = make_core()
    for time in np.arange(20.0, 25.0, RATE_S):
        list(core.handle(speaker.odometry(float(time), HERE)))
        assert published_poses(core, [speaker.hypotheses(float(time), [HERE], [20.0])]) == 1
        published_poses(core, [speaker.hypotheses(float(time) - 10.0, [HERE], [20.0], lidar="rear")])
    assert "rear/0 arrive, no pose: their stamps are 10.0 s behind the newest" in degraded(core)


def test_two_drivers_of_one_name_whose_clocks_differ(make_core: MakeCore, speaker: Speaker) -> None:
    """Tracking starts again and again, as either clock counts."""
    core = make_core()
    for time in np.arange(20.0, 25.0, RATE_S):
        list(core.handle(speaker.odometry(float(time), HERE)))
        for each in (time, time - 10.0, time - 9.95):
            published_poses(core, [speaker.hypotheses(float(each), [HERE], [20.0])])
    assert "stamps of scans jump back repeatedly" in degraded(core)
    published_poses(core, lists(speaker, 6.0, start=25.0))
    published_poses(core, [speaker.odometry(31.0, HERE)])
    assert degraded(core) == ""


def test_a_few_lists_from_the_past_over_a_long_time(make_core: MakeCore, speaker: Speaker) -> None:
    """Four in a row do not set the clock back; another lidar's poses do not hide that they are lost."""
    core = make_core()
    for time in np.arange(20.0, 24.1, 1.0):
        published_poses(core, lists(speaker, 0.9, start=float(time)))
        if time < 24.0:
            published_poses(core, [speaker.hypotheses(float(time) - 3.0, [HERE], [20.0], lidar="rear")])
    assert "hypotheses of rear/0 arrive, no pose: their stamps are" in degraded(core)
    assert "s behind the newest" in degraded(core)


def test_unusable_scans(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    assert not published_poses(core, lists(speaker, 3.0, status=Hypotheses.STATUS_UNUSABLE_SCAN))
    assert "is the lidar covered, or is all beyond its range?" in degraded(core)
    published_poses(core, lists(speaker, 1.0, start=3.0))
    assert degraded(core) == ""


def test_unusable_scans_for_a_moment_are_no_fault(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    published_poses(core, lists(speaker, 1.0, status=Hypotheses.STATUS_UNUSABLE_SCAN))
    assert degraded(core) == ""


def test_a_frozen_lidar_after_a_new_search(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    robot = {"site": "s", "robot": "r"}
    published_poses(core, lists(speaker, 1.0))
    list(core.handle(Envelope(RELOCATION, robot, Relocation(timestamp=stamp(1_000_000_000)))))
    for number in range(10, 40):
        since, until = stamp(round((number - 1) * RATE_S * 1e9)), stamp(round(number * RATE_S * 1e9))
        frozen = ScanMotion(since=since, timestamp=until, repeats=1)
        list(core.handle(Envelope(SCAN_MOTION, {**robot, "lidar": "front"}, frozen)))
        assert not published_poses(core, [speaker.hypotheses(number * RATE_S, [HERE], [20.0])])
    assert "each scan repeats the one before" in degraded(core)


def test_maps_of_different_names_are_no_reason(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    for number in range(50):
        listed = ([HERE], [20.0]) if number % 2 else ([], [])
        received = speaker.hypotheses(number * RATE_S, *listed, frame=f"floor_{number % 2}")
        published_poses(core, [received])
    assert degraded(core) == ""


def test_empty_lists(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    times = np.arange(0.0, 3.0, RATE_S)
    assert not published_poses(core, [speaker.hypotheses(float(time), [], []) for time in times])
    assert "the lists are empty" in degraded(core)


def test_lists_of_no_numbers(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    speaker.clutter = 0
    nowhere = np.full(3, np.nan)
    times = np.arange(0.0, 3.0, RATE_S)
    assert not published_poses(core, [speaker.hypotheses(float(time), [nowhere], [1.0]) for time in times])
    assert "no numbers" in degraded(core)


def test_a_source_that_sends_nothing_any_more_is_no_reason(make_core: MakeCore, speaker: Speaker) -> None:
    """Seed 18: one late list of a stranger kept a tracker degraded for ever."""
    core = make_core()
    reasons = []
    for time in np.arange(0.0, 15.0, RATE_S):
        list(core.handle(speaker.odometry(float(time), HERE)))
        published_poses(core, [speaker.hypotheses(float(time), [HERE], [20.0])])
        if time == 1.0:
            published_poses(core, [speaker.hypotheses(0.3, [HERE], [20.0], projector="stranger")])
        reasons.append(degraded(core))
    assert "hypotheses of front/stranger arrive, no pose" in reasons[round(4.0 / RATE_S)]
    assert reasons[round(12.0 / RATE_S) :] == [""] * round(3.0 / RATE_S)


def test_a_source_from_before_the_clock_was_set_back_is_no_reason(
    make_core: MakeCore, speaker: Speaker
) -> None:
    """Seed 740: a stranger's lists were of a clock that was set back by 15 minutes."""
    core = make_core()
    for time in [*np.arange(900.0, 903.0, RATE_S), *np.arange(0.0, 15.0, RATE_S)]:
        list(core.handle(speaker.odometry(float(time), HERE)))
        published_poses(core, [speaker.hypotheses(float(time), [HERE], [20.0])])
        if time >= 900.1:
            published_poses(core, [speaker.hypotheses(1.0, [HERE], [20.0], projector="stranger")])
    assert degraded(core) == ""


def test_hypotheses_that_show_nothing(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core()
    speaker.clutter, speaker.unlisted = 0, 20.0
    assert not published_poses(core, lists(speaker, 3.0))
    assert "none is likelier than a pose that is not listed" in degraded(core)


def test_scans_that_fit_nowhere_in_the_map(make_core: MakeCore, speaker: Speaker) -> None:
    """Of another floor: its best place fits as places of any map do."""
    core, reasons = make_core(), list[str]()
    for time in np.arange(0.0, 20.0, RATE_S):
        pose = np.array([0.5 * time, 0.0, 0.0])
        list(core.handle(speaker.odometry(float(time), pose)))
        chance = np.random.default_rng(round(10 * time)).uniform(0.0, 20.0, 3)
        fits = time >= 15.0
        list(
            core.handle(speaker.hypotheses(float(time), [pose if fits else chance], [25.0 if fits else 2.5]))
        )
        reasons.append(degraded(core))
    assert reasons[: round(9.0 / RATE_S)] == [""] * round(9.0 / RATE_S)
    assert reasons[round(14.0 / RATE_S)].startswith("r: scans fit no place of the map, or many alike: ")
    assert reasons[-1] == ""


def test_where_most_scans_show_next_to_nothing_the_map_is_not_blamed(
    make_core: MakeCore, speaker: Speaker
) -> None:
    """In a hall wider than the lidar sees."""
    core, random = make_core(), np.random.default_rng(1)
    for scan, time in enumerate(np.arange(0.0, 15.0, RATE_S)):
        list(core.handle(speaker.odometry(float(time), np.array([0.5 * time, 0.0, 0.0]))))
        seen = speaker.hypotheses(float(time), [random.uniform(0.0, 20.0, 3)], [2.5])
        if scan % 3:
            seen = speaker.hypotheses(float(time), [], [], status=Hypotheses.STATUS_UNUSABLE_SCAN)
        list(core.handle(seen))
    assert degraded(core).startswith("r: most scans have too few beams with a return: ")


def test_one_scan_that_seems_to_fit_does_not_end_it() -> None:
    """In a wrong map health changed every few seconds."""
    timeline: Any = SimpleNamespace(newest=0, longest_waiting=None)
    silence = Silence(timeline)

    def stated(time: float, none: float) -> bool:
        seen: Any = SimpleNamespace(stamp=round(time * 1e9), source="front", usable=True)
        timeline.newest = seen.stamp
        silence.receive(seen, Outcome.TAKEN)
        silence.answer(seen, repeated=False, has_pose=True, none=none)
        return bool(silence.no_place)

    found = [
        stated(time, 0.5 if time in (8.0, 20.0) else 0.05 if time == 30.0 else 1.0) for time in range(40)
    ]
    assert found == [18 < time < 30 for time in range(40)]
