"""Whole evaluations of a simulated drive: what comes out, and that it does not depend on what it must not."""

import io
import json
import math
import re
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from eigenscan.eigenspace.folder import read_models, write_models
from eigenscan.geometry.gridmap import read_map
from eigenscan.mapbuilder.plan import Plan
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import build_site
from eigenscan.runtime.choices import Choices
from eigenscan.runtime.recording import RecordingWriter, read
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.evaluation.chosen import SERVICES, PipelineSettings, chosen
from eigenscan.workbench.evaluation.course import ClaimsTask, Task, evaluate, evaluate_claims
from eigenscan.workbench.evaluation.reference import EvaluationError
from eigenscan.workbench.evaluation.report import remarks, show
from eigenscan.workbench.logs import LogOptions
from eigenscan.workbench.progress import Bars
from rich.console import Console

from tests.environment import EIGENSCAN

pytestmark = pytest.mark.slow

SPREAD = {"median": float, "p95": float}
SPREAD_99 = {"median": float, "p99": float}
# the JSON of the evaluation's definition, figure by figure
TESTED = {"consistency": {"n": int, "mean": float, "low": float, "high": float}}
SCHEMA: dict[str, Any] = {
    "windows": int,
    "success_rate": float,
    "false_claim_rate": float,
    "to_localize": {"scans": SPREAD, "metres": SPREAD, "seconds": SPREAD, "cpu_s": SPREAD},
    "error": {"position_m": SPREAD, "heading_deg": SPREAD},
    "calibration_error": float,
    "map_explains": {"median": float, "p5": float},
    "normalised_error_squared": TESTED,
    "normalised_innovation_squared": TESTED,
    "kidnap": {"noticed_s": SPREAD, "recovered_s": SPREAD, "recovered_rate": float},
    "single_scan": {
        "n": int,
        "top1": float,
        "in_list": float,
        "list_length": float,
        "cpu_ms": SPREAD_99,
        "exhaustive_top1": float,
        "exhaustive_cpu_ms": SPREAD_99,
    },
    "cpu_ms_per_scan": SPREAD_99,
    "peak_rss_mb": float,
    "map_m2": float,
    "model": {"build_s": float, "wire_mb": float, "memory_mb": float},
    "per_window": list,
}


@dataclass(frozen=True)
class Drive:
    """A simulated drive of 16 s."""

    recording: Path
    truth: Path
    map: Path
    windows: Path

    @property
    def task(self) -> Task:
        return Task(
            log=self.recording,
            map=self.map,
            reference=self.truth,
            windows=self.windows,
            single_scans=None,
            kidnap=False,
            skip=frozenset({"single-scans", "memory"}),
            offset_s=0.0,
            limit=None,
            jobs=1,
            poses=None,
            options=LogOptions(),
            settings=PipelineSettings(),
        )


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    folder = tmp_path_factory.mktemp("drive")
    made = Drive(folder / "d.mcap", folder / "d.tum", folder / "map.yaml", folder / "w.csv")
    command: list[str | Path] = [
        EIGENSCAN,
        "simulate",
        "-o",
        made.recording,
        "--truth",
        made.truth,
        "--save-map",
        made.map,
    ]
    subprocess.run([*command, "--seconds", "16", "--rate", "5", "--beams", "181", "--seed", "4"], check=True)
    first, last = (float(made.truth.read_text().splitlines()[line].split()[0]) for line in (0, -1))
    middle = (first + last) / 2
    made.windows.write_text(f"start_time,end_time\n{first:.9f},{middle:.9f}\n{middle:.9f},{last:.9f}\n")
    return made


def run(task: Task) -> dict[str, Any]:
    with Bars() as bars:
        return evaluate(task, bars)


def rewritten(drive: Drive, path: Path, change: Any) -> Path:
    """A recording with every message changed; None leaves one out."""
    with RecordingWriter(path) as writer:
        for record in read(drive.recording):
            for envelope in change(record.envelope):
                writer.write(envelope, record.log_time)
    return path


def scans_changed(change: Callable[[RawScan], None]) -> Callable[[Envelope], list[Envelope]]:
    """For `rewritten`: a log without its truth, each raw scan of it after `change`."""

    def changed(envelope: Envelope) -> list[Envelope]:
        if envelope.channel is not SCAN_RAW:
            return [envelope] if envelope.channel is ODOMETRY else []
        message = RawScan()
        message.CopyFrom(envelope.open(RawScan))
        change(message)
        return [replace(envelope, message=message)]

    return changed


def check(figures: Any, schema: Any, name: str) -> None:
    if isinstance(schema, dict):
        for key, inner in schema.items():
            assert key in figures, f"{name}.{key} is missing"
            check(figures[key], inner, f"{name}.{key}")
    elif schema is float:
        assert figures is None or (isinstance(figures, float | int) and not isinstance(figures, bool)), name
    else:
        assert isinstance(figures, schema), name


