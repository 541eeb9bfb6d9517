from __future__ import annotations

import bz2
import gzip
import math
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.pose import compose, from_message, from_pose3
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.logs import LogError, LogOptions, carmen, open_log
from eigenscan.workbench.logs.carmen_lines import Line, LineError, guess_geometry, read_line
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from hypothesis import given
from hypothesis import strategies as st

RANGES = [1.0, 2.0, 3.0]


def words(*values: object) -> str:
    return " ".join(map(str, values))


def flaser(
    t: float, robot: tuple[float, float, float] = (0, 0, 0), ahead: float = 0.0, kind: str = "FLASER"
) -> str:
    x, y, theta = robot
    laser = (x + ahead * math.cos(theta), y + ahead * math.sin(theta), theta)
    return words(kind, len(RANGES), *RANGES, *laser, *robot, f"{t:.6f}", "host", f"{t:.6f}")


def robotlaser(
    t: float, robot: tuple[float, float, float], mount: tuple[float, float, float], number: int = 1
) -> str:
    laser = compose(np.array(robot), np.array(mount)).tolist()
    head = words(f"ROBOTLASER{number}", 0, -1.5, 3.0, 0.5, 30.0, 0.01, 0, len(RANGES), *RANGES, 2, 7, 8)
    return words(head, *laser, *robot, 0.1, 0.2, 0, 0, 0, f"{t:.6f}", "host", f"{t:.6f}")


def rawlaser(t: float, number: int = 1) -> str:
    head = words(f"RAWLASER{number}", 0, -1.5, 3.0, 0.5, 30.0, 0.01, 0, len(RANGES), *RANGES, 0)
    return words(head, f"{t:.6f}", "host", f"{t:.6f}")


def odom(t: float, x: float = 0.0) -> str:
    return words("ODOM", x, 0, 0, 0.1, 0, 0, f"{t:.6f}", "host", f"{t:.6f}")


def read(path: Path, **options: object) -> tuple[list[RawScan], list[Odometry], dict[str, int]]:
    log = open_log(path, LogOptions(**options))  # type: ignore[arg-type]
    received = list(log.envelopes())
    stamps = [envelope.stamp for envelope in received]
    assert stamps == sorted(stamps)
    assert log.progress == 1.0
    counters = {name: count for name, count in log.counters.items() if count}
    scans = [e.open(RawScan) for e in received if e.channel is SCAN_RAW]
    return scans, [e.open(Odometry) for e in received if e.channel is ODOMETRY], counters


def write(path: Path, *lines: str, end: str = "\n") -> Path:
    path.write_text("\n".join(["# a log", *lines]) + end)
    return path


def test_flaser_gives_a_scan_and_odometry_of_its_stamp(tmp_path: Path) -> None:
    log = write(tmp_path / "a.log", flaser(976052857.337530, (1, 2, 0.5), -0.04))
    (scan,), (moved,), counters = read(log, robot="r17", site="lab")
    assert scan.timestamp.ToNanoseconds() == moved.timestamp.ToNanoseconds() == 976052857337530000
    np.testing.assert_allclose(from_message(scan.mount), [-0.04, 0, 0], atol=1e-12)
    np.testing.assert_allclose(from_pose3(moved.pose), [1, 2, 0.5], atol=1e-12)
    assert list(scan.ranges) == RANGES
    assert counters == {}
    (first, second) = open_log(log, LogOptions(robot="r17", site="lab")).envelopes()
    assert (first.key, second.key) == ("lab/robot/r17/odom", "lab/robot/r17/scan/raw/front")


def test_robotlaser_shows_its_own_directions_limit_and_mount(tmp_path: Path) -> None:
    mount = (0.2, -0.1, 3.0)
    log = write(tmp_path / "a.log", *(robotlaser(t, (t, 1, -3.0), mount) for t in range(1, 5)))
    scans, moved, _ = read(log)
    assert len(scans) == len(moved) == 4
    scan = scans[0]
    np.testing.assert_allclose(from_message(scan.mount), mount, atol=1e-9)
    assert (scan.angle_min, scan.angle_increment, scan.range_max) == (-1.5, 0.5, 30.0)
    assert [round(m.pose.position.x) for m in moved] == [1, 2, 3, 4]


