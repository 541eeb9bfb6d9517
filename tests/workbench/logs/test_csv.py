"""CSV tables of ranges, a line a scan and a line a beam."""

import math
from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.pose import from_pose3
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.logs import LogError, LogOptions, Mount, open_log
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from hypothesis import given, settings
from hypothesis import strategies as st

RANGES = st.floats(0.125, 40.0, width=32)


def _scans(path: Path, options: LogOptions | None = None) -> list[RawScan]:
    envelopes = open_log(path, options).envelopes()
    return [envelope.open(RawScan) for envelope in envelopes if envelope.channel is SCAN_RAW]


@settings(deadline=None, max_examples=30)
@given(st.lists(st.lists(RANGES, min_size=5, max_size=5), min_size=1, max_size=4), st.booleans())
def test_a_line_a_scan(
    tmp_path_factory: pytest.TempPathFactory, scans: list[list[float]], millimetres: bool
) -> None:
    name, unit = ("range_mm", 1000.0) if millimetres else ("range_m", 1.0)
    rows: list[list[str | float]] = [
        ["time_s", "angle_min_deg", "angle_increment_deg", *(f"{name}_{j}" for j in range(5))]
    ]
    rows += [[0.1 * k, -90, 45, *(unit * r for r in ranges)] for k, ranges in enumerate(scans, 1)]
    path = tmp_path_factory.mktemp("csv") / "drive.csv"
    path.write_text("\n".join(",".join(map(repr, row)).replace("'", "") for row in rows))
    received = _scans(path)
    assert np.allclose([scan.ranges for scan in received], scans, rtol=1e-6)
    assert received[0].timestamp.ToNanoseconds() == 100_000_000
    assert math.isclose(received[0].angle_min, -math.pi / 2)
    assert math.isclose(received[0].angle_increment, math.pi / 4)


@settings(deadline=None, max_examples=50)
@given(count=st.integers(8, 200), clockwise=st.booleans(), seed=st.integers(0, 99))
def test_a_line_a_beam_stands_where_it_looked(
    tmp_path_factory: pytest.TempPathFactory, count: int, clockwise: bool, seed: int
) -> None:
    """Uneven angles, in any order: each range is found at the angle that it was measured at."""
    random = np.random.default_rng(seed)
    step = 360.0 / count
    angles = (np.arange(count) + random.uniform(-0.3, 0.3, count)) * step
    ranges = random.uniform(0.2, 12.0, count)
    name, turn = ("angle_cw_deg", -1) if clockwise else ("angle_deg", 1)
    path = tmp_path_factory.mktemp("csv") / "drive.csv"
    lines = [f"time_s,{name},range_mm,quality"]
    for j in random.permutation(count):
        lines.append(f"1.5,{float(angles[j] * turn)},{float(1000 * ranges[j])},{0 if j == 3 else 47}")
    path.write_text("\n".join(lines))
    (scan,) = _scans(path)
    seen = np.asarray(scan.ranges)
    assert len(seen) == count
    directions = scan.angle_min + scan.angle_increment * np.arange(len(seen))
    for j in range(count):
        off = np.abs(wrap(directions - np.deg2rad(angles[j])))
        nearest = int(np.argmin(off))
        assert off[nearest] <= np.deg2rad(0.5 * step) + 1e-9
        if j != 3:
            assert math.isclose(seen[nearest], ranges[j], rel_tol=1e-6)
    assert np.isnan(seen).sum() == 1


@pytest.mark.parametrize(
    ("count", "first"), [(400, -179.55), (360, 0.5), (720, 0.25), (360, 0.0), (400, 0.449)]
)
@pytest.mark.parametrize("name", ["angle_deg", "angle_cw_deg"])
def test_even_beams_are_all_kept_wherever_the_first_one_looks(
    tmp_path: Path, count: int, first: float, name: str
) -> None:
    angles = [round((first + j * 360.0 / count) % 360.0, 2) for j in range(count)]
    lines = [f"time_s,{name},range_m"]
    lines += [f"{second},{angle},{1 + angle / 100}" for second in (1, 2) for angle in angles]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    for scan in _scans(tmp_path / "a.csv"):
        assert len(scan.ranges) == count
        directions = np.degrees(scan.angle_min + scan.angle_increment * np.arange(count))
        looked = (directions if name == "angle_deg" else -directions) % 360.0
        off = (1 + looked / 100 - np.asarray(scan.ranges) + 1.8) % 3.6 - 1.8
        assert np.abs(off).max() < 1e-4  # of 0.01 degrees


