import gc
from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.pose import compose, covariance_to_message, inverse, to_message
from eigenscan.mapbuilder.keeping.change import Change
from eigenscan.mapbuilder.keeping.change_detector import ChangeDetector
from eigenscan.mapbuilder.keeping.evidence import Evidence
from eigenscan.mapbuilder.keeping.trusted_observer import TrustedObserver
from eigenscan.mapbuilder.keeping.view import View
from eigenscan.schemas.channels import POSE, SCAN
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, STATE_LOST, PoseEstimate, State
from scipy.ndimage import binary_dilation

from tests.services.mapbuilder.keeping.patrol import KNOWN, MOVED, VISIT_S, Patrol, apart

# written out, not taken from what is tested: a change there must show here
PROBATION, LEAST_RECORD = 10, 25

RANGES = np.full(90, 2.0)
SECOND = 1_000_000_000
AGREED = 1.0


def scan(time: int, ranges: np.ndarray = RANGES) -> Scan:
    message = Scan(timestamp=stamp(time), angle_min=-0.7, angle_increment=0.016, range_max=30.0)
    message.ranges.extend(ranges)
    return message


def claim(
    time: int,
    base: np.ndarray,
    odometry: np.ndarray | None = None,
    sigma: float = 0.03,
    state: State = STATE_LOCALIZED,
    confidence: float = 0.98,
) -> PoseEstimate:
    message = PoseEstimate(
        timestamp=stamp(time),
        pose=to_message(base),
        covariance=covariance_to_message(np.diag([sigma**2, sigma**2, sigma**2])),
        state=state,
        confidence=confidence,
    )
    if odometry is not None:
        message.has_odometry = True
        message.map_to_odom.CopyFrom(to_message(compose(base, inverse(odometry))))
    return message


def straight(count: int, step: float = 0.25) -> np.ndarray:
    """Poses (count, 3) along x."""
    return np.column_stack([np.arange(count) * step, np.zeros(count), np.zeros(count)])