def test_several_lidars_have_names_and_one_kind_each(tmp_path: Path) -> None:
    lines = []
    for t in (1.0, 2.0):
        lines += [
            rawlaser(t, 3),
            rawlaser(t),
            robotlaser(t + 0.1, (0, 0, 0), (0, 0, 0)),
            flaser(t + 0.2, kind="RLASER"),
        ]
    log = open_log(write(tmp_path / "a.log", *lines))
    names = [e.address["lidar"] for e in log.envelopes() if e.channel is SCAN_RAW]
    assert names == ["laser3", "front", "rear"] * 2
    assert log.counters["scans_of_another_lidar_or_kind"] == 2
    scans, _, _ = read(tmp_path / "a.log", lidars=("laser3",))
    assert len(scans) == 2


def test_a_corrected_log_does_not_pass_off_its_correction_as_a_mount(tmp_path: Path) -> None:
    """There x y theta is a pose from SLAM, in another frame than odometry: the parameters show the mount."""
    lines = ["PARAM robot_frontlaser_offset 0.3 1 host 1"]
    for t in range(1, 9):
        corrected = words(t * 0.9, t * 0.1, 0.01 * t)
        lines.append(words("FLASER", 3, *RANGES, corrected, t, 0, 0, f"{t:.6f}", "host", t))
    scans, _, _ = read(write(tmp_path / "a.log", *lines))
    np.testing.assert_allclose(from_message(scans[0].mount), [0.3, 0, 0])


