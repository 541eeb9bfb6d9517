"""A sure robot asks for the whole map as often as that is evidence, and for its own place in between."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.pose import compose, from_message
from eigenscan.schemas.channels import POSE, RELOCATION, SCAN_MOTION, SEARCH, TRACKS
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.hypotheses_pb2 import SEARCH_LOCAL, SEARCH_WHOLE, Hypotheses, SearchRequest
from eigenscan.schemas.scan_pb2 import ScanMotion
from eigenscan.schemas.tracking_pb2 import (
    STATE_AMBIGUOUS,
    STATE_LOCALIZED,
    PoseEstimate,
    Relocation,
    State,
    Tracks,
)
from eigenscan.tracker.continuity import NEAR_RAD
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.search import PLACES

from tests.services.tracker.conftest import MakeCore, Speaker

START = np.array([5.0, 5.0, 0.3])
PERIOD = 0.1
Way = Callable[[float], np.ndarray]


def standing(_time: float) -> np.ndarray:
    return np.zeros(3)


def straight(time: float) -> np.ndarray:
    return np.array([0.8 * time, 0.0, 0.0])


def requests(published: Iterable[Envelope]) -> list[SearchRequest]:
    return [one.open(SearchRequest) for one in published if one.channel is SEARCH]


class Robot:
    """Drives a way; a projector that does as it is asked answers each scan at the true pose."""

    def __init__(self, core: TrackerCore, speaker: Speaker, way: Way = standing) -> None:
        self.core, self.speaker, self.way = core, speaker, way
        self.asked: list[SearchRequest] = []
        self.poses: list[PoseEstimate] = []
        self.tracks: list[Tracks] = []
        self.scans = 0

    def drive(self, scans: int, likelihood: float = 25.0, off: float = 0.0, **list_: Any) -> Robot:
        for _ in range(scans):
            time = PERIOD * self.scans
            self.receive(self.speaker.odometry(100.0 + time, self.way(time)))
            truth = compose(START, self.way(time)) + np.array([off, 0.0, 0.0])
            local = bool(self.asked) and self.asked[-1].search == SEARCH_LOCAL
            message = self.speaker.hypotheses(100.0 + time, [truth], [likelihood], **list_)
            self.receive(as_local(message) if local else message)
            self.scans += 1
        return self

    def receive(self, envelope: Envelope) -> None:
        published = list(self.core.handle(envelope))
        self.asked += requests(published)
        self.poses += [one.open(PoseEstimate) for one in published if one.channel is POSE]
        self.tracks += [one.open(Tracks) for one in published if one.channel is TRACKS]

    @property
    def local(self) -> list[bool]:
        return [one.search == SEARCH_LOCAL for one in self.asked]


def as_local(envelope: Envelope) -> Envelope:
    """Its first hypothesis alone, as a projector gives it that looked nowhere else."""
    message = Hypotheses()
    message.CopyFrom(envelope.open(Hypotheses))
    del message.hypotheses[1:]
    message.search, message.searched_area_m2 = SEARCH_LOCAL, 0.8
    return Envelope(envelope.channel, envelope.address, message)


@pytest.fixture(autouse=True)
def _sure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing confirms the odometry here, so no robot is surer than 0.93."""
    monkeypatch.setattr("eigenscan.tracker.robot.SURE", 0.91)


@pytest.fixture
def robot(make_core: MakeCore, speaker: Speaker) -> Robot:
    return Robot(make_core(local_fits=True), speaker)


@pytest.mark.parametrize(("places", "state"), [(1, STATE_LOCALIZED), (2, STATE_AMBIGUOUS)])
def test_tracks_state_what_is_claimed(robot: Robot, places: int, state: State) -> None:
    for scan in range(5):
        found = [START, compose(START, np.array([3.0, 0.0, 0.0]))][:places]
        robot.receive(robot.speaker.hypotheses(100.0 + scan, found, [25.0] * places))
    robot.core.finish()
    assert robot.tracks[-1].state == robot.poses[-1].state == state


def test_without_the_setting_nothing_is_asked_for(make_core: MakeCore, speaker: Speaker) -> None:
    robot = Robot(make_core(local_fits=False), speaker).drive(20)
    assert robot.poses[-1].state == STATE_LOCALIZED
    assert not robot.asked


def test_each_pose_has_a_request_of_its_stamp(robot: Robot) -> None:
    robot.drive(30)
    assert [nanoseconds(one.timestamp) for one in robot.asked] == [
        nanoseconds(one.timestamp) for one in robot.poses
    ]
    assert len(robot.asked) == 30


def test_a_robot_that_is_not_sure_needs_the_whole_map(make_core: MakeCore, speaker: Speaker) -> None:
    robot = Robot(make_core(local_fits=True, localized_above=1.0), speaker).drive(20)
    assert all(one.search == SEARCH_WHOLE for one in robot.asked)


