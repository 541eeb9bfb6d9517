from __future__ import annotations

from pathlib import Path

import pytest
from eigenscan.cli.main import app
from eigenscan.runtime.recording import read, read_metadata
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.logs import open_log
from typer.testing import CliRunner

FIRST = "FLASER 3 1.0 2.0 3.0 0 0 0 0 0 0 1.000000 host 1\n"


def log_of(path: Path, scans: int = 20) -> Path:
    path.write_text("".join(f"FLASER 3 1 2 3 {n} 0 0 {n} 0 0 {n + 1}.5 host 1\n" for n in range(scans)))
    return path


def run(*arguments: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["import", *map(str, arguments)])
    return result.exit_code, result.stdout, result.stderr


def test_a_log_becomes_a_recording_and_a_summary(tmp_path: Path) -> None:
    log = log_of(tmp_path / "a.clf")
    code, out, _ = run(log, "-o", tmp_path / "a.mcap", "--robot", "r17", "--site", "lab")
    assert code == 0
    records = list(read(tmp_path / "a.mcap"))
    assert [r.envelope.key for r in records[:2]] == ["lab/robot/r17/odom", "lab/robot/r17/scan/raw/front"]
    assert len(records) == 40
    assert read_metadata(tmp_path / "a.mcap")["import"] == {"source": "a.clf", "format": "CARMEN log"}
    for reported in ("front", "odometry", "20", "1.0", "19.0", "81.83 m", "a.mcap"):
        assert reported in out
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.clf", "a.mcap"]


def test_a_file_that_is_there_is_kept(tmp_path: Path) -> None:
    log, target = log_of(tmp_path / "a.clf"), tmp_path / "a.mcap"
    target.write_text("precious")
    code, _, err = run(log, "-o", target)
    assert (code, target.read_text()) == (2, "precious")
    assert "--force" in err
    assert run(log, "-o", target, "--force")[0] == 0
    assert len(list(read(target))) == 40


def test_the_recording_reads_as_the_log(tmp_path: Path) -> None:
    log = log_of(tmp_path / "a.clf")
    run(log, "-o", tmp_path / "a.mcap")
    original, imported = open_log(log), open_log(tmp_path / "a.mcap")
    assert [e.message for e in original.envelopes()] == [e.message for e in imported.envelopes()]


def test_what_was_repaired_is_reported_and_kept(tmp_path: Path) -> None:
    (tmp_path / "a.clf").write_text(
        FIRST + FIRST.replace("1.000000", "9.0") + FIRST.replace("1.000000", "3.0")
    )
    _, out, _ = run(tmp_path / "a.clf", "-o", tmp_path / "a.mcap")
    assert "stamps repaired: 1" in out
    scans = [r for r in read(tmp_path / "a.mcap") if r.envelope.channel == SCAN_RAW]
    assert [(r.log_time, r.publish_time) for r in scans] == [
        (1_000_000_000, 1_000_000_000),
        (2_000_000_000, 9_000_000_000),
        (3_000_000_000, 3_000_000_000),
    ]


@pytest.mark.parametrize(
    ("content", "reported"),
    [
        (None, "a.clf: cannot be read: No such file or directory: check the path"),
        ("", "a.clf: is empty: give a CARMEN log"),
        ("rubbish\n", "a.clf: is of no known format: give a CARMEN log"),
        ("ODOM 0 0 0 0 0 0 1.0 host 1\n", "a.clf: no scan line could be read"),
    ],
)
def test_errors_are_one_line_and_leave_nothing_behind(
    tmp_path: Path, content: str | None, reported: str
) -> None:
    if content is not None:
        (tmp_path / "a.clf").write_text(content)
    code, _, err = run(tmp_path / "a.clf", "-o", tmp_path / "a.mcap")
    assert code == 2
    (line,) = [text for text in err.splitlines() if text.startswith("eigenscan import: ")]
    assert reported in line
    assert not list(tmp_path.glob("*.mcap*"))


