"""Poses that any program claims, judged by the same protocols as the pipeline's.

A CSV with a header: `stamp` (s), `x`, `y` (m) and `heading` (rad) of the base in the map frame, a row for
each pose. Optional: `confidence` (0..1, the probability that the pose is right), `localized` (1: claimed, the
default; 0: published, not claimed), `window` (the run: 7 or window-7 for a cold start, kidnap-7 for a
kidnap), `cpu_ms` (CPU time for the pose's scan). Other columns are ignored. A TUM file is taken too.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import InvalidOperation
from pathlib import Path

import numpy as np
from eigenscan.runtime.recording import RecordingWriter
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, STATE_UNSPECIFIED
from eigenscan.workbench.evaluation.figures import Figures, kidnap_figures, window_row, windows_figures
from eigenscan.workbench.evaluation.kidnap import Splice, outcome, plan, splice
from eigenscan.workbench.evaluation.log import Log
from eigenscan.workbench.evaluation.metrics import Stream, filled, judge, summary
from eigenscan.workbench.evaluation.reference import (
    NS,
    EvaluationError,
    Trajectory,
    nanoseconds_of,
    read_lines,
    read_trajectory,
)
from eigenscan.workbench.evaluation.windows import Window
from numpy.typing import NDArray

REQUIRED = ("stamp", "x", "y", "heading")
OPTIONAL = ("confidence", "localized", "window", "cpu_ms")
RUN = re.compile(r"(?:(window|kidnap)-)?(\d+)")
LARGEST_HEADING = 2 * np.pi
"""rad; anything larger is most likely in degrees."""


@dataclass(frozen=True)
class Claim:
    """One row: `stamp` ns, `pose` (x, y, heading), NaN for missing values; `run` "" for any run."""

    run: str
    stamp: int
    pose: tuple[float, float, float]
    confidence: float
    is_localized: bool
    cpu_ms: float


def read_claims(path: Path, offset_s: float = 0.0) -> list[Claim]:
    """All rows of a CSV or TUM file, `offset_s` added to the stamps.

    Raises EvaluationError naming file, line, field and fix.
    """
    lines = read_lines(path)
    numbered = [(n, line) for n, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if not numbered:
        raise EvaluationError(f"{path}: no pose in it: give the header {','.join(REQUIRED)} and a row a pose")
    header = [name.strip() for name in numbered[0][1].lstrip("\ufeff").split(",")]
    if not set(header) & {*REQUIRED, *OPTIONAL}:
        if "," in numbered[0][1]:
            raise EvaluationError(
                f"{path}: line {numbered[0][0]}: no header: begin with {','.join(REQUIRED)}, or give TUM"
            )
        found = read_trajectory(path, offset_s)
        return [
            Claim("", stamp, (x, y, heading), float("nan"), True, float("nan"))
            for stamp, (x, y, heading) in zip(found.stamps.tolist(), found.poses.tolist(), strict=True)
        ]
    for name in REQUIRED:
        if name not in header:
            raise EvaluationError(f"{path}: line {numbered[0][0]}: column {name} is missing: {_columns()}")
    claims = []
    for number, line in numbered[1:]:
        cells = next(csv.reader([line]))
        if len(cells) != len(header):
            raise EvaluationError(
                f"{path}: line {number}: {len(cells)} columns, the header has {len(header)}: give each column"
            )
        row = _Row(path, number, dict(zip(header, (cell.strip() for cell in cells), strict=True)))
        claims.append(row.claim(offset_s))
    if not claims:
        raise EvaluationError(f"{path}: the header alone: add a row for each pose")
    return claims


def _columns() -> str:
    return f"give {','.join(REQUIRED)} and, if known, {','.join(OPTIONAL)}"


@dataclass(frozen=True)
class _Row:
    path: Path
    number: int
    cells: dict[str, str]

    def claim(self, offset_s: float) -> Claim:
        try:
            stamp = nanoseconds_of(self.cells["stamp"]) + round(offset_s * NS)
        except InvalidOperation:
            raise self._wrong("stamp", "give seconds, such as 12.345") from None
        heading = self._number("heading", "give radians, such as 1.57")
        if abs(heading) > LARGEST_HEADING:
            raise self._wrong("heading", "give radians between -pi and pi")
        confidence = self._number("confidence", "give a probability, 0 to 1, or leave it empty", float("nan"))
        if not (np.isnan(confidence) or 0.0 <= confidence <= 1.0):
            raise self._wrong("confidence", "give a probability, 0 to 1, or leave it empty")
        localized = self.cells.get("localized") or "1"
        if localized not in ("0", "1"):
            raise self._wrong("localized", "give 1 for a claim, 0 for none")
        return Claim(
            self._run(),
            stamp,
            (self._number("x", "give metres"), self._number("y", "give metres"), heading),
            confidence,
            localized == "1",
            self._number("cpu_ms", "give milliseconds, or leave it empty", float("nan")),
        )

    def _run(self) -> str:
        text = self.cells.get("window", "")
        if not text:
            return ""
        found = RUN.fullmatch(text)
        if not found:
            raise self._wrong("window", "give 7 or window-7 for a cold start, kidnap-7 for a kidnap")
        return f"{found[1] or 'window'}-{int(found[2])}"

    def _number(self, name: str, fix: str, default: float | None = None) -> float:
        text = self.cells.get(name, "")
        if not text and default is not None:
            return default
        try:
            value = float(text)
        except ValueError:
            raise self._wrong(name, fix) from None
        if not np.isfinite(value):
            raise self._wrong(name, fix)
        return value

    def _wrong(self, name: str, fix: str) -> EvaluationError:
        return EvaluationError(
            f"{self.path}: line {self.number}, field {name}: {self.cells.get(name, '')[:40]!r}: {fix}"
        )


def restamped(claims: Sequence[Claim], logged: Mapping[int, int]) -> list[Claim]:
    """Gives claims without a run the stamps of the log as read, which may differ from the logged ones.

    `logged`: the logged stamp, ns, by the stamp as read. Saved runs have the latter already.
    """
    given = {old: new for new, old in logged.items()}
    return [
        claim if claim.run else replace(claim, stamp=given.get(claim.stamp, claim.stamp)) for claim in claims
    ]


def kidnaps_of(log: Log, windows: Sequence[Window], reference: Trajectory) -> Iterator[tuple[str, Splice]]:
    """Each kidnap of a log by its name, as `evaluate --kidnap` plays it."""
    for index, planned in enumerate(plan(windows, reference)):
        before, after = log.between(planned.before), log.between(planned.after)
        if len(log.scan_stamps(planned.before)) and len(log.scan_stamps(planned.after)):
            yield f"kidnap-{index}", splice(before, after)


def save_runs(
    folder: Path, log: Log, windows: Sequence[Window], reference: Trajectory, *, kidnap: bool
) -> list[Path]:
    """Writes the input of a program for each run: window-0.mcap and so on, and kidnap-0.mcap on request."""
    folder.mkdir(parents=True, exist_ok=True)
    runs = [(f"window-{index}", log.between(window)) for index, window in enumerate(windows)]
    if kidnap:
        runs += [(name, spliced.received) for name, spliced in kidnaps_of(log, windows, reference)]
    written = []
    for name, envelopes in runs:
        written.append(folder / f"{name}.mcap")
        with RecordingWriter(written[-1]) as writer:
            for envelope in envelopes:
                writer.write(envelope, envelope.stamp)
    return written


def judge_claims(
    path: Path,
    claims: Sequence[Claim],
    log: Log,
    windows: Sequence[Window],
    reference: Trajectory,
    *,
    kidnap: bool,
) -> Figures:
    """The figures of claims, like those of the pipeline's own poses; None for values that the table lacks.

    Kidnaps are judged if `claims` has any. Raises EvaluationError for unknown runs, if kidnaps are asked for
    and there are none, or if no row lies in a window.
    """
    has_kidnaps = any(claim.run.startswith("kidnap") for claim in claims)
    if kidnap and not has_kidnaps:
        raise EvaluationError(
            f"{path}: has no kidnap run, such as kidnap-7 in its column window: leave --kidnap out"
        )
    kidnaps = dict(kidnaps_of(log, windows, reference)) if has_kidnaps else {}
    names = {"", *(f"window-{index}" for index in range(len(windows))), *kidnaps}
    for claim in claims:
        if claim.run not in names:
            raise EvaluationError(
                f"{path}: window {claim.run}: choose one of window-0 to window-{len(windows) - 1}"
                + (f" and kidnap-0 to kidnap-{len(kidnaps) - 1}" if kidnaps else "")
            )
    judged, rows, cpu = [], [], []
    for index, window in enumerate(windows):
        mine = [c for c in claims if c.run in ("", f"window-{index}") and window.holds(c.stamp)]
        scans = log.scan_stamps(window)
        judged.append(judge(stream_of(mine, scans), reference))
        cpu.append(_known([c.cpu_ms for c in mine]))
        row = window_row(window, judged[-1], cpu[-1])
        rows.append(row | {"scans": len(scans), "ambiguous_share": None, "lost_share": None})
    if not any(window.holds(claim.stamp) for claim in claims for window in windows):
        stamps = [claim.stamp for claim in claims]
        raise EvaluationError(
            f"{path}: no stamp within a window: {min(stamps) / NS:.3f} to {max(stamps) / NS:.3f} s, but the "
            f"windows are {windows[0].start / NS:.3f} to {windows[-1].end / NS:.3f} s: give the log's stamps"
        )
    outcomes = [
        outcome(stream_of([c for c in claims if c.run == name], _spliced_scans(spliced)), spliced, reference)
        for name, spliced in kidnaps.items()
    ]
    return windows_figures(judged, rows) | {
        "map_explains": {"median": None, "p5": None},
        "cpu_ms_per_scan": summary(np.concatenate([np.empty(0), *cpu]), 99),
        "kidnap": kidnap_figures(outcomes) if kidnaps else None,
        "per_window": rows,
    }


def stream_of(claims: Sequence[Claim], scans: NDArray[np.int64]) -> Stream:
    """Claims by stamp, and what is missing of the `scans` (n,), ns: see `filled`."""
    rows = sorted(claims, key=lambda claim: claim.stamp)
    stamps = np.array([claim.stamp for claim in rows], dtype=np.int64)
    confidence = np.array([claim.confidence for claim in rows], dtype=np.float64)
    localized = np.array([claim.is_localized for claim in rows], dtype=np.bool_)
    stream = Stream(
        stamps=stamps,
        poses=np.array([claim.pose for claim in rows]).reshape(-1, 3),
        states=np.where(localized, STATE_LOCALIZED, STATE_UNSPECIFIED).astype(np.int64),
        localized=localized,
        tracked=np.isfinite(confidence),
        confidence=confidence,
        covariances=np.full((len(rows), 3, 3), np.nan),
        nis=np.full(len(rows), np.nan),
        cpu_s=np.cumsum([claim.cpu_ms for claim in rows]) / 1e3,
        scans=np.searchsorted(scans, stamps),
    )
    return filled(stream, scans)


def _spliced_scans(spliced: Splice) -> NDArray[np.int64]:
    return np.sort(np.array([e.stamp for e in spliced.received if e.channel == SCAN_RAW], dtype=np.int64))


def _known(values: Sequence[float]) -> NDArray[np.float64]:
    found = np.array(values, dtype=np.float64)
    return found[np.isfinite(found)]