def test_standing_a_whole_search_comes_each_second(robot: Robot) -> None:
    robot.drive(60)
    # a request is for the next scan
    whole = 1 + np.flatnonzero(~np.array(robot.local[:-1]))
    assert robot.poses[-1].state == STATE_LOCALIZED
    settled = whole[whole >= 10]
    assert len(settled) >= 4
    assert set(np.diff(settled)) == {10}


def test_driving_a_whole_search_comes_with_each_new_place(make_core: MakeCore, speaker: Speaker) -> None:
    robot = Robot(make_core(local_fits=True), speaker, straight).drive(60)
    whole = 1 + np.flatnonzero(~np.array(robot.local[:-1]))
    settled = whole[whole >= 10]
    way = np.diff(settled) * PERIOD * 0.8
    assert len(settled) >= 5
    # the first scan from half of independence_m on
    assert way.min() > 0.25 - 1e-9
    assert way.max() < 0.25 + 0.08


def test_the_request_predicts_the_next_pose(make_core: MakeCore, speaker: Speaker) -> None:
    robot = Robot(make_core(local_fits=True), speaker, straight).drive(30)
    local = [one for one in robot.asked if one.search == SEARCH_LOCAL]
    for one in local[-5:]:
        time = nanoseconds(one.timestamp) * 1e-9 - 100.0
        now = compose(from_message(one.pose), from_message(one.velocity) * PERIOD)
        off = now - compose(START, straight(time + PERIOD))
        assert np.hypot(off[0], off[1]) < 0.03
        assert one.covariance.xx > 0.0
        assert one.frame_id == "map"
        assert one.least_log_likelihood == pytest.approx(20.0)  # 5 nats below the last whole list's


def test_requests_name_the_places_of_tracks_the_heaviest_first(make_core: MakeCore, speaker: Speaker) -> None:
    core, way, asked = make_core(), compose(START, np.array([6.0, 0.0, 0.0])), list[SearchRequest]()
    for k in range(6):
        moved = straight(PERIOD * k)
        places = [compose(start, moved) for start in (START, way)]
        core.handle(speaker.odometry(100.0 + PERIOD * k, moved))
        asked += requests(core.handle(speaker.hypotheses(100.0 + PERIOD * k, places, [19.0, 18.0])))
    last = asked[-1]
    assert last.search == SEARCH_WHOLE
    for place, truth in zip(last.places, places, strict=False):
        next_ = compose(from_message(place), from_message(last.velocity) * PERIOD)
        assert next_ == pytest.approx(compose(truth, np.array([0.8 * PERIOD, 0.0, 0.0])), abs=0.03)
    assert 2 <= len(last.places) <= PLACES
    # before the robot's velocity is known, no track is where the next scan is
    assert not asked[0].places