def test_a_mount_of_a_lidar_that_is_not_there_is_reported(tmp_path: Path) -> None:
    log = log_of(tmp_path / "a.clf")
    code, _, err = run(log, "-o", tmp_path / "a.mcap", "--mount", "rear=1,0,180")
    assert code == 2
    assert "--mount rear=…: no lidar that is taken has this name: choose one of front" in err
    assert not list(tmp_path.glob("*.mcap*"))


def table_of(path: Path, metre: float) -> Path:
    beams = range(40)
    lines = ["time_s,angle_min_deg,angle_increment_deg," + ",".join(f"range_m_{j}" for j in beams)]
    lines += [f"{time},0,1," + ",".join(str(metre * (1 + j / 20)) for j in beams) for time in (1, 2, 3)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_ranges_in_millimetres_are_refused(tmp_path: Path) -> None:
    code, _, err = run(table_of(tmp_path / "a.csv", 1000.0), "-o", tmp_path / "a.mcap")
    assert code == 2
    assert "a.csv: lidar lidar: ranges must be metres" in err
    assert "name the columns range_mm" in err
    assert not list(tmp_path.glob("*.mcap*"))


@pytest.mark.parametrize(
    ("range_", "why"), [("0.0", "ranges: none lies between range_min and range_max"), ("inf", "no beam")]
)
def test_scans_that_no_command_can_use_are_remarked(tmp_path: Path, range_: str, why: str) -> None:
    names = ",".join(f"range_m_{j}" for j in range(4))
    lines = [f"time_s,angle_min_deg,angle_increment_deg,{names}"]
    lines += [f"{time},0,1," + ",".join([range_] * 4) for time in (1, 2, 3)]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    code, out, _ = run(tmp_path / "a.csv", "-o", tmp_path / "a.mcap")
    assert code == 0
    assert f"lidar lidar: none of its 3 scans can be used: {why}" in out
    assert "can be used" not in run(log_of(tmp_path / "b.clf"), "-o", tmp_path / "b.mcap")[1]


def test_a_log_without_odometry_is_reported_so(tmp_path: Path) -> None:
    code, out, _ = run(table_of(tmp_path / "a.csv", 1.0), "-o", tmp_path / "a.mcap")
    assert code == 0
    assert "no odometry" in out
    assert "no odometry" not in run(log_of(tmp_path / "b.clf"), "-o", tmp_path / "b.mcap")[1]


def test_the_log_is_not_overwritten(tmp_path: Path) -> None:
    log = log_of(tmp_path / "a.mcap")
    code, _, err = run(log, "-o", log)
    assert code == 2
    assert "would overwrite" in err
    assert log.read_text().startswith("FLASER")


def test_a_mount_is_given_in_degrees(tmp_path: Path) -> None:
    log = log_of(tmp_path / "a.clf")
    code, out, _ = run(log, "-o", tmp_path / "a.mcap", "--mount", "front=0.5,-0.25,90,upside-down")
    assert code == 0
    assert "0.500 m, -0.250 m, 90.0°, upside down" in " ".join(out.replace("│", " ").split())
    # and again, from the recording
    run(tmp_path / "a.mcap", "-o", tmp_path / "b.mcap", "--mount", "front=1,0,0")
    scan = next(r for r in read(tmp_path / "b.mcap") if r.envelope.channel == SCAN_RAW).envelope.open(RawScan)
    assert (scan.mount.x, scan.upside_down) == (1.0, False)


@pytest.mark.parametrize("text", ["front", "front=1,2", "=1,2,3", "front=1,2,nan", "front=a,b,c"])
def test_a_mount_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    code, _, err = run(log_of(tmp_path / "a.clf"), "-o", tmp_path / "a.mcap", "--mount", text)
    assert code == 2
    assert f"eigenscan import: --mount {text}: give" in err
