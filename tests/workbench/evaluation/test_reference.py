from pathlib import Path

import numpy as np
import pytest
from eigenscan.workbench.evaluation.reference import NS, EvaluationError, Trajectory, read_trajectory
from eigenscan.workbench.evaluation.windows import Window, plan_scans, plan_windows, read_times, read_windows
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation


def trajectory(rows: list[tuple[float, float, float, float]]) -> Trajectory:
    table = np.asarray(rows)
    return Trajectory(np.round(table[:, 0] * NS).astype(np.int64), table[:, 1:].copy())


def straight(seconds: float, speed: float, rate_hz: float = 10.0) -> Trajectory:
    times = np.arange(0.0, seconds + 1e-9, 1 / rate_hz)
    return trajectory([(t, speed * t, 0.0, 0.0) for t in times])


@given(
    a=st.floats(-3.1, 3.1),
    turn=st.floats(-3.0, 3.0),
    part=st.floats(0.0, 1.0),
)
def test_between_two_poses_it_goes_straight_and_takes_the_shorter_turn(
    a: float, turn: float, part: float
) -> None:
    path = trajectory([(10.0, 1.0, 2.0, a), (10.5, 3.0, -2.0, a + turn)])
    poses, known = path.at([round((10.0 + 0.5 * part) * NS)])
    assert known.all()
    np.testing.assert_allclose(poses[0, :2], [1 + 2 * part, 2 - 4 * part], atol=1e-6)
    expected = a + part * turn
    assert abs(np.exp(1j * poses[0, 2]) - np.exp(1j * expected)) < 1e-6
    assert -np.pi <= poses[0, 2] < np.pi


def test_its_own_stamps_give_its_own_poses() -> None:
    rng = np.random.default_rng(3)
    path = trajectory([(t, *rng.uniform(-3, 3, 3)) for t in np.cumsum(rng.uniform(0.01, 3.0, 50))])
    poses, known = path.at(path.stamps)
    assert known.all()
    np.testing.assert_allclose(poses, path.poses, atol=1e-12)


def test_nothing_is_known_in_a_gap_unless_the_robot_stood_still() -> None:
    path = trajectory(
        [(0, 0, 0, 0), (1, 0, 0, 0), (5, 4, 0, 0), (9, 4.01, 0, 0.01), (9.5, 4, 0, 1.0), (12, 4, 0, 0)]
    )
    times = [0.5, 2.0, 5.0, 7.0, 10.0, 12.0, 12.02, 12.2, -0.02, -1.0]
    _, known = path.at([round(t * NS) for t in times])
    assert known.tolist() == [True, False, True, True, False, True, True, False, True, False]


def test_a_single_pose_is_a_trajectory() -> None:
    poses, known = trajectory([(4.0, 1.0, 2.0, 0.5)]).at([4 * NS, 5 * NS])
    assert known.tolist() == [True, False]
    np.testing.assert_allclose(poses[0], [1.0, 2.0, 0.5])


def test_jitter_of_a_standing_robot_is_no_way() -> None:
    rng = np.random.default_rng(0)
    standing = trajectory([(t / 10, *rng.normal(0, 0.002, 2), 0.0) for t in range(1000)])
    assert standing.travelled(standing.stamps[-1:])[0] == 0.0
    driving = straight(100.0, 0.5)
    assert driving.travelled(driving.stamps[-1:])[0] == pytest.approx(50.0, abs=0.1)


@given(roll=st.floats(-0.2, 0.2), yaw=st.floats(-3.1, 3.1), scale=st.floats(0.5, 2.0))
def test_tum_headings_are_the_yaw_of_the_rotation(
    tmp_path_factory: pytest.TempPathFactory, roll: float, yaw: float, scale: float
) -> None:
    file = tmp_path_factory.mktemp("tum") / "a.tum"
    q = Rotation.from_euler("ZX", [yaw, roll]).as_quat() * scale
    numbers = " ".join(f"{float(v)!r}" for v in q)
    file.write_text(f"# comment\n\n1411657682.042859 1 2 3 {numbers}\n")
    read = read_trajectory(file)
    assert read.stamps.tolist() == [1411657682042859000]
    np.testing.assert_allclose(read.poses, [[1, 2, yaw]], atol=1e-9)