def test_stamps_that_come_in_bursts_give_the_velocity_all_the_same(
    make_core: MakeCore, speaker: Speaker
) -> None:
    robot = Robot(make_core(local_fits=True), speaker)
    for scan in range(60):
        # every second scan is stamped 1 ms after the one before it
        time = 100.0 + 2 * PERIOD * (scan // 2) + 0.001 * (scan % 2)
        moved = straight(PERIOD * scan)
        robot.receive(speaker.odometry(time, moved))
        listed = speaker.hypotheses(time, [compose(START, moved)], [25.0])
        robot.receive(as_local(listed) if robot.local and robot.local[-1] else listed)
    velocities = [one.velocity.x for one in robot.asked if one.search == SEARCH_LOCAL]
    assert len(velocities) > 20
    # 0.08 m from scan to scan: over 1 ms that were 80 m/s; over 0.2 s, two or three of them
    assert min(velocities) > 0.35
    assert max(velocities) < 1.25


def test_a_pose_that_the_map_shows_badly_needs_the_whole_map(make_core: MakeCore, speaker: Speaker) -> None:
    robot = Robot(make_core(local_fits=True), speaker, straight).drive(30)
    assert any(robot.local[-5:])
    robot.drive(10, likelihood=7.0)  # speaks against a track, even on the worst map
    assert not any(robot.local[-5:])


def test_on_an_inexact_map_no_fit_is_good_enough(make_core: MakeCore, speaker: Speaker) -> None:
    robot = Robot(make_core(local_fits=True), speaker, straight).drive(300, likelihood=11.0)
    assert robot.poses[-1].state == STATE_LOCALIZED  # scans have shown what the map is worth
    assert not any(robot.local)


def test_turning_the_whole_lists_lie_so_near_that_a_kidnap_shows(
    make_core: MakeCore, speaker: Speaker
) -> None:
    def turning(seconds: float) -> np.ndarray:
        return np.array([0.0, 0.0, 0.4 * seconds])

    robot = Robot(make_core(local_fits=True), speaker, turning).drive(60)
    whole = 1 + np.flatnonzero(~np.array(robot.local[:-1]))
    settled = whole[whole >= 10]
    assert any(robot.local[10:])
    # of the scans that were to be fitted locally the last is the one before a whole search
    assert (np.diff(settled).max() - 1) * PERIOD * 0.4 <= NEAR_RAD + 1e-9


def test_a_robot_whose_odometry_nothing_confirms_needs_the_whole_map(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    robot.drive(30)
    assert robot.poses[-1].confidence == pytest.approx(0.9)
    assert not any(robot.local)


def test_a_robot_that_is_only_fairly_sure_needs_the_whole_map(robot: Robot) -> None:
    robot.drive(25)
    assert any(robot.local[-5:])
    elsewhere, claimed = compose(START, np.array([3.0, 0.0, 0.0])), list[PoseEstimate]()
    for _ in range(60):
        time = 100.0 + PERIOD * robot.scans
        robot.receive(robot.speaker.odometry(time, np.zeros(3)))
        robot.receive(robot.speaker.hypotheses(time, [START, elsewhere], [25.0, 23.5]))
        robot.scans += 1
        claimed.append(robot.poses[-1])
        if claimed[-1].confidence < 0.91:
            assert robot.asked[-1].search == SEARCH_WHOLE
    # some of them while it still claims its pose
    assert any(0.75 < one.confidence < 0.91 and one.state == STATE_LOCALIZED for one in claimed)


def test_local_lists_move_the_pose_and_are_no_evidence(robot: Robot) -> None:
    robot.drive(25)
    at = next(i for i, one in enumerate(robot.local[20:], 20) if one and robot.local[i - 1])
    assert robot.local[at]
    before, shares = robot.poses[-1], robot.tracks[-1]
    # with any likelihood
    for likelihood in (300.0, 1.0):
        robot.receive(robot.speaker.odometry(100.0 + PERIOD * robot.scans, np.zeros(3)))
        better = START + np.array([0.05, 0.0, 0.0])
        message = robot.speaker.hypotheses(100.0 + PERIOD * robot.scans, [better], [likelihood])
        robot.receive(as_local(message))
        robot.scans += 1
        assert [one.probability for one in robot.tracks[-1].tracks] == pytest.approx(
            [one.probability for one in shares.tracks], abs=1e-4
        )
    assert robot.poses[-1].pose.x > before.pose.x + 1e-4
    assert robot.poses[-1].confidence <= before.confidence + 1e-4


def test_a_local_list_begins_no_track(robot: Robot) -> None:
    robot.receive(robot.speaker.odometry(100.0, np.zeros(3)))
    robot.receive(as_local(robot.speaker.hypotheses(100.0, [START], [60.0])))
    assert robot.poses[-1].track_id == 0
    assert not robot.tracks[-1].tracks
    assert robot.asked[-1].search == SEARCH_WHOLE


def test_a_local_list_elsewhere_changes_nothing_but_what_is_asked(robot: Robot) -> None:
    robot.drive(25)
    while not (robot.local[-1] and robot.local[-2]):
        robot.drive(1)
    before = robot.poses[-1]
    robot.drive(1, off=3.0)
    assert robot.poses[-1].pose.x == pytest.approx(before.pose.x, abs=1e-6)
    assert not robot.local[-1]


def test_scans_and_odometry_that_differ_bring_the_whole_map(robot: Robot) -> None:
    robot.drive(25)
    while not (robot.local[-1] and robot.local[-2]):
        robot.drive(1)
    moved = ScanMotion(
        timestamp=stamp(round((99.9 + PERIOD * robot.scans) * 1e9)),
        since=stamp(round((99.7 + PERIOD * robot.scans) * 1e9)),
    )
    moved.motion.x = 0.25
    list(robot.core.handle(Envelope(SCAN_MOTION, {"site": "s", "robot": "r", "lidar": "front"}, moved)))
    robot.drive(1)
    assert not robot.local[-1]


def test_a_relocation_brings_the_whole_map(robot: Robot) -> None:
    robot.drive(25)
    list(robot.core.handle(Envelope(RELOCATION, {"site": "s", "robot": "r"}, Relocation())))
    robot.drive(1)
    assert not robot.local[-1]


def test_two_projectors_of_one_lidar_search_their_shares(robot: Robot) -> None:
    for scan in range(20):
        time = PERIOD * scan
        robot.receive(robot.speaker.odometry(100.0 + time, np.zeros(3)))
        for projector in ("0", "1"):
            robot.receive(robot.speaker.hypotheses(100.0 + time, [START], [25.0], projector=projector))
    assert robot.poses[-1].state == STATE_LOCALIZED
    assert not any(robot.local[3:])


def test_no_odometry_no_velocity_no_local_fit(make_core: MakeCore, speaker: Speaker) -> None:
    robot = Robot(make_core(local_fits=True), speaker)
    for scan in range(40):
        robot.receive(speaker.hypotheses(100.0 + PERIOD * scan, [START], [25.0]))
    assert robot.asked
    assert not any(robot.local)