def listen(
    observer: TrustedObserver, poses: np.ndarray, judge: float = AGREED, first: int = 0, **claimed: Any
) -> list[View]:
    """What counts of a drive over `poses`, twice a second."""
    views = []
    for k, pose in enumerate(poses, first):
        views += observer.add_scan(scan(k * SECOND // 2), lambda _: judge)
        views += observer.add_pose(claim(k * SECOND // 2, pose, **claimed), lambda _: judge)
    return views


def test_a_look_counts_once_ten_others_bear_it_out() -> None:
    views = listen(TrustedObserver(Counter()), straight(LEAST_RECORD + 5))
    assert [view.stamp for view in views] == [k * SECOND // 2 for k in range(LEAST_RECORD + 5 - PROBATION)]


def test_a_robot_that_stands_sees_one_look() -> None:
    counts = Counter[str]()
    observer = TrustedObserver(counts)
    views = listen(observer, np.zeros((1200, 3)))
    views += listen(observer, straight(40)[1:], first=1200)
    assert sum(view.pose[0] == 0.0 for view in views) == 1


def test_scans_and_poses_meet_in_whatever_order_they_come() -> None:
    poses, one, other = straight(30), [], []
    observer = TrustedObserver(Counter())
    for k, pose in enumerate(poses):
        one += observer.add_scan(scan(k * SECOND), lambda _: AGREED)
        one += observer.add_pose(claim(k * SECOND, pose), lambda _: AGREED)
    observer = TrustedObserver(Counter())
    for k, pose in enumerate(poses):
        other += observer.add_pose(claim(k * SECOND, pose), lambda _: AGREED)
        other += observer.add_scan(scan(k * SECOND), lambda _: AGREED)
    assert len(one) == 20
    assert [view.stamp for view in one] == [view.stamp for view in other]


@pytest.mark.parametrize(
    "unsure",
    [
        {"state": STATE_AMBIGUOUS},
        {"state": STATE_LOST},
        {"confidence": 0.8},
        {"confidence": float("nan")},
        {"sigma": 0.0},
        {"sigma": 0.2},
        {"sigma": float("nan")},
    ],
)
def test_a_robot_that_is_not_sure_is_no_trusted_observer(unsure: dict[str, Any]) -> None:
    assert listen(TrustedObserver(Counter()), straight(60), **unsure) == []


def test_numbers_that_make_no_sense_are_set_aside() -> None:
    counts = Counter[str]()
    observer = TrustedObserver(counts)
    poses = straight(60)
    poses[5:10, 0] = np.nan
    for k, pose in enumerate(poses):
        ranges = RANGES * (np.nan if k % 4 == 0 else 1.0)
        observer.add_scan(scan(k * SECOND // 2, ranges), lambda _: AGREED)
        observer.add_pose(claim(k * SECOND // 2, pose), lambda _: AGREED)
    assert counts["poses_malformed"] == 5
    assert counts["looks_unusable"] >= 8
    assert counts["looks_counted"] >= 10


def test_a_robot_that_disagrees_with_the_map_is_no_trusted_observer() -> None:
    counts = Counter[str]()
    assert listen(TrustedObserver(counts), straight(80), judge=0.5) == []
    assert counts["looks_withdrawn"] == 80


def test_who_turns_out_to_have_been_elsewhere_takes_his_last_looks_back() -> None:
    counts = Counter[str]()
    observer = TrustedObserver(counts)
    before = listen(observer, straight(30))
    far = straight(60) + np.array([40.0, 9.0, 0.0])
    after = listen(observer, far, first=30)
    assert len(before) == 20
    assert counts["looks_withdrawn"] == 10
    assert all(view.pose[1] == 9.0 for view in after)


def test_a_short_error_is_bridged_by_odometry() -> None:
    """Ten seconds of sure claims in the room next door, and the robot was never there."""
    counts = Counter[str]()
    observer, truth = TrustedObserver(counts), straight(60, 0.22)
    odometry = compose(np.array([3.0, -2.0, 1.1]), truth)
    views = []
    for k, base in enumerate(truth):
        published = base + np.array([5.0, 3.0, 0.0]) if 20 <= k < 40 else base
        views += observer.add_scan(scan(k * SECOND // 2), lambda _: AGREED)
        views += observer.add_pose(claim(k * SECOND // 2, published, odometry[k]), lambda _: AGREED)
    assert counts["looks_bridged"] == 20
    assert len(views) == 50
    assert max(apart(view.pose, truth[2 * view.stamp // SECOND]) for view in views) < 1e-6


def test_what_was_seen_on_too_long_a_way_is_not_bridged() -> None:
    counts = Counter[str]()
    observer, truth = TrustedObserver(counts), straight(60, 0.25)
    for k, base in enumerate(truth):
        state = STATE_LOST if 10 <= k < 40 else STATE_LOCALIZED
        observer.add_scan(scan(k * SECOND // 2), lambda _: AGREED)
        observer.add_pose(claim(k * SECOND // 2, base, base, state=state), lambda _: AGREED)
    assert counts["looks_bridged"] == 0
    assert counts["looks_unsure"] >= 20


def change_after(
    patrols: Iterable[Patrol], grid: GridMap, every_s: float = VISIT_S, detector: ChangeDetector | None = None
) -> tuple[Change | None, ChangeDetector]:
    """What a detector of the known map finds, and the detector."""
    detector = detector or ChangeDetector(KNOWN, Evidence.of(KNOWN, VISIT_S), 4)
    change = None
    for k, patrol in enumerate(patrols):
        for received in patrol.messages(grid, k * every_s):
            if received.channel in (SCAN, POSE):
                found = detector.receive(received)
                change = change if found is None else found
    return change, detector


def test_a_moved_cupboard_is_found_in_the_fifth_pass() -> None:
    change, _ = change_after([Patrol(seed) for seed in range(5)], MOVED)
    assert change
    places = [(place.is_new, place.centre) for place in change.places()]
    old, new = (9.175, 11.0), (8.95, 8.6)
    assert any(not is_new and np.hypot(*np.subtract(centre, old)) < 0.8 for is_new, centre in places)
    assert any(is_new and np.hypot(*np.subtract(centre, new)) < 1.0 for is_new, centre in places)
    assert len(places) <= 3
    gone = (KNOWN.cells == OCCUPIED) & (MOVED.cells == FREE)
    assert (change.gone & gone).sum() > 0.8 * gone.sum()
    assert not (change.gone & ~binary_dilation(gone, iterations=3)).any()


def test_a_person_who_stands_for_an_hour_is_no_change() -> None:
    """Robots come by every quarter of an hour, and the last comes late to end the last visit."""
    standing = ((7.2, 10.4), (3.0, 6.0))
    detector = ChangeDetector(KNOWN, Evidence.of(KNOWN, VISIT_S), 4)
    for k in range(7):
        patrol = Patrol(k, standing=standing if 1 <= k <= 5 else ())
        for received in patrol.messages(KNOWN, k * 900.0 + (3600.0 if k == 6 else 0.0)):
            assert not detector.receive(received)
        if k == 5:
            assert detector.counts["looks_counted"] > 500


def test_lidars_that_fell_silent_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eigenscan.schemas.recently_used.AMONG", 10)
    detector = ChangeDetector(KNOWN, Evidence.of(KNOWN, VISIT_S), 4)
    for number in range(100):
        address = {"site": "s", "robot": "r1", "lidar": f"front{number}"}
        detector.receive(Envelope(SCAN, address, scan(number * SECOND)))
    kept = [each for each in gc.get_objects() if isinstance(each, TrustedObserver)]
    assert sum(each._counts is detector.counts for each in kept) <= 11


def test_crowds_that_walk_are_no_change() -> None:
    patrols = [Patrol(k, people=12, goals=()) for k in range(6)]
    change, detector = change_after(patrols, KNOWN)
    assert change is not None
    assert not change
    assert np.count_nonzero(np.abs(detector.evidence.run) >= 4) > 1000


@pytest.mark.parametrize("off", [(0.4, -0.3, 0.35), (-0.6, 0.0, 0.0), (7.0, 2.0, np.pi)])
def test_robots_that_claim_wrong_poses_corrupt_nothing(off: tuple[float, float, float]) -> None:
    change, detector = change_after([Patrol(k, off=off) for k in range(5)], KNOWN)
    assert not change
    set_aside = detector.counts["looks_disagreeing"] + detector.counts["looks_withdrawn"]
    assert set_aside > 200
    assert detector.counts["looks_counted"] <= 0.02 * set_aside


def test_a_wrong_robot_among_right_ones_neither_hides_nor_makes_a_change() -> None:
    detector = ChangeDetector(KNOWN, Evidence.of(KNOWN, VISIT_S), 4)
    found = None
    for k in range(5):
        liar, honest = Patrol(50 + k, seconds=30.0, off=(0.0, -5.0, 0.0)), Patrol(k)
        for received in liar.messages(MOVED, k * VISIT_S + 200.0, robot="liar"):
            found = detector.receive(received) or found
        for received in honest.messages(MOVED, k * VISIT_S + 400.0):
            found = detector.receive(received) or found
    assert found
    gone = (KNOWN.cells == OCCUPIED) & (MOVED.cells == FREE)
    assert not (found.gone & ~binary_dilation(gone, iterations=3)).any()