def test_tum_rows_are_put_in_order_and_shifted(tmp_path: Path) -> None:
    file = tmp_path / "a.tum"
    file.write_text("2 2 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n2 9 0 0 0 0 0 1\n")
    read = read_trajectory(file, offset_s=-0.5)
    assert read.stamps.tolist() == [NS // 2, 3 * NS // 2]
    assert read.poses[:, 0].tolist() == [1, 2]


@pytest.mark.parametrize(
    "line",
    [
        "1 2 3",
        "x 0 0 0 0 0 0 1",
        "1 nan 0 0 0 0 0 1",
        "1 0 nan 0 0 0 0 1",
        "nan 0 0 0 0 0 0 1",
        "1 0 0 0 0 0 0 0",
        "1 0 0 0 0 0 0 1 7",
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, line: str) -> None:
    file = tmp_path / "a.tum"
    file.write_text(f"1 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(EvaluationError, match=r"a\.tum: line 2"):
        read_trajectory(file)


def test_an_empty_or_missing_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.tum").write_text("# nothing\n")
    (tmp_path / "b.tum").write_bytes(b"\xff\xfe\x00")
    for name in ("a.tum", "b.tum", "c.tum"):
        with pytest.raises(EvaluationError, match=name.replace(".", r"\.")):
            read_trajectory(tmp_path / name)


def test_windows_are_read_by_column_name_or_by_order(tmp_path: Path) -> None:
    file = tmp_path / "w.csv"
    expected = [Window(1_000_000_000_123_456_000, 1_000_000_060_000_000_000)]
    file.write_text("name,end_time,start_time\na,1000000060,1000000000.123456\n")
    assert read_windows(file) == expected
    file.write_text("1000000000.123456, 1000000060\n\n")
    assert read_windows(file) == expected
    file.write_text("time\n1.5\n2.5\n")
    assert read_times(file, offset_s=1.0) == [2_500_000_000, 3_500_000_000]


@pytest.mark.parametrize(
    "text", ["start_time,end_time\n5,4\n", "start_time,end_time\n5\n", "start_time,end_time\na,b\n"]
)
def test_a_bad_window_is_named(tmp_path: Path, text: str) -> None:
    file = tmp_path / "w.csv"
    file.write_text(text)
    with pytest.raises(EvaluationError, match=r"w\.csv: line 2"):
        read_windows(file)


def test_windows_start_every_10_s_and_end_after_30_m_or_60_s() -> None:
    slow, fast = straight(100.0, 0.25), straight(100.0, 1.0)
    for path, length in ((slow, 60.0), (fast, 30.0)):
        windows = plan_windows(path.stamps, path)
        starts = [window.start / NS for window in windows]
        assert starts == [0, 10, 20, 30, 40, 50, 60, 70, 80, 90]
        for window in windows:
            assert (window.end - window.start) / NS == pytest.approx(
                min(length, 100 - window.start / NS), abs=0.2
            )


def test_windows_keep_to_where_scans_and_reference_are() -> None:
    reference = straight(50.0, 0.1)
    windows = plan_windows((np.arange(-1000, 3000) * NS // 10).astype(np.int64), reference)
    assert windows[0].start == pytest.approx(0, abs=NS // 10)
    assert windows[-1].end == pytest.approx(50 * NS, abs=NS // 10)
    assert plan_windows(np.arange(500, 600) * NS, reference) == []


def test_a_short_log_is_one_window() -> None:
    path = straight(6.0, 0.1)
    assert plan_windows(path.stamps, path) == [Window(0, 6 * NS)]


def test_single_scans_are_spread_over_what_can_be_judged() -> None:
    path = straight(50.0, 0.1)
    chosen = plan_scans((np.arange(-100, 1000) * NS // 10).astype(np.int64), path, count=11)
    assert [round(stamp / NS) for stamp in chosen] == [0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50]
    assert len(plan_scans(path.stamps[:7], path)) == 7