def test_a_first_scan_of_few_beams_does_not_thin_out_the_next_ones(tmp_path: Path) -> None:
    """All scans of the log had as few."""
    lines = ["time_s,angle_deg,range_m"]
    for second, degrees in ((1, (0, 90)), (2, range(0, 360, 3)), (3, range(0, 360, 3))):
        lines += [f"{second},{angle},{2 + angle / 100}" for angle in degrees]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert [len(scan.ranges) for scan in _scans(tmp_path / "a.csv")] == [2, 120, 120]


@pytest.mark.parametrize("by", [("lidar", "angle"), ("angle", "lidar")])
def test_beams_of_two_lidars_may_take_turns(tmp_path: Path, by: tuple[str, str]) -> None:
    rows = [
        {"time": time, "lidar": lidar, "angle": angle, "range": 1.0 + angle / 100}
        for time in (1, 2)
        for lidar in "ab"
        for angle in range(0, 180 if lidar == "a" else 90, 3)
    ]
    rows.sort(key=lambda row: (row["time"], *(row[name] for name in by)))
    lines = ["time_s,lidar,angle_deg,range_m"]
    lines += [",".join(map(str, row.values())) for row in rows]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    scans = _scans(tmp_path / "a.csv")
    assert [int(np.isfinite(scan.ranges).sum()) for scan in scans] == [60, 30, 60, 30]


def test_a_header_may_be_quoted(tmp_path: Path) -> None:
    text = '"time_s","angle_min_deg","angle_increment_deg","range_m_0","range_m_1"\n1,0,1,2,3\n'
    (tmp_path / "a.csv").write_text(text)
    (scan,) = _scans(tmp_path / "a.csv")
    assert list(scan.ranges) == [2.0, 3.0]


@pytest.mark.parametrize(
    ("text", "encoding", "words"),
    [
        ("time_s;angle_deg;range_m\n1;0;1\n", "utf-8", "separated by semicolons: separate them by commas"),
        ("time_s\tangle_deg\trange_m\n1\t0\t1\n", "utf-8", "separated by tabs"),
        ("time_s,angle_deg,range_m\n1,0,1\n", "utf-16", "is UTF-16: save it as UTF-8"),
    ],
)
def test_a_spreadsheets_own_ways_are_named(tmp_path: Path, text: str, encoding: str, words: str) -> None:
    (tmp_path / "a.csv").write_text(text, encoding=encoding)
    with pytest.raises(LogError, match=words):
        open_log(tmp_path / "a.csv")


def test_a_time_for_each_beam_is_refused(tmp_path: Path) -> None:
    """A log of 30 turns was 10,830 scans."""
    lines = [f"{beam / 100},{beam},2.0" for beam in range(360)]
    (tmp_path / "a.csv").write_text("\n".join(["time_s,angle_deg,range_m", *lines]))
    with pytest.raises(LogError, match="each beam has a time_s of its own"):
        _scans(tmp_path / "a.csv")


def test_odometry_limits_lidars_and_mount(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "time_s,lidar,x_m,y_m,heading_deg,range_max_m,angle_min_deg,angle_increment_deg,range_m_0,range_m_1\n"
        "1.0,front,0.5,-1,90,30,-10,20,4,\n"
        "1.0,rear,,,,30,-10,20,5,6\n"
    )
    options = LogOptions(lidars=("front",), mounts={"front": Mount(0.2, 0.0, math.pi)})
    odometry, scan = open_log(tmp_path / "a.csv", options).envelopes()
    assert odometry.channel is ODOMETRY
    assert np.allclose(from_pose3(odometry.open(Odometry).pose), [0.5, -1.0, math.pi / 2])
    raw = scan.open(RawScan)
    assert raw.range_max == 30.0
    assert raw.mount.x == 0.2
    assert raw.ranges[0] == 4.0
    assert math.isnan(raw.ranges[1])
    assert len(_scans(tmp_path / "a.csv")) == 2


