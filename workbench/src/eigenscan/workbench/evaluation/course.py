"""One evaluation from files to figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.workbench.evaluation.chosen import PipelineSettings
from eigenscan.workbench.evaluation.claims import judge_claims, read_claims, restamped, save_runs
from eigenscan.workbench.evaluation.doubt import Walls
from eigenscan.workbench.evaluation.figures import Figures, finite
from eigenscan.workbench.evaluation.log import Log, read_log
from eigenscan.workbench.evaluation.models import Built, build, gallery_of
from eigenscan.workbench.evaluation.own_reference import RECORDED, WHOLE_DRIVE, recorded_truth, whole_drive
from eigenscan.workbench.evaluation.protocols import (
    Bench,
    global_localization,
    judgeable,
    kidnapping,
    single_scans,
)
from eigenscan.workbench.evaluation.reference import NS, EvaluationError, Trajectory, read_trajectory
from eigenscan.workbench.evaluation.reported import Reported
from eigenscan.workbench.evaluation.windows import (
    Window,
    plan_scans,
    plan_windows,
    read_times,
    read_windows,
    thin,
)
from eigenscan.workbench.evaluation.workers import Workers, model_mb
from eigenscan.workbench.logs import LogOptions
from eigenscan.workbench.progress import Bars
from numpy.typing import NDArray


@dataclass(frozen=True)
class Task:
    """An evaluation: inputs, protocols and limits."""

    log: Path
    map: Path
    reference: Path | None
    """TUM; without it the log's own truth, or else the drive taken as a whole."""
    windows: Path | None
    single_scans: Path | None
    kidnap: bool
    skip: frozenset[str]
    offset_s: float
    limit: int | None
    jobs: int
    poses: Path | None
    options: LogOptions
    settings: PipelineSettings


def evaluate(task: Task, bars: Bars) -> Figures:
    """All figures. Raises EvaluationError, LogError or MapError for bad input."""
    reference = (
        read_trajectory(task.reference, task.offset_s)
        if task.reference
        else recorded_truth(task.log, task.options.robot)
    )
    windows = read_windows(task.windows, task.offset_s) if task.windows else None
    times = read_times(task.single_scans, task.offset_s) if task.single_scans else None
    log = read_log(task.log, task.options, bars.start_share("log"))
    if "windows" not in task.skip:
        _check_count(task, log)
    if reference is not None:
        reference = reference.restamped(log.logged)
        _check_overlap(task, log, reference)
    built = build(task.map, task.settings.mapbuilder, bars.start_share("model"))
    with Workers(task.jobs, built.models, log.beginning, task.settings) as workers:
        source, reported = str(task.reference) if task.reference else RECORDED, Reported()
        if reference is None:
            source = WHOLE_DRIVE
            reference, reported = whole_drive(task.log, log, workers)
        if windows is None:
            windows = plan_windows(log.scans, reference)
        if times is None:
            times = plan_scans(log.scans, reference)
        walls = Walls(DistanceField.of(built.site.grid), log.canonical)
        bench = Bench(log, reference, workers, bars.start, walls)
        figures = _figures(task, bench, built, windows, times)
        # the windows are stretches of the drive: what they had says more
        found = figures["reported"] or {words: row | {"runs": 0} for words, row in reported.figures().items()}
        return finite({"reference": source} | figures | {"reported": found})


@dataclass(frozen=True)
class ClaimsTask:
    """An evaluation of any program's claims, or only the export of its runs."""

    log: Path
    poses: Path | None
    """CSV or TUM of the claims."""
    runs: Path | None
    """Folder to write the runs to."""
    reference: Path | None
    windows: Path | None
    kidnap: bool
    offset_s: float
    limit: int | None
    options: LogOptions


