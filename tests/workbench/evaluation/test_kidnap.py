import numpy as np
import pytest
from eigenscan.geometry.pose import between, from_pose3, to_pose3
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.evaluation.kidnap import outcome, plan, splice
from eigenscan.workbench.evaluation.metrics import Stream
from eigenscan.workbench.evaluation.reference import NS, Trajectory
from eigenscan.workbench.evaluation.windows import Window
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

PERIOD = NS // 10


def line(seconds: float) -> Trajectory:
    """Along x at 1 m/s."""
    stamps = np.arange(round(seconds * 10) + 1) * PERIOD
    poses = np.zeros((len(stamps), 3))
    poses[:, 0] = stamps / NS
    return Trajectory(stamps, poses)


def log(start: int, count: int, odometry: bool = True) -> list[Envelope]:
    rng = np.random.default_rng(start)
    received = []
    for index in range(count):
        time = stamp(start + index * PERIOD)
        if odometry:
            pose = to_pose3(rng.uniform(-3, 3, 3))
            received.append(
                Envelope(ODOMETRY, {"site": "s", "robot": "r"}, Odometry(timestamp=time, pose=pose))
            )
        scan = RawScan(timestamp=time, ranges=[1.0, 2.0])
        received.append(Envelope(SCAN_RAW, {"site": "s", "robot": "r", "lidar": "l"}, scan))
    return received


def stream(stamps: np.ndarray, poses: np.ndarray, localized: list[bool]) -> Stream:
    n = len(stamps)
    return Stream(
        stamps=stamps,
        poses=poses,
        states=np.where(localized, 3, 1),
        localized=np.asarray(localized),
        tracked=np.ones(n, dtype=np.bool_),
        confidence=np.ones(n),
        covariances=np.zeros((n, 3, 3)),
        nis=np.full(n, np.nan),
        cpu_s=np.zeros(n),
        scans=np.arange(n),
    )


def test_a_jump_leads_to_a_window_that_starts_elsewhere() -> None:
    windows = [Window(k * NS, (k + 4) * NS) for k in range(0, 20, 2)]
    plans = plan(windows, line(30.0))
    assert len(plans) == len(windows)
    for window, planned in zip(windows, plans, strict=True):
        assert planned.before == Window(window.start, window.start + 2 * NS)
        assert planned.after in windows
        assert abs(planned.after.start - planned.before.end) >= 3 * NS


def test_a_robot_that_never_leaves_its_place_cannot_be_kidnapped() -> None:
    path = line(0.5)
    assert plan([Window(0, NS // 4), Window(NS // 4, NS // 2)], path) == []


def test_time_and_odometry_go_on_over_the_jump() -> None:
    before, after = log(0, 20), log(500 * NS, 30)
    joined = splice(before, after)
    stamps = [nanoseconds(e.open(RawScan).timestamp) for e in joined.received if e.channel == SCAN_RAW]
    np.testing.assert_array_equal(np.diff(stamps), PERIOD)
    assert joined.jump == 20 * PERIOD
    assert joined.moved == 20 * PERIOD - 500 * NS
    poses = [from_pose3(e.open(Odometry).pose) for e in joined.received if e.channel == ODOMETRY]
    np.testing.assert_allclose(poses[20], poses[19], atol=1e-9)
    original = [from_pose3(e.open(Odometry).pose) for e in after if e.channel == ODOMETRY]
    for index in range(20, 49):
        np.testing.assert_allclose(
            between(poses[index], poses[index + 1]),
            between(original[index - 20], original[index - 19]),
            atol=1e-9,
        )
    # what was given is left as it was
    assert nanoseconds(after[0].open(Odometry).timestamp) == 500 * NS


def test_a_log_without_odometry_is_joined_as_well() -> None:
    joined = splice(log(0, 5, odometry=False), log(70 * NS, 5, odometry=False))
    assert len(joined.received) == 10


def test_what_was_noticed_and_when_it_was_found() -> None:
    # 1 s in the first place, then at 10 s of the reference: old place claimed for 0.3 s, lost, then right
    path = line(30.0)
    joined = splice(log(0, 10), log(10 * NS, 20))
    stamps = np.array(
        [nanoseconds(e.open(RawScan).timestamp) for e in joined.received if e.channel == SCAN_RAW]
    )
    truth = np.concatenate([np.arange(10) * 0.1, 10 + np.arange(20) * 0.1])
    poses = np.zeros((30, 3))
    poses[:, 0] = truth
    poses[10:13, 0] = 1.0
    claims = [True] * 13 + [False] * 2 + [True] + [False] * 2 + [True] * 12
    found = outcome(stream(stamps, poses, claims), joined, path)
    assert found.claimed_before
    assert found.noticed_s == pytest.approx(0.3)
    assert found.recovered_s == pytest.approx(0.8)
    assert found.first_right_s == pytest.approx(0.5)
    assert found.false_after_s == pytest.approx(0.3)


def test_a_kidnap_that_nobody_noticed() -> None:
    path = line(30.0)
    joined = splice(log(0, 10), log(10 * NS, 20))
    stamps = np.array(
        [nanoseconds(e.open(RawScan).timestamp) for e in joined.received if e.channel == SCAN_RAW]
    )
    poses = np.zeros((30, 3))
    poses[:, 0] = np.arange(30) * 0.1
    found = outcome(stream(stamps, poses, [True] * 30), joined, path)
    assert (found.claimed_before, found.noticed_s, found.recovered_s) == (True, None, None)
    assert found.first_right_s is None