@pytest.mark.parametrize(
    ("columns", "cells"),
    [
        ("x_mm,y_mm,heading_rad", "500,-1000,0.5"),
        ("x_cm,y_m,theta_rad", "50,-1,0.5"),
        ("x_m,y_m,yaw_deg", f"0.5,-1,{math.degrees(0.5)}"),
    ],
)
@pytest.mark.parametrize(
    "beams", ["angle_min_deg,angle_increment_deg,range_m_0", "quality,angle_deg,range_m"]
)
def test_odometry_may_have_other_units(tmp_path: Path, columns: str, cells: str, beams: str) -> None:
    (tmp_path / "a.csv").write_text(f"time_s,{columns},{beams}\n1.0,{cells},1,20,4\n")
    moved, _ = open_log(tmp_path / "a.csv").envelopes()
    assert np.allclose(from_pose3(moved.open(Odometry).pose), [0.5, -1.0, 0.5])


def test_the_points_of_beams_are_no_odometry(tmp_path: Path) -> None:
    """Many programs write them beside angle and range, in the lidar's frame."""
    head = "time_s,angle_deg,range_mm,x_mm,y_mm"
    lines = ["1,0,1000,1000,0", "1,90,2000,0,2000", "1,180,3000,-3000,0", "1,270,4000,0,-4000"]
    (tmp_path / "a.csv").write_text("\n".join([head, *lines]))
    (scan,) = open_log(tmp_path / "a.csv").envelopes()
    assert sorted(scan.open(RawScan).ranges) == [1.0, 2.0, 3.0, 4.0]