def test_settings_change_what_is_judged(drive: Drive) -> None:
    """The whole way through the commands' own choices, to each of the cores."""
    task = replace(drive.task, skip=frozenset({"exhaustive", "memory"}), limit=4)
    reported = {}
    for name, changes in (
        ("default", []),
        ("unsure", ["tracker.localized_above=1.0"]),
        ("one", ["projector.published=1"]),
        ("coarse", ["mapbuilder.spacing=1.0"]),
        ("blind", ["scan-ingest.range_max=0.5"]),
    ):
        settings = chosen(Choices.of("default", None, changes, SERVICES), spacing=None)
        reported[name] = run(replace(task, settings=settings))
    assert reported["default"]["success_rate"] == 1.0
    assert reported["unsure"]["success_rate"] == 0.0
    assert reported["one"]["single_scan"]["list_length"] == 1.0
    assert reported["coarse"]["model"]["positions"] < reported["default"]["model"]["positions"] / 3
    assert reported["blind"]["success_rate"] == 0.0


def test_what_is_judged_is_what_the_mapbuilder_publishes(drive: Drive, tmp_path: Path) -> None:
    """For a map by its defaults; for a model folder what is in it, unless settings are chosen."""
    assert chosen(Choices()).mapbuilder == MapbuilderSettings()
    folder = tmp_path / "model"
    write_models(build_site(read_map(drive.map), Plan(spacing=1.0)), folder)
    task = replace(drive.task, map=folder, skip=frozenset({"windows", "single-scans", "memory"}))
    held = read_models(folder)
    model = run(task)["model"]
    assert (model["version"], model["spacing_m"], model["build_s"]) == (held.to_message().version, 1.0, None)
    again = run(replace(task, settings=chosen(Choices(), spacing=0.6)))["model"]
    assert again["version"] != model["version"]
    assert again["spacing_m"] == pytest.approx(0.6)
    assert again["build_s"] > 0.0


def test_the_papers_method_runs_on_a_log(drive: Drive) -> None:
    settings = chosen(Choices.of("paper", None, [], SERVICES))
    figures = run(replace(drive.task, settings=settings))
    assert figures["windows"] == 2
    assert figures["model"]["spacing_m"] == 0.5


def _shown(figures: Any) -> str:
    """What a reader sees, without blank lines."""
    console = Console(width=400, record=True, file=io.StringIO())
    show(figures, "a log", console)
    return "\n".join(line for line in console.export_text().splitlines() if line.strip())


