"""Global localization on every log with a map: one table, one JSON.

    .venv/bin/python benchmarks/evaluate.py [--datasets FOLDER] [--only intel] [--simulated] [--kidnap]
        [--method paper] [--paper] [--set tracker.local_fits=false] [--json OUT]
    .venv/bin/python benchmarks/evaluate.py --buildings FOLDER [--only aces] [--kidnap] [--json OUT]
    .venv/bin/python benchmarks/evaluate.py --from OUT --picture docs/images/reliability.png

The datasets are not part of the project; by default they are looked for beside it. `--buildings` takes
logs of your own instead: each folder in FOLDER that holds map.yaml, and a log with a reference beside it
(drive.bag, drive.tum), is a row. windows.csv and single_scans.csv name what to try, where they are there.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eigenscan.workbench.logs import LogError, open_log
from reliability_picture import draw_reliability
from simulated_worlds import worlds, write

EIGENSCAN = Path(sys.executable).parent / "eigenscan"
DATASETS = Path(__file__).parents[1].parent / "shared/datasets"


@dataclass(frozen=True)
class Case:
    """One log on one map."""

    name: str
    folder: str
    log: str
    reference: str


CASES = (
    Case("intel", "intel", "log.clf.gz", "log.tum"),
    Case("fr079", "fr079", "log.clf.gz", "log.tum"),
    Case("jarvis", "jarvis", "jarvis_complex_path_fast.bag", "jarvis_complex_path_fast.tum"),
    Case("guardian 3", "guardian", "guardian_3.bag", "guardian_3.tum"),
    Case("guardian 2", "guardian", "guardian_controller_2.bag", "guardian_controller_2.tum"),
    Case("olin", "olin_mac", "rosbag2", "rosbag2.tum"),
)
# jarvis's circular run made its map: it would judge nothing

BESIDE = (".tum", ".yaml", ".pgm", ".png", ".json")
"""Files beside a log that are none."""

COLUMNS = (
    ("windows", "windows", "{:d}", 1),
    ("success %", "success_rate", "{:.0f}", 100),
    ("false %", "false_claim_rate", "{:.0f}", 100),
    ("scans", "to_localize.scans.median", "{:.0f}", 1),
    ("p95", "to_localize.scans.p95", "{:.0f}", 1),
    ("metres", "to_localize.metres.median", "{:.1f}", 1),
    ("cm", "error.position_m.median", "{:.1f}", 100),
    ("deg", "error.heading_deg.median", "{:.2f}", 1),
    ("calib. %", "calibration_error", "{:.1f}", 100),
    ("nees", "normalised_error_squared.consistency.mean", "{:.2f}", 1),
    ("from", "normalised_error_squared.consistency.low", "{:.2f}", 1),
    ("to", "normalised_error_squared.consistency.high", "{:.2f}", 1),
    ("nis", "normalised_innovation_squared.consistency.mean", "{:.2f}", 1),
    ("from", "normalised_innovation_squared.consistency.low", "{:.2f}", 1),
    ("to", "normalised_innovation_squared.consistency.high", "{:.2f}", 1),
    ("ms", "cpu_ms_per_scan.median", "{:.1f}", 1),
    ("p99", "cpu_ms_per_scan.p99", "{:.1f}", 1),
    ("top1 %", "single_scan.top1", "{:.0f}", 100),
    ("listed %", "single_scan.in_list", "{:.0f}", 100),
    ("one ms", "single_scan.cpu_ms.median", "{:.1f}", 1),
    ("exh. %", "single_scan.exhaustive_top1", "{:.0f}", 100),
    ("exh. ms", "single_scan.exhaustive_cpu_ms.median", "{:.0f}", 1),
    ("noticed s", "kidnap.noticed_s.median", "{:.1f}", 1),
    ("found %", "kidnap.recovered_rate", "{:.0f}", 100),
    ("MB", "peak_rss_mb", "{:.0f}", 1),
)


def main() -> None:
    options = _options()
    found: dict[str, Any] = json.loads(options.earlier.read_text()) if options.earlier else _run(options)
    print(_table(found))
    for name, figures in found.items():
        for words, row in figures.get("reported", {}).items():
            print(f"{name}: health reported for {row['seconds']:.0f} s: {words}")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if options.picture:
        draw_reliability(options.picture, found)


def _run(options: argparse.Namespace) -> dict[str, Any]:
    found = {}
    root = options.buildings or options.datasets
    for case in wanted(buildings(root) if options.buildings else CASES, options.only):
        folder = root / case.folder
        if (folder / "map.yaml").exists():
            found[case.name] = _evaluate(case, folder, options)
    return found | (_run_simulated(options) if options.simulated else {})


def wanted(cases: Sequence[Case], only: Sequence[str] | None, *others: str) -> list[Case]:
    """Those whose name or folder is in `only`, all without it; `others` are names that a caller has beside.

    Ends the program where a name is none's.
    """
    known = {name for case in cases for name in (case.name, case.folder)}
    if unknown := sorted(set(only or ()) - known - set(others)):
        names = dict.fromkeys([*(case.name for case in cases), *others])
        sys.exit(f"--only {', '.join(unknown)}: choose from {', '.join(names)}")
    return [case for case in cases if not only or case.name in only or case.folder in only]


def buildings(root: Path) -> list[Case]:
    """Every log that has a reference, drive.tum to drive.bag, in the folders of `root` that hold a map."""
    found = []
    for folder in sorted(map_file.parent for map_file in root.glob("*/map.yaml")):
        for reference in sorted(folder.glob("*.tum")):
            named = [
                file for file in sorted(folder.iterdir()) if f"{file.name}.".startswith(f"{reference.stem}.")
            ]
            logs = [file for file in named if file.suffix not in BESIDE and is_log(file)]
            found += [
                Case(f"{folder.name}/{log.name}", folder.name, log.name, reference.name) for log in logs
            ]
    if not found:
        sys.exit(f"{root}: no folder in it holds map.yaml and a log with its reference: drive.bag, drive.tum")
    return found


def is_log(file: Path) -> bool:
    """Whether a file can be read as a log; else it is named and left out."""
    try:
        open_log(file)
    except LogError as error:
        print(error, file=sys.stderr)
        return False
    return True


def _run_simulated(options: argparse.Namespace) -> dict[str, Any]:
    found = {}
    for world in worlds():
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch) / "world"
            write(world, folder)
            found[world.name] = _evaluate(Case(world.name, "", "log.mcap", "log.tum"), folder, options)
    return found


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--datasets", type=Path, default=DATASETS, help="folder that holds the datasets")
    parser.add_argument("--buildings", type=Path, help="folder of folders with logs of your own")
    parser.add_argument("--only", action="append", help="name of a log, or its folder; may be given again")
    parser.add_argument("--simulated", action="store_true", help="also made-up buildings")
    parser.add_argument("--kidnap", action="store_true", help="also the kidnap protocol")
    parser.add_argument("--method", default="default", help="settings that belong together, such as paper")
    parser.add_argument("--set", action="append", default=[], help="SERVICE.SETTING=VALUE, any number")
    parser.add_argument("--paper", action="store_true", help="also the paper's own method, beside each log")
    parser.add_argument("--jobs", type=int, default=1, help="processes side by side")
    parser.add_argument("--limit", type=int, help="at most so many windows and single scans")
    parser.add_argument("--skip", action="append", default=[], help="part to leave out; may be given again")
    parser.add_argument("--json", type=Path, help="write all figures here")
    parser.add_argument("--picture", type=Path, help="draw the reliability diagram here")
    parser.add_argument("--from", dest="earlier", type=Path, help="JSON of an earlier run, instead of a run")
    return parser.parse_args()


def _evaluate(case: Case, folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    figures = _by_method(case, folder, options, options.method)
    return figures | ({"paper": _by_method(case, folder, options, "paper")} if options.paper else {})


def _by_method(case: Case, folder: Path, options: argparse.Namespace, method: str) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "figures.json"
        command: list[str | Path] = [EIGENSCAN, "evaluate", "--log", folder / case.log]
        command += ["--map", folder / "map.yaml", "--ground-truth", folder / case.reference]
        command += ["--json", out, "--jobs", str(options.jobs), "--method", method]
        for option, beside in (("--windows", "windows.csv"), ("--single-scans", "single_scans.csv")):
            command += [option, folder / beside] if (folder / beside).exists() else []
        command += ["--kidnap"] if options.kidnap else []
        command += ["--limit", str(options.limit)] if options.limit else []
        command += [word for change in options.set for word in ("--set", change)]
        command += [word for part in options.skip for word in ("--skip", part)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        figures: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
        return figures


def _table(found: dict[str, Any]) -> str:
    rows = [["log", *(title for title, *_ in COLUMNS)]]
    for name, figures in found.items():
        rows.append([name, *(_cell(figures, path, form, scale) for _, path, form, scale in COLUMNS)])
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def _cell(figures: dict[str, Any], path: str, form: str, scale: float) -> str:
    value: Any = figures
    for name in path.split("."):
        value = value.get(name) if isinstance(value, dict) else None
    return "-" if value is None else form.format(value * scale)


if __name__ == "__main__":
    main()
