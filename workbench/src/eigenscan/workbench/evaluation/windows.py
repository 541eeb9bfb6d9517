"""Selects parts of a log: windows for global localization, and single scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import InvalidOperation
from pathlib import Path
from typing import TypeVar

import numpy as np
from eigenscan.workbench.evaluation.reference import (
    NS,
    EvaluationError,
    Trajectory,
    nanoseconds_of,
    read_lines,
)
from numpy.typing import NDArray

T = TypeVar("T")

EVERY_S, LONGEST_S, FURTHEST_M = 10.0, 60.0, 30.0
SINGLE_SCANS = 100


@dataclass(frozen=True)
class Window:
    """A stretch of the log, both ends included; ns."""

    start: int
    end: int

    def holds(self, stamp: int) -> bool:
        """Whether `stamp` lies in it."""
        return self.start <= stamp <= self.end


def read_windows(path: Path, offset_s: float = 0.0) -> list[Window]:
    """Windows of a CSV with columns start_time,end_time in seconds. Raises EvaluationError."""
    shift = round(offset_s * NS)
    windows = []
    for number, (start, end) in _rows(path, ("start_time", "end_time")):
        if end <= start:
            raise EvaluationError(f"{path}: line {number}: end_time is not after start_time")
        windows.append(Window(start + shift, end + shift))
    return windows


def read_times(path: Path, offset_s: float = 0.0) -> list[int]:
    """Stamps, ns, of a CSV with the column time in seconds. Raises EvaluationError."""
    shift = round(offset_s * NS)
    return [time + shift for _, (time,) in _rows(path, ("time",))]


def _rows(path: Path, columns: tuple[str, ...]) -> list[tuple[int, list[int]]]:
    rows: list[tuple[int, list[int]]] = []
    order = list(range(len(columns)))
    for number, line in enumerate(read_lines(path), start=1):
        fields = [field.strip() for field in line.split(",")]
        if not any(fields) or line.startswith("#"):
            continue
        if not rows and set(columns) <= set(fields):
            order = [fields.index(column) for column in columns]
            continue
        try:
            rows.append((number, [nanoseconds_of(fields[index]) for index in order]))
        except (InvalidOperation, IndexError):
            raise EvaluationError(
                f"{path}: line {number}: {line.strip()[:60]!r}: give {','.join(columns)} in seconds"
            ) from None
    if not rows:
        raise EvaluationError(f"{path}: no row in it: give {','.join(columns)} in seconds")
    return rows


def plan_windows(scans: NDArray[np.int64], reference: Trajectory) -> list[Window]:
    """A start every 10 s with scans and a reference; 30 m or 60 s each, whichever ends first.

    `scans` (n,): stamps, ns. A window that the log's end cuts shorter than 10 s is left out, unless it is the
    only one.
    """
    _, known = reference.at(scans)
    judged = np.sort(scans[known])
    if not len(judged):
        return []
    first, last = int(judged[0]), int(judged[-1])
    way = reference.travelled(judged)
    windows = []
    for start in range(first, last, round(EVERY_S * NS)):
        begin = np.searchsorted(judged, start)
        far = np.searchsorted(way, way[begin] + FURTHEST_M)
        end = min(start + round(LONGEST_S * NS), int(judged[far]) if far < len(judged) else last)
        windows.append(Window(start, end))
    long_enough = [window for window in windows if last - window.start >= EVERY_S * NS]
    return long_enough or windows[:1]


def plan_scans(scans: NDArray[np.int64], reference: Trajectory, count: int = SINGLE_SCANS) -> list[int]:
    """Up to `count` stamps, ns, spread evenly over the scans that have a reference."""
    _, known = reference.at(scans)
    judged = np.unique(scans[known])
    if not len(judged):
        return []
    chosen = np.unique(np.linspace(0, len(judged) - 1, min(count, len(judged))).round().astype(np.int64))
    return [int(stamp) for stamp in judged[chosen]]


def thin(items: Sequence[T], limit: int | None) -> list[T]:
    """At most `limit` of the items, evenly chosen."""
    if limit is None or len(items) <= limit:
        return list(items)
    chosen = np.linspace(0, len(items) - 1, limit).round().astype(np.int64)
    return [items[index] for index in chosen]