def test_the_json_has_every_figure(drive: Drive, tmp_path: Path) -> None:
    # relative paths, from another folder
    out = subprocess.run(
        [
            *(EIGENSCAN, "evaluate", "d.mcap", "map.yaml", "--ground-truth", "d.tum"),
            *(
                "--windows",
                "w.csv",
                "--kidnap",
                "--limit",
                "4",
                "--json",
                tmp_path / "o.json",
            ),
        ],
        cwd=drive.recording.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert out.returncode == 0, out.stderr
    figures = json.loads((tmp_path / "o.json").read_text())
    check(figures, SCHEMA, "figures")
    assert figures["windows"] == len(figures["per_window"]) == 2
    assert figures["single_scan"]["n"] == 4
    assert figures["kidnap"]["kidnaps"] >= figures["kidnap"]["decided"] >= 1
    assert 0 < figures["cpu_ms_per_scan"]["median"] < figures["cpu_ms_per_scan"]["p99"]
    assert "success" in out.stdout
    for square in ("normalised_error_squared", "normalised_innovation_squared"):
        tested = figures[square]["consistency"]
        assert tested["n"] > 5
        assert f"of {tested['n']} scans 0.5 m apart" in out.stdout
    assert "right for good within 3 s" in out.stdout


def test_what_is_not_asked_for_is_null(drive: Drive) -> None:
    figures = run(replace(drive.task, skip=frozenset({"windows", "single-scans", "memory"})))
    assert figures["kidnap"] is None
    assert figures["single_scan"] is None
    assert figures["success_rate"] is None
    assert figures["to_localize"]["scans"] == {"median": None, "p95": None}
    assert "no window could be judged" in _shown(figures)


def test_poses_are_the_same_each_time_in_any_number_of_processes_and_whatever_the_reference_states(
    drive: Drive, tmp_path: Path
) -> None:
    elsewhere = tmp_path / "elsewhere.tum"
    rows = [line.split() for line in drive.truth.read_text().splitlines()]
    elsewhere.write_text("\n".join(" ".join([t, str(float(x) + 3), *rest]) for t, x, *rest in rows))
    task = drive.task
    tasks = [task, replace(task, jobs=2), replace(task, reference=elsewhere)]
    files = [tmp_path / f"{number}.csv" for number in range(3)]
    results = [run(replace(one, poses=file)) for one, file in zip(tasks, files, strict=True)]
    texts = [file.read_text() for file in files]
    assert len(texts[0].splitlines()) > 60
    assert texts[0] == texts[1] == texts[2]
    assert results[0]["error"] == results[1]["error"]
    assert results[2]["success_rate"] == 0.0


def test_the_pipelines_own_poses_judged_from_their_file_give_the_same_figures(
    drive: Drive, tmp_path: Path
) -> None:
    file = tmp_path / "poses.csv"
    own = run(replace(drive.task, poses=file))
    task = ClaimsTask(
        *(drive.recording, file, None, drive.truth, drive.windows),
        kidnap=False,
        offset_s=0.0,
        limit=None,
        options=LogOptions(),
    )
    with Bars() as bars:
        judged = evaluate_claims(task, bars)
    same = (
        "windows",
        "success_rate",
        "false_claim_rate",
        "false_share_of_claims",
        "elsewhere_share_of_claims",
        "right_claim_rate",
        "error",
    )
    assert [judged[name] for name in same] == [own[name] for name in same]
    assert judged["calibration"] == own["calibration"]
    assert judged["to_localize"]["scans"] == own["to_localize"]["scans"]
    console = Console(file=io.StringIO(), width=110)
    show(judged, "claims", console)
    assert isinstance(console.file, io.StringIO)
    assert "success" in console.file.getvalue()
    assert "NEES" not in console.file.getvalue()


def test_a_reference_of_half_the_log_judges_that_half(drive: Drive, tmp_path: Path) -> None:
    lines = drive.truth.read_text().splitlines()
    half = tmp_path / "half.tum"
    half.write_text("\n".join(lines[: len(lines) // 2 - 10]) + "\n")
    figures = run(replace(drive.task, reference=half))
    assert figures["windows"] == 1
    assert figures["windows_left_out"] == 1
    (row,) = figures["per_window"]
    assert row["judged"] < row["scans"]


def test_a_log_without_odometry_and_one_with_two_lidars(drive: Drive, tmp_path: Path) -> None:
    def without_odometry(envelope: Envelope) -> list[Envelope]:
        return [envelope] if envelope.channel is not ODOMETRY else []

    def two_lidars(envelope: Envelope) -> list[Envelope]:
        if envelope.channel is not SCAN_RAW:
            return [envelope]
        return [envelope, Envelope(SCAN_RAW, {**envelope.address, "lidar": "second"}, envelope.message)]

    alone = run(replace(drive.task, log=rewritten(drive, tmp_path / "a.mcap", without_odometry)))
    both = run(replace(drive.task, log=rewritten(drive, tmp_path / "b.mcap", two_lidars)))
    assert alone["log"]["odometry"] == 0
    assert remarks(alone) == ["the log has no odometry: the scans alone were used"]
    assert remarks(both) == []
    assert alone["per_window"][0]["judged"] > 0
    assert len(both["log"]["lidars"]) == 2
    assert both["per_window"][0]["scans"] == 2 * alone["per_window"][0]["scans"]


def test_a_reference_of_another_frame_is_named(drive: Drive) -> None:
    figures = run(drive.task) | {
        "reference_frame": {"x_m": 3.0, "y_m": -12.004, "heading_deg": 90.0, "right_share": 0.97}
    }
    (remark,) = remarks(figures)
    assert remark.startswith("97% of the claims are right once the reference is turned by 90.0° and then")
    assert "by 3.00 m, -12.00 m" in remark


def test_a_lidar_that_is_mounted_otherwise_than_stated_is_noticed(drive: Drive, tmp_path: Path) -> None:
    """Its scans fit the map all the same: only odometry objects."""

    def turned(message: RawScan) -> None:
        message.mount.theta += math.pi / 2

    log = rewritten(drive, tmp_path / "turned.mcap", scans_changed(turned))
    figures = run(replace(drive.task, log=log, reference=None, windows=None))
    (remark,) = remarks(figures)
    assert "--mount" in remark
    faulty = _shown(figures).splitlines()
    assert faulty[-2].startswith("warning: health reported")
    assert sum(line.startswith("warning: ") for line in faulty) == 1
    only_there = figures | {"reported": {"lidar covered": {"seconds": 12.0, "runs": 0}}}
    assert remarks(only_there) == ["health reported for 12 s of the whole drive: lidar covered"]


def test_a_lidar_in_millimetres_is_named_where_nothing_is_localized(drive: Drive, tmp_path: Path) -> None:
    def in_millimetres(message: RawScan) -> None:
        message.ranges[:] = [1000.0 * each for each in message.ranges]

    log = rewritten(drive, tmp_path / "millimetres.mcap", scans_changed(in_millimetres))
    with pytest.raises(EvaluationError, match=r"nowhere localized.*Health reported: lidar .* millimetres"):
        run(replace(drive.task, log=log, reference=None, windows=None))
    figures = run(replace(drive.task, log=log))
    (remark,) = [each for each in remarks(figures) if "millimetres" in each]
    played = sum(row["end"] - row["start"] for row in figures["per_window"])
    count = figures["windows"]
    assert re.match(rf"health reported for \d+ s of {played:.0f}, in {count} of {count} windows: ", remark)


def test_a_reference_with_other_stamps_fits_with_its_offset(drive: Drive, tmp_path: Path) -> None:
    moved = tmp_path / "moved.tum"
    rows = [line.partition(" ") for line in drive.truth.read_text().splitlines()]
    moved.write_text("\n".join(f"{float(t) - 1000:.6f} {rest}" for t, _, rest in rows))
    figures = run(replace(drive.task, reference=moved, windows=None, offset_s=1000.0))
    unmoved = run(replace(drive.task, windows=None))
    assert figures["windows"] == unmoved["windows"] >= 1
    assert figures["success_rate"] == unmoved["success_rate"] == 1.0
    for name in ("position_m", "heading_deg"):
        assert figures["error"][name]["median"] == pytest.approx(unmoved["error"][name]["median"], rel=1e-3)


@pytest.mark.parametrize(
    ("broken", "text", "named"),
    [
        ("log", None, "cannot be read"),
        ("log", "not a log\n", "is a map, no log"),
        ("map", "image: map.pgm\norigin: [0, 0, 0]\n", "resolution is missing"),
        ("truth", "1 2 3\n", "line 1"),
        ("truth", "5 0 0 0 0 0 0 1\n6 0 0 0 0 0 0 1\n", "covers 5.000 to 6.000 s"),
        ("windows", "start_time,end_time\n9,8\n", "end_time is not after start_time"),
        ("windows", "start_time,end_time\n1,2\n", "no window holds 3 scans"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    drive: Drive, tmp_path: Path, broken: str, text: str | None, named: str
) -> None:
    given = {"log": drive.recording, "map": drive.map, "truth": drive.truth, "windows": drive.windows}
    given[broken] = tmp_path / "bad.yaml"
    if text is not None:
        given[broken].write_text(text)
    out = subprocess.run(
        [
            *(EIGENSCAN, "evaluate", "--log", given["log"], "--map", given["map"]),
            *("--ground-truth", given["truth"], "--windows", given["windows"], "--spacing", "0.5"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert out.returncode == 2
    complaint = [line for line in out.stderr.splitlines() if line.startswith("eigenscan evaluate: ")]
    assert len(complaint) == 1
    assert "bad.yaml" in complaint[0]
    assert named in complaint[0]
    assert "Traceback" not in out.stderr


def test_a_recording_judges_by_its_own_truth(drive: Drive) -> None:
    reported, by_file = (evaluate(replace(drive.task, reference=r), Bars()) for r in (None, drive.truth))
    assert reported["reference"] == "the recording's own truth"
    for figure in ("windows", "success_rate", "false_claim_rate"):
        assert reported[figure] == by_file[figure]
    # the file has six decimals, the recording all of them
    assert reported["error"]["position_m"]["median"] == pytest.approx(
        by_file["error"]["position_m"]["median"], abs=1e-5
    )


def test_without_any_truth_cold_starts_are_compared_with_the_whole_drive(
    drive: Drive, tmp_path: Path
) -> None:
    blind = tmp_path / "blind.mcap"
    with RecordingWriter(blind, {}) as writer:
        for record in read(drive.recording):
            if record.envelope.channel in (SCAN_RAW, ODOMETRY):
                writer.write(record.envelope, record.log_time)
    own = evaluate(replace(drive.task, log=blind, reference=None), Bars())
    judged = evaluate(replace(drive.task, log=blind), Bars())
    assert own["reference"] == "the drive as a whole"
    assert own["success_rate"] == judged["success_rate"] == 1.0
    assert "success" not in _shown(own)
    assert "agreement, not accuracy" in _shown(own).splitlines()[-1]
    assert _shown(judged).splitlines()[-1].endswith("have a false claim.")
    # it agrees with itself better than with the truth
    assert own["error"]["position_m"]["median"] < judged["error"]["position_m"]["median"]


def test_a_log_that_breaks_off_reports_it(drive: Drive, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(drive.recording.read_bytes()[:-64])
    figures = evaluate(replace(drive.task, log=cut), Bars())
    assert figures["log"]["is_cut"]