def test_a_line_states_the_time_between_its_beams(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(WIDE.replace("\n", ",time_increment_s\n") + "1,0,1,2,2,0.0002\n")
    (scan,) = _scans(tmp_path / "a.csv")
    assert scan.time_increment == 0.0002


@pytest.mark.parametrize(
    ("beams", "empty", "scan"),
    [
        ("angle_min_deg,angle_increment_deg,range_m_0", ",,", "-10,20,4"),
        ("angle_deg,range_m", ",", "10,4"),
    ],
)
def test_odometry_may_have_lines_of_its_own(tmp_path: Path, beams: str, empty: str, scan: str) -> None:
    (tmp_path / "a.csv").write_text(
        f"time_s,lidar,x_m,y_m,heading_deg,{beams}\n"
        f"1.00,,0,0,0,{empty}\n1.02,front,,,,{scan}\n1.04,,0.1,0,0,{empty}\n1.06,,0.2,0,0,{empty}\n"
        f"1.06,front,,,,{scan}\n"
    )
    messages = list(open_log(tmp_path / "a.csv", LogOptions()).envelopes())
    driven = [each.open(Odometry).pose.position.x for each in messages if each.channel is ODOMETRY]
    assert driven == [0.0, 0.1, 0.2]
    scans = [each for each in messages if each.channel is not ODOMETRY]
    assert [each.address["lidar"] for each in scans] == ["front", "front"]


@pytest.mark.parametrize("swapped", [False, True])
def test_lines_of_one_time_may_come_in_any_order(tmp_path: Path, swapped: bool) -> None:
    lines = ["1.0,,,,-10,20,4,5", "1.0,0.5,0,0,,,,"]
    head = "time_s,x_m,y_m,heading_deg,angle_min_deg,angle_increment_deg,range_m_0,range_m_1"
    (tmp_path / "a.csv").write_text("\n".join([head, *(lines[::-1] if swapped else lines)]) + "\n")
    odometry, scan = open_log(tmp_path / "a.csv", LogOptions()).envelopes()
    assert odometry.open(Odometry).pose.position.x == 0.5
    assert list(scan.open(RawScan).ranges) == [4.0, 5.0]


@pytest.mark.parametrize(("mounted", "without"), [((), 2), (("front",), 1), (("front", "rear"), 0)])
def test_lidars_without_a_mount_are_counted(tmp_path: Path, mounted: tuple[str, ...], without: int) -> None:
    head = "time_s,lidar,angle_min_deg,angle_increment_deg,range_m_0"
    (tmp_path / "a.csv").write_text(
        "\n".join([head, *(f"{time},{lidar},-10,20,4" for time in (1, 2) for lidar in ("front", "rear"))])
        + "\n"
    )
    log = open_log(tmp_path / "a.csv", LogOptions(mounts=dict.fromkeys(mounted, Mount(0.2, 0.0, 0.0))))
    assert len(list(log.envelopes())) == 4
    assert log.counters["lidars_without_mount"] == without
    front = open_log(tmp_path / "a.csv", LogOptions(lidars=("front",)))
    assert len(list(front.envelopes())) == 2
    assert front.counters["lidars_without_mount"] == 1  # of those that are taken


WIDE = "time_s,angle_min_deg,angle_increment_deg,range_m_0,range_m_1\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (WIDE + "1,0,1,4,5\n2,0,1,4,far\n", "line 3, column range_m_1: 'far'"),
        (WIDE + "1,0,,4,5\n", "line 2, column angle_increment_deg: is empty"),
        (WIDE + "nan,0,1,4,5\n", "line 2, column time_s: 'nan'"),
        (
            WIDE.replace("time_s", "time_s,lidar") + "1,a,0,1,4,5\n1,front/scan x,0,1,4,5\n",
            "line 3, column lidar: 'front/scan x': rename it",
        ),
        (WIDE + "-5,0,1,4,5\n", "line 2, column time_s: -5 s is no time"),
        (WIDE + "1,0,0,4,5\n2,0,0,4,5\n", "column angle_increment_deg: is 0 in all lines"),
        (WIDE.replace("time", "Time") + "1,0,1,4,5\n", "line 1: has the column Time_s: rename it to time_s"),
        (WIDE.replace("angle_m", "Angle_m") + "1,0,1,4,5\n", "rename it to angle_min_deg"),
        (WIDE + "1,0,1,4\n", "line 2: 4 columns, the header has 5"),
        (WIDE, "no scan to take: the header alone"),
        (WIDE.replace("m_1", "m_2") + "1,0,1,4,5\n", "line 1: has the column range_m_2 and lacks range_m_1"),
        (WIDE + "1,,,,\n", "line 2, column angle_min_deg: is empty"),
        ("time_s,range_m_0\n1,2\n", "line 1: a line a scan needs the column angle_min_deg"),
        ("time_s,angle_deg\n1,2\n", "line 1: no columns of ranges"),
        ("time_s,angle_deg,range_m\n1,2,3\n2,x,3\n", "line 3, column angle_deg: 'x'"),
        (WIDE + "1,0,1,4,\xff\x00\n", "line 2, column range_m_1"),
        (WIDE.replace("time_s", "time_s,x_m,y_m"), "line 1: odometry needs x_m, y_m and heading_deg"),
        (WIDE.replace("time_s", "time_s,x_mm,y_mm"), "lacks heading_deg: add it; or, if it is no odometry"),
        (WIDE.replace("time_s", "time_s,yaw_rad,y_m"), "lacks x_m: add it"),
        (WIDE.replace("time_s", "time_s,x_m,x_mm,y_m,yaw_rad"), "has x_m and x_mm: keep one"),
        ("time_s,angle_deg,range_m,x_m,yaw_deg\n1,2,3,4,5\n", "lacks y_m: add it"),
        (
            WIDE.replace("time_s", "time_s,x_m,y_m,heading_deg") + "1,2,3,,0,1,4,5\n",
            "line 2, column heading_deg: is empty",
        ),
    ],
)
def test_what_is_wrong_is_named_by_line_and_column(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.csv").write_bytes(text.encode("latin-1"))
    with pytest.raises(LogError, match=words.replace("(", r"\(")) as raised:
        _scans(tmp_path / "a.csv")
    assert str(raised.value).startswith(str(tmp_path / "a.csv"))


def test_a_lidar_that_is_not_there_names_those_that_are(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(WIDE.replace("time_s", "time_s,lidar") + "1,front,0,1,4,5\n")
    with pytest.raises(LogError, match="there are front"):
        _scans(tmp_path / "a.csv", LogOptions(lidars=("rear",)))


@pytest.mark.filterwarnings("error")
def test_a_range_above_all_that_a_message_holds_is_no_return(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(WIDE + "1,0,1,1e300,5\n")
    (scan,) = _scans(tmp_path / "a.csv")
    assert list(scan.ranges) == [math.inf, 5.0]
