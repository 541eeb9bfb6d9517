"""From the paper's own pipeline to the default, one step a row: what each step gains on two real logs.

    .venv/bin/python benchmarks/ablation.py [--datasets FOLDER] [--windows 4] [--scans 60] [--jobs 1]
        [--json OUT]

The first row is `--method paper`. Each further row changes some settings to the default's, and keeps the
changes of the rows before; the last row is the default. intel was looked at while constants were chosen,
jarvis hardly.
"""

import argparse
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

from eigenscan.runtime.choices import Choices
from eigenscan.schemas.methods import METHODS
from eigenscan.workbench.evaluation.chosen import SERVICES, PipelineSettings, chosen
from eigenscan.workbench.evaluation.log import Log, read_log
from eigenscan.workbench.evaluation.models import build
from eigenscan.workbench.evaluation.protocols import Bench, global_localization, judgeable, single_scans
from eigenscan.workbench.evaluation.reference import Trajectory, read_trajectory
from eigenscan.workbench.evaluation.windows import plan_scans, plan_windows, read_times, read_windows, thin
from eigenscan.workbench.evaluation.workers import Workers
from eigenscan.workbench.logs import LogOptions
from evaluate import CASES, DATASETS, Case

LOGS = ("intel", "jarvis")
STEPS: Mapping[str, tuple[str, ...]] = {
    "as in the paper": (),
    "interpolation by the enclosing volume": ("projector.interpolation",),
    "ranges on a ring": ("mapbuilder.embedding",),
    "16 components": ("mapbuilder.components",),
    "nearest poses": ("projector.association", "projector.margin"),
    "verified and refined on the walls": (
        "projector.verification",
        "projector.obstacles",
        "projector.published",
    ),
    "the mixture tracks (default)": (
        "tracker.method",
        "tracker.grid_spacing",
        "tracker.grid_step",
        "tracker.max_tracks",
    ),
}
"""What each row changes from the paper's setting to the default's."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--datasets", type=Path, default=DATASETS, help="folder that holds the datasets")
    parser.add_argument("--windows", type=int, default=4, help="at most so many windows of a log")
    parser.add_argument("--scans", type=int, default=60, help="at most so many single scans of a log")
    parser.add_argument("--jobs", type=int, default=1, help="processes side by side")
    parser.add_argument("--json", type=Path, help="write all figures here")
    given = parser.parse_args()
    found: dict[str, Any] = {name: {} for name in STEPS}
    for case in CASES:
        if case.name in LOGS:
            for name, figures in _of_log(case, given):
                found[name][case.name] = figures
                print(f"{case.name}, {name}: {json.dumps(figures)}", flush=True)
    if given.json:
        given.json.write_text(json.dumps({"rows": found}, indent=1) + "\n", encoding="utf-8")


def settings_of(row: str) -> PipelineSettings:
    """Settings of a row: the paper's, but for what it and the rows before it change."""
    rows = list(STEPS)
    changed = {field for name in rows[: rows.index(row) + 1] for field in STEPS[name]}
    left = [
        f"{service}.{name}={value}"
        for service, table in METHODS["paper"].items()
        for name, value in table.items()
        if f"{service}.{name}" not in changed
    ]
    return chosen(Choices.of("default", None, left, SERVICES))


def _of_log(case: Case, given: argparse.Namespace) -> Any:
    folder = given.datasets / case.folder
    log = read_log(folder / case.log, LogOptions(), lambda _: None)
    reference = read_trajectory(folder / case.reference, 0.0).restamped(log.logged)
    for name in STEPS:
        settings = settings_of(name)
        built = build(folder / "map.yaml", settings.mapbuilder, lambda _: None)
        with Workers(given.jobs, built.models, log.beginning, settings) as workers:
            yield name, _figures(Bench(log, reference, workers, lambda *_: lambda: None), folder, given)


def _figures(bench: Bench, folder: Path, given: argparse.Namespace) -> dict[str, Any]:
    windows, times = _asked(bench.log, bench.reference, folder)
    driven = global_localization(
        bench, thin(judgeable(bench.log, bench.reference, windows), given.windows), None
    )
    alone = single_scans(bench, thin(times, given.scans), None)
    return {
        "windows": driven["windows"],
        "success_rate": driven["success_rate"],
        "false_claim_rate": driven["false_claim_rate"],
        "single_scans": alone["n"],
        "top1": alone["top1"],
        "in_list": alone["in_list"],
        "list_length": alone["list_length"],
        "cpu_ms": driven["cpu_ms_per_scan"]["median"],
    }


def _asked(log: Log, reference: Trajectory, folder: Path) -> tuple[Any, Any]:
    windows, scans = folder / "windows.csv", folder / "single_scans.csv"
    return (
        read_windows(windows, 0.0) if windows.exists() else plan_windows(log.scans, reference),
        read_times(scans, 0.0) if scans.exists() else plan_scans(log.scans, reference),
    )


if __name__ == "__main__":
    main()
