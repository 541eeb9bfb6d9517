"""Maps that are wrong in the ways in which maps are: what is found on them, and what is claimed falsely.

    .venv/bin/python benchmarks/maps.py [--datasets FOLDER] [--only intel --only fr079] [--way "walls 10 cm"]
        [--windows 9] [--scans 100] [--quick] [--simulated] [--seed 1] [--jobs 1]
        [--set tracker.local_fits=false] [--json OUT]

Each log at hand is driven on its map made worse on purpose (worse_maps.py), from mild to hard; the reference
goes along with what the map did. A window succeeds when every claim from some scan on, over its last third
at least, is right (0.5 m, 10 degrees). Of false claims, those over 1 m or 20 degrees off are elsewhere. Worst
first. `--quick` takes 5 windows and 40 scans of each.
The datasets are not part of the project; by default they are looked for beside it. `--buildings FOLDER` takes
logs of your own instead, laid out as for evaluate.py.
"""

import argparse
import json
import os
import tempfile
import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from eigenscan.geometry.gridmap import GridMap, read_map, write_map
from eigenscan.runtime.choices import Choices
from eigenscan.workbench.evaluation.chosen import SERVICES, chosen
from eigenscan.workbench.evaluation.log import Log, read_log
from eigenscan.workbench.evaluation.metrics import Judged, errors, judge, right
from eigenscan.workbench.evaluation.models import build
from eigenscan.workbench.evaluation.reference import Trajectory, read_trajectory
from eigenscan.workbench.evaluation.windows import (
    Window,
    plan_scans,
    plan_windows,
    read_times,
    read_windows,
    thin,
)
from eigenscan.workbench.evaluation.workers import Workers
from eigenscan.workbench.logs import LogOptions
from evaluate import CASES, DATASETS, buildings, wanted
from evaluate import Case as Listed
from simulated_worlds import worlds, write
from worse_maps import WAYS, Worse, stays

LOGS = (*CASES, Listed("aces", "aces", "log.clf.gz", "log.tum"))
CHOSEN_ON = ("intel", "guardian 3")
"""Logs that choices were made on; the others only judge."""
LAST_SHARE = 1 / 3
"""Of a window, over which all claims must be right."""
QUICK_WINDOWS, QUICK_SCANS = 5, 40


@dataclass(frozen=True)
class Case:
    """A log with its reference, and what of it is tried."""

    name: str
    map: GridMap
    log: Log
    reference: Trajectory
    folder: Path


def main() -> None:
    options = _options()
    rows = []
    for case in _cases(options):
        for way in options.ways:
            before = time.perf_counter()
            row = _judge(case, way, options)
            rows.append(row)
            print(f"{_line(row)}   ({time.perf_counter() - before:.0f} s)", flush=True)
            if options.json:
                options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print("\n" + _table(rows))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--buildings", type=Path, help="folder of folders with logs of your own")
    parser.add_argument("--only", action="append", help="name of a log, or its folder; may be given again")
    parser.add_argument("--way", action="append", help="ways whose name holds this; may be given again")
    parser.add_argument("--windows", type=int, default=9, help="of each log, at most")
    parser.add_argument("--scans", type=int, default=100, help="single ones of each log, at most")
    parser.add_argument("--quick", action="store_true", help="few windows and scans")
    parser.add_argument("--simulated", action="store_true", help="also made-up buildings")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1, help="processes side by side")
    parser.add_argument("--set", action="append", default=[], help="SERVICE.SETTING=VALUE, any number")
    parser.add_argument("--json", type=Path, help="write all figures here")
    options = parser.parse_args()
    if options.quick:
        options.windows, options.scans = QUICK_WINDOWS, QUICK_SCANS
    asked = options.way or [""]
    options.settings = chosen(Choices.of("default", None, options.set, SERVICES))
    options.ways = [name for name in WAYS if any(part in name for part in asked)]
    return options


def _cases(options: argparse.Namespace) -> Iterator[Case]:
    root = options.buildings or options.datasets
    made_up = {world.name: world for world in (worlds() if options.simulated else [])}
    for listed in wanted(buildings(root) if options.buildings else LOGS, options.only, *made_up):
        yield read_case(listed.name, root / listed.folder, listed.log, listed.reference)
    for name, world in made_up.items():
        if name in (options.only or [name]):
            with tempfile.TemporaryDirectory() as scratch:
                place = Path(scratch) / "world"
                write(world, place)
                yield read_case(name, place, "log.mcap", "log.tum")


def read_case(name: str, folder: Path, log_name: str, reference_name: str) -> Case:
    """Reads a log, its reference and its map."""
    log = read_log(folder / log_name, LogOptions(), lambda _: None)
    reference = read_trajectory(folder / reference_name).restamped(log.logged)
    return Case(name, read_map(folder / "map.yaml"), log, reference, folder)


