"""The three protocols: windows, kidnap, single scans. They judge the runs, which see no reference."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from eigenscan.geometry.pose import from_message
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.evaluation.doubt import RULE, Walls, doubtful
from eigenscan.workbench.evaluation.exhaustive import Gallery, best_pose
from eigenscan.workbench.evaluation.figures import (
    Figures,
    kidnap_figures,
    single_figures,
    single_row,
    window_row,
    windows_figures,
)
from eigenscan.workbench.evaluation.kidnap import outcome, plan, splice
from eigenscan.workbench.evaluation.log import Log
from eigenscan.workbench.evaluation.metrics import (
    AT_LEAST,
    Judged,
    errors,
    judge,
    right,
    summary,
    write_poses,
)
from eigenscan.workbench.evaluation.oracle import decides, soon_after
from eigenscan.workbench.evaluation.reference import NS, Trajectory
from eigenscan.workbench.evaluation.reported import Reported
from eigenscan.workbench.evaluation.windows import Window
from eigenscan.workbench.evaluation.workers import Workers
from numpy.typing import NDArray

NEAREST_S = 1.0
"""A single scan is looked for this far around the time asked for."""
EXHAUSTIVE_BUDGET = 1e12
"""Comparisons of beams (positions x headings x beams x scans) that the exhaustive reference may cost."""


class Progress(Protocol):
    """Shows how far a list of runs is."""

    def __call__(self, title: str, total: int) -> Callable[[], None]:
        """Starts a bar; the function given back moves it by one."""
        ...


@dataclass(frozen=True)
class Bench:
    """Inputs that all protocols share."""

    log: Log
    reference: Trajectory
    workers: Workers
    progress: Progress
    walls: Walls | None = None
    """of the map, to find doubtful references"""


def judgeable(log: Log, reference: Trajectory, windows: Iterable[Window]) -> list[Window]:
    """The windows that hold enough scans with a reference."""
    return [
        window for window in windows if np.count_nonzero(reference.at(log.scan_stamps(window))[1]) >= AT_LEAST
    ]


def global_localization(bench: Bench, windows: Sequence[Window], poses: Path | None = None) -> Figures:
    """Cold starts at each window; `poses`: a file for all that was published."""
    advance = bench.progress("windows", len(windows))
    judged, rows, cpu, streams, explained = [], [], [], [], []
    reported = Reported()
    runs = bench.workers.runs(bench.log.between(window) for window in windows)
    for window, run in zip(windows, runs, strict=True):
        judged.append(judge(run.stream, bench.reference))
        rows.append(window_row(window, judged[-1], run.cpu_ms))
        cpu.append(run.cpu_ms)
        explained.append(run.explained)
        streams.append(run.stream)
        reported.add(run.reported)
        rows[-1]["reference_in_doubt"] = _in_doubt(bench, window, judged[-1])
        advance()
    if poses:
        write_poses(poses, streams)
    doubts = [row["reference_in_doubt"] for row in rows]
    return windows_figures(judged, rows) | {
        "reported": reported.figures(),
        "reference_in_doubt": {"claims": sum(doubts), "windows": sum(map(bool, doubts)), "rule": RULE},
        "map_explains": summary(np.concatenate([np.empty(0), *explained]), 5),
        "cpu_ms_per_scan": summary(np.concatenate([np.empty(0), *cpu]), 99),
        "per_window": rows,
    }


def _in_doubt(bench: Bench, window: Window, judged: Judged) -> int:
    """How many of a window's false claims the scans support."""
    if bench.walls is None or not judged.false_claims.any():
        return 0
    scans = [each for each in bench.log.between(window) if each.channel == SCAN_RAW]
    return sum(1 for _ in doubtful(judged, scans, bench.walls))


def kidnapping(bench: Bench, windows: Sequence[Window]) -> Figures:
    """Each window with a jump to another one in its middle."""
    splices, afters = [], []
    for planned in plan(windows, bench.reference):
        before, after = bench.log.between(planned.before), bench.log.between(planned.after)
        if len(bench.log.scan_stamps(planned.before)) and len(bench.log.scan_stamps(planned.after)):
            splices.append(splice(before, after))
            afters.append(after)
    advance = bench.progress("kidnaps", 2 * len(splices))
    outcomes = []
    for spliced, run in zip(splices, bench.workers.runs(s.received for s in splices), strict=True):
        outcomes.append(outcome(run.stream, spliced, bench.reference))
        advance()
    for number, (spliced, after) in enumerate(zip(splices, afters, strict=True)):
        if bench.walls is not None:
            scans = soon_after(after, spliced.jump - spliced.moved)
            decided = decides(scans, bench.workers.answers, bench.reference, bench.walls)
            outcomes[number] = replace(outcomes[number], decided=decided)
        advance()
    return kidnap_figures(outcomes)


def single_scans(bench: Bench, times: Sequence[int], shown: Gallery | None) -> Figures:
    """Scans alone: no prior, no odometry, no tracking; and the exhaustive comparison of the same scans."""
    scans = [scan for scan in (bench.log.nearest_scan(time, NEAREST_S) for time in times) if scan is not None]
    truths, known = bench.reference.at([scan.stamp for scan in scans])
    chosen = [(scan, truth) for scan, truth, there in zip(scans, truths, known, strict=True) if there]
    advance = bench.progress("single scans", len(chosen))
    rows = []
    answers = bench.workers.answers(scan.envelope for scan, _ in chosen)
    for (scan, truth), answer in zip(chosen, answers, strict=True):
        lidar = scan.envelope.address["lidar"]
        rows.append(single_row(scan.stamp / NS, lidar, answer.poses, truth, answer.cpu_ms))
        advance()
    if shown is not None:
        _search_all(bench, [(scan.envelope, truth) for scan, truth in chosen], shown, rows)
    return single_figures(rows)


def _search_all(
    bench: Bench,
    scans: Sequence[tuple[Envelope, NDArray[np.float64]]],
    shown: Gallery,
    rows: Sequence[Figures],
) -> None:
    """Adds the exhaustive comparison to the rows; on a large map only to some, evenly chosen."""
    if not scans:
        return
    widest = max(len(scan.open(RawScan).ranges) for scan, _ in scans)
    affordable = int(EXHAUSTIVE_BUDGET // (len(shown.positions) * shown.beams * max(widest, 1)))
    count = min(len(scans), max(affordable, 1))
    chosen = np.linspace(0, len(scans) - 1, count).round().astype(np.int64)
    advance = bench.progress("exhaustive", count)
    seen: dict[float, Gallery] = {}
    for index in chosen:
        envelope, truth = scans[index]
        canonical = bench.log.canonical(envelope)
        if canonical is not None:
            ranges = np.asarray(canonical.ranges, dtype=np.float64)
            beams = np.arange(len(ranges), dtype=np.float64)
            directions = canonical.angle_min + canonical.angle_increment * beams
            mount = from_message(canonical.mount)
            reach = canonical.range_max
            if reach not in seen:
                seen[reach] = shown.up_to(reach)
                best_pose(shown.first(), ranges, directions, mount)  # compile before the clock counts
            before = time.process_time()
            pose = best_pose(seen[reach], ranges, directions, mount)
            rows[index]["exhaustive_cpu_ms"] = (time.process_time() - before) * 1e3
            rows[index]["exhaustive"] = pose is not None and bool(right(*errors(pose[None], truth[None]))[0])
        advance()
