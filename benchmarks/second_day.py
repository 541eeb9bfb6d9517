"""What a first drive is worth: robots on a worse map, and on the map that `eigenscan map --on` made of it.

    .venv/bin/python benchmarks/second_day.py [--datasets FOLDER] [--only intel --only fr079]
        [--way "walls 30 cm" --way "warped 40 cm"] [--windows 8] [--drive 1.0] [--seed 1] [--json OUT]

All of a log but its windows is the first drive, or the first share of that (--drive); of a log without
windows.csv its first half. It is located on the log's own map made worse on purpose (worse_maps.py), and
improves it. Then robots start cold in the windows, which no map has seen. On the better map a pose is right
where it lies as the true reference does beside the nearest pose of the first drive: a mended map is straight
again, so the reference that the worse map displaced no longer counts.
"""

import argparse
import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from eigenscan.geometry.gridmap import GridMap, write_map
from eigenscan.geometry.pose import between, compose
from eigenscan.mapbuilder.mapping.chain import Sweep
from eigenscan.mapbuilder.mapping.survey import Mapped, MappingError, survey
from eigenscan.workbench.evaluation.chosen import PipelineSettings
from eigenscan.workbench.evaluation.locating import locate
from eigenscan.workbench.evaluation.log import Log
from eigenscan.workbench.evaluation.metrics import judge
from eigenscan.workbench.evaluation.models import build
from eigenscan.workbench.evaluation.reference import Trajectory
from eigenscan.workbench.evaluation.windows import Window, plan_windows, read_windows, thin
from eigenscan.workbench.evaluation.workers import Workers
from eigenscan.workbench.logs import LogOptions
from eigenscan.workbench.logs.scans import read_scans
from evaluate import DATASETS, wanted
from maps import LOGS, Case, read_case, worsened
from scipy.spatial import cKDTree
from worse_maps import WAYS

USUAL_WAYS = ("exact", "walls 30 cm fatter", "warped 40 cm", "thick, coarse, warped")
BESIDE_M = 3.0
"""Farther than this from the first drive, the given map has remained, and its reference counts."""
TURN_M = 0.5
"""m that a radian counts, where the nearest pose is looked for."""


def main() -> None:
    options = _options()
    rows = []
    for listed in wanted(LOGS, options.only):
        case = read_case(listed.name, options.datasets / listed.folder, listed.log, listed.reference)
        scans = read_scans(options.datasets / listed.folder / listed.log, LogOptions(), lambda _: None)
        for way in options.ways:
            rows.append(_judge(case, scans.sweeps, way, options))
            print(_line(rows[-1]), flush=True)
            if options.json:
                options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--only", action="append", help="name of a log; default: intel and fr079")
    parser.add_argument("--way", action="append", help="ways whose name holds this; may be given again")
    parser.add_argument("--windows", type=int, default=8, help="of each log, at most")
    parser.add_argument("--drive", type=float, default=1.0, help="share of the first drive, from its start")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, help="write all figures here")
    options = parser.parse_args()
    options.only = options.only or ["intel", "fr079"]
    asked = options.way
    options.ways = [n for n in WAYS if any(part in n for part in asked)] if asked else list(USUAL_WAYS)
    return options


def _judge(case: Case, sweeps: list[Sweep], way: str, options: argparse.Namespace) -> dict[str, Any]:
    before = time.perf_counter()
    worse, displaced = worsened(case, way, options.seed)
    windows = thin(_windows(case), options.windows)
    first_drive = _begun(case.log.outside([*windows, *_late(case)]), options.drive)
    taught = set(first_drive.scans.tolist())
    driven = [sweep for sweep in sweeps if sweep.stamp in taught]
    with tempfile.TemporaryDirectory() as folder:
        given = Path(folder) / "given.yaml"
        write_map(worse.grid, given)
        located = locate(given, first_drive.whole, driven, lambda _: lambda _: None)
    first_day = _starts(worse.grid, displaced, case.log, windows)
    try:
        mapped = survey(driven, located=located)
    except MappingError:  # too little of the drive was located: the given map stays in use
        second_day, in_map = first_day, 0.0
    else:
        better = _beside(case.reference, displaced, mapped, driven)
        second_day = _starts(mapped.grid, better, case.log, windows)
        in_map = len(mapped.numbers) / len(driven)
    return {
        "log": case.name,
        "map": way,
        "windows": len(windows),
        "located": len(located.numbers) / len(driven),
        "in_map": in_map,
        "first_day": first_day,
        "second_day": second_day,
        "seconds": time.perf_counter() - before,
    }


def _begun(log: Log, share: float) -> Log:
    """The first share of a log's scans, and the odometry up to there."""
    stamps = np.sort(log.scans)
    kept = round(share * len(stamps))
    return log.outside([Window(int(stamps[kept]), int(stamps[-1]))] if kept < len(stamps) else [])


def _late(case: Case) -> list[Window]:
    """The second half of a log without windows of its own: those that are planned cover all of it."""
    if (case.folder / "windows.csv").exists():
        return []
    stamps = np.sort(case.log.scans)
    return [Window(int(stamps[len(stamps) // 2]), int(stamps[-1]))]


def _windows(case: Case) -> list[Window]:
    listed = case.folder / "windows.csv"
    if listed.exists():
        return read_windows(listed)
    (late,) = _late(case)
    planned = plan_windows(case.log.scans, case.reference)
    return [window for window in planned if window.start >= late.start]


def _beside(true: Trajectory, displaced: Trajectory, mapped: Mapped, driven: list[Sweep]) -> Trajectory:
    """The reference on the better map."""
    at, known = true.at([driven[number].stamp for number in mapped.numbers])
    at, drawn = at[known], mapped.poses[known]
    away, nearest = cKDTree(_features(at)).query(_features(true.poses))
    beside = compose(drawn[nearest], between(at[nearest], true.poses))
    is_beside = np.asarray(away).reshape(-1, 1) < BESIDE_M
    return Trajectory(true.stamps, np.where(is_beside, beside, displaced.poses))


def _features(poses: Any) -> Any:
    return np.column_stack([poses[:, :2], TURN_M * np.cos(poses[:, 2]), TURN_M * np.sin(poses[:, 2])])


def _starts(grid: GridMap, reference: Trajectory, log: Log, windows: list[Window]) -> dict[str, Any]:
    """Cold starts on a map."""
    settings = PipelineSettings()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.yaml"
        write_map(grid, path)
        built = build(path, settings.mapbuilder, lambda _: None)
    with Workers(1, built.models, log.beginning, settings) as workers:
        judged = [judge(run.stream, reference) for run in workers.runs(map(log.between, windows))]
    claims = sum(int(one.stream.localized.sum()) for one in judged)
    return {
        "success": float(np.mean([one.converged is not None for one in judged])),
        "claimed": claims / sum(len(one.stream) for one in judged),
        "false_share": sum(int(one.false_claims.sum()) for one in judged) / max(claims, 1),
        "error_m": float(np.median(np.concatenate([one.position_m[one.right_claims] for one in judged]))),
    }


def _line(row: dict[str, Any]) -> str:
    cells = "".join(
        f"   {day.replace('_', ' ')}: success {100 * row[day]['success']:.0f} %, claimed "
        f"{100 * row[day]['claimed']:.0f} %, false {100 * row[day]['false_share']:.2f} %, "
        f"{100 * row[day]['error_m']:.1f} cm"
        for day in ("first_day", "second_day")
    )
    known = f"located {100 * row['located']:.0f} %, in the map {100 * row['in_map']:.0f} %"
    return f"{row['log']:8} {row['map']:24}{cells}   {known}"


if __name__ == "__main__":
    main()