def windows_of(case: Case) -> list[Window]:
    """The windows of a log: those of its own list, else planned."""
    listed = case.folder / "windows.csv"
    return read_windows(listed) if listed.exists() else plan_windows(case.log.scans, case.reference)


def worsened(case: Case, way: str, seed: int) -> tuple[Worse, Trajectory]:
    """The log's map made worse in this way, and the reference that goes along with it."""
    own = zlib.crc32(f"{case.name} {way} {seed}".encode())
    worse = WAYS[way](Worse(case.map, stays), case.reference.poses, own)
    return worse, Trajectory(case.reference.stamps, worse.move(case.reference.poses))


def _judge(case: Case, way: str, options: argparse.Namespace) -> dict[str, Any]:
    # the parts that are tried are those of the true way: the same on every map
    worse, reference = worsened(case, way, options.seed)
    windows, times = windows_of(case), case.folder / "single_scans.csv"
    stamps = read_times(times) if times.exists() else plan_scans(case.log.scans, case.reference)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "map.yaml"
        write_map(worse.grid, path)
        built = build(path, options.settings.mapbuilder, lambda _: None)
    with Workers(options.jobs, built.models, case.log.beginning, options.settings) as workers:
        chosen = thin(windows, options.windows)
        runs = list(workers.runs(case.log.between(window) for window in chosen))
        scans = [s for t in thin(stamps, options.scans) if (s := case.log.nearest_scan(t, 1.0)) is not None]
        answers = list(workers.answers(scan.envelope for scan in scans))
    judged = [judge(run.stream, reference) for run in runs]
    truths, known = reference.at([scan.stamp for scan in scans])
    first, in_list = [], []
    for answer, truth, there in zip(answers, truths, known, strict=True):
        if there:
            hits = right(*errors(answer.poses, np.broadcast_to(truth, answer.poses.shape)))
            first.append(bool(hits[:1].any()))
            in_list.append(bool(hits.any()))
    claims = sum(int(j.stream.localized.sum()) for j in judged)
    false = [int(j.false_claims.sum()) for j in judged]
    starts = [_since(j) for j in judged]
    return {
        "log": case.name,
        "map": way,
        "chosen_on": case.name in CHOSEN_ON,
        "windows": len(judged),
        "success": float(np.mean([start is not None for start in starts])),
        "first_edition": float(np.mean([j.converged is not None for j in judged])),
        "false_windows": float(np.mean([count > 0 for count in false])),
        "false_share": sum(false) / claims if claims else 0.0,
        "elsewhere_share": sum(int(j.elsewhere_claims.sum()) for j in judged) / max(claims, 1),
        "claimed": claims / max(sum(len(j.stream) for j in judged), 1),
        "best_is_right": float(np.mean(np.concatenate([j.right for j in judged]))),
        "scans": len(first),
        "top1": float(np.mean(first)),
        "in_list": float(np.mean(in_list)),
        "cpu_ms": float(np.median(np.concatenate([run.cpu_ms for run in runs]))),
        "one_ms": float(np.median([answer.cpu_ms for answer in answers])),
        "per_window": [
            {"start": w.start / 1e9, "false": f, "from_share": s, "of": len(j.stream)}
            for w, f, s, j in zip(chosen, false, starts, judged, strict=True)
        ],
    }


def _since(judged: Judged) -> float | None:
    """Share of the window from which on every claim is right; None where that is not its last third."""
    start = judged.converged
    if start is None or not len(judged.stream):
        return None
    share = start / len(judged.stream)
    return share if share <= 1.0 - LAST_SHARE else None


COLUMNS = (
    ("success %", "success"),
    ("false windows %", "false_windows"),
    ("claims false %", "false_share"),
    ("elsewhere %", "elsewhere_share"),
    ("claimed %", "claimed"),
    ("best right %", "best_is_right"),
    ("one scan: first %", "top1"),
    ("in list %", "in_list"),
)


def _line(row: dict[str, Any]) -> str:
    cells = " ".join(f"{100 * row[key]:6.1f}" for _, key in COLUMNS)
    return f"{row['log']:12} {row['map']:28} {cells} {row['cpu_ms']:5.1f} {row['one_ms']:5.1f}"


def _table(rows: list[dict[str, Any]]) -> str:
    head = ["log", "map", "windows", *(title for title, _ in COLUMNS), "ms a scan"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in sorted(rows, key=lambda row: (row["success"] - row["false_share"], row["top1"])):
        cells = [f"{100 * row[key]:.1f}" for _, key in COLUMNS]
        words = [row["log"], row["map"], str(row["windows"]), *cells, f"{row['cpu_ms']:.1f}"]
        lines.append("| " + " | ".join(words) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