@pytest.mark.parametrize("pack", [None, gzip.compress, bz2.compress])
def test_a_log_that_ends_in_mid_line_gives_what_is_whole(tmp_path: Path, pack: object) -> None:
    whole = "\n".join([odom(1.0), flaser(2.0), flaser(3.0)]).encode()
    for cut in range(len(" host 3.000000"), len(flaser(3.0)) + 1):
        data = whole[:-cut]
        path = tmp_path / "cut.log"
        path.write_bytes(pack(data) if callable(pack) else data)
        scans, moved, counters = read(path)
        assert len(scans) == 1
        assert len(moved) == 2
        # cut to its first word it is the name of something unknown
        assert counters in ({"cut_line": 1}, {"garbage_line": 1}, {})


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress])
def test_an_archive_that_was_cut_gives_what_is_whole(tmp_path: Path, pack: object) -> None:
    rng = np.random.default_rng(0)
    lines = [
        words("FLASER", 180, *rng.uniform(1, 9, 180).round(3), 0, 0, 0, 0, 0, 0, f"{t:.6f}", "host", t)
        for t in range(1, 1500)
    ]
    data = pack("\n".join(lines).encode())  # type: ignore[operator]
    (tmp_path / "cut.log").write_bytes(data[: 9 * len(data) // 10])
    scans, _, counters = read(tmp_path / "cut.log")
    assert 300 < len(scans) < 1499
    assert counters.pop("truncated_file") == 1
    assert counters in ({}, {"cut_line": 1}, {"garbage_line": 1})


def test_garbage_is_counted_and_left_out(tmp_path: Path) -> None:
    lines = [
        flaser(1.0),
        "FLASER 3 1.0 2.0",
        "FLASER many 1 2 3 0 0 0 0 0 0 1 host 1",
        "FLASER -3 1 2 3 0 0 0 0 0 0 1 host 1",
        flaser(2.0).replace(" 2.0 ", " two "),
        "\x00\xff\x01 binary",
        odom(3.0).replace("3.000000", "-3.0"),
        odom(4.0).replace("ODOM 0.0", "ODOM nan"),
        "NMEA-GGA 1 2 3",
        "SYNC here 5.0 host 5.0",
        flaser(6.0),
    ]
    scans, moved, counters = read(write(tmp_path / "a.log", *lines))
    assert len(scans) == 2
    assert len(moved) == 3
    assert counters == {"cut_line": 1, "garbage_line": 4, "absurd_stamp": 1, "odometry_not_finite": 1}


def test_odometry_of_one_stamp_is_published_once(tmp_path: Path) -> None:
    lines = [odom(1.0), flaser(1.5), odom(1.5), odom(2.0)]
    scans, moved, counters = read(write(tmp_path / "a.log", *lines))
    assert (len(scans), len(moved)) == (1, 3)
    assert counters == {"odometry_duplicate_stamp": 1}


def test_stamps_that_jump_are_repaired_and_remembered(tmp_path: Path) -> None:
    log = open_log(write(tmp_path / "a.log", *(flaser(t) for t in (1, 2, 7, 4, 5))))
    stamps = [e.stamp / 1e9 for e in log.envelopes() if e.channel is SCAN_RAW]
    assert stamps == [1, 2, 3, 4, 5]
    assert log.logged == {3_000_000_000: 7_000_000_000}
    assert log.counters["stamps_repaired"] == 1


def test_stamps_in_six_digits_of_an_epoch_give_no_time(tmp_path: Path) -> None:
    """As programs that correct a log print it: the same for hours, or one step of hours; no scan is lost."""
    stamps = ["1.13486e+09", "1.13486e+09", "0"] * 10 + ["1.13487e+09", "1.13487e+09", "0"] * 10
    lines = [
        line
        for number, stamp in enumerate(stamps)
        for line in (
            words("FLASER", 3, *RANGES, number, 0, 0, number, 0, 0, stamp, "host", stamp),
            words("ODOM", number + 0.5, 0, 0, 0, 0, 0, stamp, "host", stamp),
        )
    ]
    scans, moved, counters = read(write(tmp_path / "a.log", *lines))
    assert len(scans) == len(stamps)
    assert [m.pose.position.x for m in moved] == [0.5 * half for half in range(2 * len(stamps))]
    seconds = [scan.timestamp.ToNanoseconds() / 1e9 for scan in scans]
    assert seconds[-1] - seconds[0] < 60
    assert set(counters) == {"stamps_repaired"}


@pytest.mark.parametrize("content", ["", "# nothing\n", "hello\n", "\x00" * 100])
def test_what_is_no_log_is_refused_by_name(tmp_path: Path, content: str) -> None:
    path = tmp_path / "no.log"
    path.write_text(content)
    with pytest.raises(LogError, match=r"no\.log: is (empty|of no known format): give a CARMEN log"):
        open_log(path)


def test_a_marker_for_no_return_is_found_in_the_ranges(tmp_path: Path) -> None:
    """A laser in another mode than the usual one marks what does not come back by 8.191 m."""
    rng = np.random.default_rng(0)
    lines, plain = [], []
    hall = np.minimum(1.5 / np.maximum(np.abs(np.sin(np.radians(np.arange(-90, 90)))), 1e-9), 8.0)
    for t in range(1, 400):
        ranges = (hall + rng.normal(0, 0.002, 180)).clip(0.1, 8.18).round(3)
        plain.append(words("FLASER", 180, *ranges, 0, 0, 0, 0, 0, 0, f"{t:.6f}", "host", t))
        ranges[rng.random(180) < 0.03] = 8.191
        lines.append(words("FLASER", 180, *ranges, 0, 0, 0, 0, 0, 0, f"{t:.6f}", "host", t))
    marked, _, _ = read(write(tmp_path / "a.log", *lines))
    assert marked[0].range_max == pytest.approx(8.191)
    unmarked, _, _ = read(write(tmp_path / "b.log", *plain))
    assert unmarked[0].range_max == pytest.approx(81.83)


@pytest.mark.parametrize("markers", [(51.06, 51.06, 51.06, 51.11, 51.16), (32.763, 32.767)])
def test_markers_that_scatter_are_found_in_a_short_log(tmp_path: Path, markers: tuple[float, ...]) -> None:
    """One beam in a hundred comes back empty, in 200 scans with odometry between; no marker is a wall."""
    rng = np.random.default_rng(3)
    lines = []
    for number in range(200):
        ranges = rng.uniform(1.0, 20.0, 180)
        ranges[rng.integers(0, 180, 2)] = rng.choice(markers, 2)
        lines.append(words("FLASER", 180, *ranges.round(3), 0, 0, 0, 0, 0, 0, number, "host", number))
        lines += [odom(number + 0.2 * part) for part in (1, 2, 3, 4)]
    scans, _, _ = read(write(tmp_path / "a.log", *lines))
    assert {scan.range_max for scan in scans} == {min(markers)}


def test_a_lidar_that_is_not_there_is_named(tmp_path: Path) -> None:
    log = open_log(write(tmp_path / "a.log", flaser(1.0)), LogOptions(lidars=("rear",)))
    with pytest.raises(LogError, match=r"a\.log: no lidar rear: choose one of front"):
        list(log.envelopes())


def test_a_log_without_scans_is_refused(tmp_path: Path) -> None:
    log = open_log(write(tmp_path / "a.log", odom(1.0)))
    with pytest.raises(LogError, match=r"a\.log: no scan line could be read"):
        list(log.envelopes())


@pytest.mark.parametrize(
    ("count", "first", "last"),
    [(181, -90, 90), (361, -90, 90), (180, -90, 89), (360, -90, 89.5), (401, -50, 50), (1081, -135, 135)],
)
def test_the_number_of_beams_shows_the_laser(count: int, first: float, last: float) -> None:
    geometry = guess_geometry(count)
    assert math.degrees(geometry.angle_min) == pytest.approx(first)
    assert math.degrees(geometry.angle_min + (count - 1) * geometry.angle_increment) == pytest.approx(last)


@given(st.text(st.sampled_from("FLASERODMPRW123 .-+einf#\x00\n"), max_size=200))
def test_no_line_breaks_the_reader(text: str) -> None:
    for line in (text, "FLASER " + text, "ROBOTLASER1 " + text, "RAWLASER2 " + text, "ODOM " + text):
        with suppress(LineError):
            read_line(line)


@given(
    cut=st.integers(0, 200),
    swap=st.integers(0, 20),
    junk=st.sampled_from(["", "x", "nan", "1e999", "-1", "\x00"]),
)
def test_a_damaged_line_is_read_or_counted(cut: int, swap: int, junk: str) -> None:
    for whole in (flaser(1.0), robotlaser(1.0, (0, 0, 0), (0, 0, 0)), rawlaser(1.0), odom(1.0)):
        parts = whole.split()
        parts[swap % len(parts)] = junk
        for damaged in (" ".join(parts), whole[:cut]):
            with suppress(LineError):
                line = read_line(damaged)
                if line is not None and line.geometry is not None:
                    assert len(line.ranges()) == len(RANGES)


def test_of_lines_that_cannot_be_read_each_is_looked_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fuzzing: of 177,000 lines in 0.5 MB of gzip most were garbage, and the log took 1.3 s."""
    looked_at = Counter[str]()

    def look(text: str) -> Line | None:
        looked_at[text] += 1
        return read_line(text)

    monkeypatch.setattr(carmen, "read_line", look)
    path = tmp_path / "log.clf"
    good = "FLASER 2 1.0 2.5 1 2 0.5 1 2 0.5 10.0 host 10.0"
    path.write_text(f"R.200\n# comment\n{good}\n{good[:30]}\n")
    log = open_log(path)
    assert len(list(log.envelopes())) == 2
    assert looked_at == {"R.200": 1, "# comment": 1, good: 2, good[:30]: 1}