def evaluate_claims(task: ClaimsTask, bars: Bars) -> Figures:
    """Figures of claims, without those of the pipeline; or how many runs were written.

    Raises EvaluationError or LogError for bad input.
    """
    claims = read_claims(task.poses) if task.poses else []
    reference = (
        read_trajectory(task.reference, task.offset_s)
        if task.reference
        else recorded_truth(task.log, task.options.robot)
    )
    if reference is None:
        raise EvaluationError(f"{task.log}: has no reference in it: give --ground-truth REF.tum")
    windows = read_windows(task.windows, task.offset_s) if task.windows else None
    log = read_log(task.log, task.options, bars.start_share("log"))
    _check_count(task, log)
    reference, claims = reference.restamped(log.logged), restamped(claims, log.logged)
    _check_overlap(task, log, reference)
    asked = windows if windows is not None else plan_windows(log.scans, reference)
    chosen = thin(judgeable(log, reference, asked), task.limit)
    if not chosen:
        raise _no_window(task, log, reference)
    if task.runs:
        return {
            "runs": [str(file) for file in save_runs(task.runs, log, chosen, reference, kidnap=task.kidnap)]
        }
    assert task.poses is not None
    figures = judge_claims(task.poses, claims, log, chosen, reference, kidnap=task.kidnap)
    source = str(task.reference) if task.reference else RECORDED
    return finite(
        {"reference": source, "poses": str(task.poses)}
        | figures
        | {"windows_left_out": len(asked) - len(chosen), "single_scan": None, "peak_rss_mb": None}
        | {"map_m2": None, "model": None, "log": _log_figures(log), "reported": {}}
    )


def _figures(
    task: Task, bench: Bench, built: Built, asked: Sequence[Window], times: Sequence[int]
) -> Figures:
    windows = thin(judgeable(bench.log, bench.reference, asked), task.limit)
    if not windows and "windows" not in task.skip:
        raise _no_window(task, bench.log, bench.reference)
    figures = global_localization(bench, [] if "windows" in task.skip else windows, task.poses)
    kidnap = kidnapping(bench, windows) if task.kidnap else None
    peak = bench.workers.peak_mb
    single = None
    if "single-scans" not in task.skip:
        shown = None if "exhaustive" in task.skip else gallery_of(built)
        single = single_scans(bench, thin(times, task.limit), shown)
    weight = None if "memory" in task.skip else model_mb(built.models, bench.log.beginning, task.settings)
    return figures | {
        "windows_left_out": len(asked) - len(windows),
        "kidnap": kidnap,
        "single_scan": single,
        "peak_rss_mb": peak,
        "map_m2": built.map_m2,
        "model": built.figures | {"memory_mb": weight},
        "log": _log_figures(bench.log),
    }


def _log_figures(log: Log) -> Figures:
    return {
        "scans": len(log.scans),
        "lidars": log.lidars,
        "odometry": log.odometry,
        "is_cut": log.is_cut,
        "damage": log.damage,
        "set_aside": log.set_aside,
        "span_s": float((log.scans.max() - log.scans.min()) / NS),
    }


def _no_window(task: Task | ClaimsTask, log: Log, reference: Trajectory) -> EvaluationError:
    return EvaluationError(
        f"{task.windows or task.log}: no window holds 3 scans with a reference: check its stamps against "
        f"{task.reference or 'the reference'} ({_span(reference.stamps)}) and the log ({_span(log.scans)})"
    )


def _check_count(task: Task | ClaimsTask, log: Log) -> None:
    """Raises EvaluationError if no window can have scans enough."""
    if (count := len(log.scans)) < 3:
        raise EvaluationError(f"{task.log}: the log has {count} scan{'s' * (count > 1)}; 3 are needed")


def _check_overlap(task: Task | ClaimsTask, log: Log, reference: Trajectory) -> None:
    """Raises EvaluationError if no scan has a reference."""
    if not reference.at(log.scans)[1].any():
        raise EvaluationError(
            f"{task.reference}: covers {_span(reference.stamps)}, but the scans of {task.log} are from "
            f"{_span(log.scans)}: give the reference of this log, or --reference-offset SECONDS"
        )


def _span(stamps: NDArray[np.int64]) -> str:
    return f"{stamps.min() / NS:.3f} to {stamps.max() / NS:.3f} s"
