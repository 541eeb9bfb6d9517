"""Definitions of right poses and false claims, and the figures that follow.

A *claim* is a pose that the tracker calls localized. A pose is *right* within 0.5 m and 10 degrees of the
reference. Poses without a reference are not judged.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from eigenscan.geometry.circle import difference
from eigenscan.schemas.tracking_pb2 import STATE_UNSPECIFIED
from eigenscan.workbench.evaluation.reference import NS, Trajectory
from numpy.typing import ArrayLike, NDArray

WITHIN_M, WITHIN_RAD = 0.5, np.radians(10.0)
APART = 2.0
"""A pose is at another place from so many times what a right one may be off."""
AT_LEAST = 3
"""Scans that a run of right claims must last to count."""
LAST_SHARE = 1 / 3
"""Least share of a window's judged poses over which a successful start is right to the end.

Three right scans at the end of a minute are chance: by that rule half a map succeeded in 100 % of the
windows.
"""
BINS = 10
LONGEST_GAP_S = 1.0
"""A pose answers for the scans within this of it."""

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Summary = dict[str, float | None]


@dataclass(frozen=True)
class Stream:
    """The poses of one run, a row for each, in the order of publication.

    `stamps` ns; `poses` (n, 3) in the map frame; `states` as in the contract; `localized`: the state was
    LOCALIZED; `tracked`: the message had a pose; `confidence` 0..1; `covariances` (n, 3, 3); `nis`: the
    track's normalised innovation squared, NaN if the scan gave it no hypothesis; `cpu_s`: process time of the
    whole pipeline from the start to the publication; `scans`: number of the log's scans before the pose's
    own.
    """

    stamps: NDArray[np.int64]
    poses: Floats
    states: NDArray[np.int64]
    localized: Bools
    tracked: Bools
    confidence: Floats
    covariances: Floats
    nis: Floats
    cpu_s: Floats
    scans: NDArray[np.int64]

    def where(self, chosen: Bools) -> Stream:
        """The rows that are `chosen` (n,)."""
        return Stream(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})

    def __len__(self) -> int:
        return len(self.stamps)


def filled(stream: Stream, scans: NDArray[np.int64]) -> Stream:
    """The stream with a pose that is not claimed for each of the `scans` (n,), ns, that no pose answers for.

    Else a pipeline that falls silent would be right to the end by its last pose.
    """
    stamps = np.sort(stream.stamps)
    silent = scans[~_near(scans, stamps, round(LONGEST_GAP_S * NS))]
    if not len(silent):
        return stream
    n, unknown = len(silent), np.full(len(silent), np.nan)
    none = Stream(
        stamps=silent,
        poses=np.zeros((n, 3)),
        states=np.full(n, STATE_UNSPECIFIED, dtype=np.int64),
        localized=np.zeros(n, dtype=np.bool_),
        tracked=np.zeros(n, dtype=np.bool_),
        confidence=unknown,
        covariances=np.full((n, 3, 3), np.nan),
        nis=unknown,
        cpu_s=np.append(0.0, stream.cpu_s)[np.searchsorted(stamps, silent)],
        scans=np.searchsorted(scans, silent),
    )
    order = np.argsort(np.concatenate([stream.stamps, silent]), kind="stable")
    return Stream(
        **{name: np.concatenate([own, vars(none)[name]])[order] for name, own in vars(stream).items()}
    )


def _near(wanted: NDArray[np.int64], there: NDArray[np.int64], within: int) -> Bools:
    """Which of `wanted` (n,) have one of `there` (m,), increasing, at most `within` away; all ns."""
    if not len(there):
        return np.zeros(len(wanted), dtype=np.bool_)
    right = np.clip(np.searchsorted(there, wanted), 0, len(there) - 1)
    left = np.maximum(right - 1, 0)
    distance = np.minimum(np.abs(there[right] - wanted), np.abs(there[left] - wanted))
    near: Bools = distance <= within
    return near


@dataclass(frozen=True)
class Judged:
    """The poses of a run that have a reference, with their errors in metres and radians."""

    stream: Stream
    position_m: Floats
    heading_rad: Floats
    offsets: Floats
    metres: Floats

    @property
    def right(self) -> Bools:
        """Within 0.5 m and 10 degrees."""
        return right(self.position_m, self.heading_rad)

    @property
    def false_claims(self) -> Bools:
        """Claimed, and not right."""
        return self.stream.localized & ~self.right

    @property
    def elsewhere_claims(self) -> Bools:
        """Claimed at another place."""
        return self.stream.localized & elsewhere(self.position_m, self.heading_rad)

    @property
    def right_claims(self) -> Bools:
        """Claimed, and right."""
        return self.stream.localized & self.right

    @property
    def converged(self) -> int | None:
        """Row of the claim from which on, to the end, every pose is claimed and right; None: no success.

        That part must be LAST_SHARE of the poses at least.
        """
        found = sustained(self.right_claims)
        return None if found is None or found > (1 - LAST_SHARE) * len(self.stream) else found


def right(position_m: ArrayLike, heading_rad: ArrayLike) -> Bools:
    """Which errors (n,), m and rad, are within 0.5 m and 10 degrees; a NaN is not."""
    return _within(position_m, heading_rad, 1.0)


def elsewhere(position_m: ArrayLike, heading_rad: ArrayLike) -> Bools:
    """Which errors (n,), m and rad, are those of another place: over 1 m or 20 degrees; a NaN is."""
    return ~_within(position_m, heading_rad, APART)


def _within(position_m: ArrayLike, heading_rad: ArrayLike, times: float) -> Bools:
    near: Bools = np.less_equal(position_m, times * WITHIN_M) & np.less_equal(
        np.abs(heading_rad), times * WITHIN_RAD
    )
    return near


def errors(poses: Floats, truth: Floats) -> tuple[Floats, Floats]:
    """Distance in metres and absolute turn in radians between poses (n, 3)."""
    moved = poses[:, :2] - truth[:, :2]
    return np.hypot(moved[:, 0], moved[:, 1]), np.abs(difference(poses[:, 2], truth[:, 2]))


def judge(stream: Stream, reference: Trajectory) -> Judged:
    """Sets a run beside the reference; poses without a reference are left out."""
    _, known = reference.at(stream.stamps)
    kept = stream.where(known)
    truth, _ = reference.at(kept.stamps)
    position, heading = errors(kept.poses, truth)
    offsets = kept.poses - truth
    offsets[:, 2] = difference(kept.poses[:, 2], truth[:, 2])
    return Judged(kept, position, heading, offsets, reference.travelled(kept.stamps))


def sustained(held: Bools) -> int | None:
    """Start of the run of True that lasts to the end, if it is at least 3 long."""
    broken = np.flatnonzero(~held)
    start = int(broken[-1]) + 1 if len(broken) else 0
    return start if len(held) - start >= AT_LEAST else None


def summary(values: Iterable[float | None], upper: float = 95.0) -> Summary:
    """Median and `upper` percentile of the values that are not None; null without any."""
    there = np.asarray([value for value in values if value is not None], dtype=np.float64)
    there = there[np.isfinite(there)]
    name = f"p{upper:g}"
    if not len(there):
        return {"median": None, name: None}
    return {"median": float(np.median(there)), name: float(np.percentile(there, upper))}


def rate(marks: Sequence[bool] | Bools) -> float | None:
    """Share of True; null of nothing."""
    return float(np.mean(np.asarray(marks, dtype=np.float64))) if len(marks) else None


@dataclass(frozen=True)
class Bin:
    """Poses of similar confidence: number, mean confidence, and share that is right."""

    count: int
    confidence: float
    right: float


def calibration(confidence: Floats, correct: Bools, bins: int = BINS) -> list[Bin]:
    """The reliability diagram of poses (n,) over equal bins of 0..1; empty bins are left out."""
    which = np.clip((np.clip(confidence, 0.0, 1.0) * bins).astype(np.int64), 0, bins - 1)
    found = []
    for index in np.unique(which):
        inside = which == index
        found.append(Bin(int(inside.sum()), float(confidence[inside].mean()), float(correct[inside].mean())))
    return found


def pooled(diagrams: list[list[Bin]]) -> list[Bin]:
    """One diagram of all poses of several."""
    merged = []
    for index in range(BINS):
        inside = [b for bins in diagrams for b in bins if min(int(b.confidence * BINS), BINS - 1) == index]
        count = sum(b.count for b in inside)
        if count:
            published = sum(b.count * b.confidence for b in inside) / count
            right = sum(b.count * b.right for b in inside) / count
            merged.append(Bin(count, published, right))
    return merged


def calibration_error(diagram: Sequence[Bin]) -> float | None:
    """Expected calibration error: mean |confidence - share of right poses|, weighted by count."""
    total = sum(entry.count for entry in diagram)
    if not total:
        return None
    return sum(entry.count * abs(entry.confidence - entry.right) for entry in diagram) / total


def normalised_errors(offsets: Floats, covariances: Floats) -> Floats:
    """Normalised error squared (n,) of offsets (n, 3); NaN where a covariance (n, 3, 3) is singular."""
    from filterpy.stats import NEES  # takes a second to import

    result = np.full(len(offsets), np.nan)
    sound = np.asarray(np.isfinite(covariances).all(axis=(1, 2)), dtype=np.bool_)
    sound[sound] = np.linalg.det(covariances[sound]) > 0
    # the headings of offsets are shortest turns already
    result[sound] = NEES(offsets[sound], np.zeros((np.count_nonzero(sound), 3)), covariances[sound])
    return result


def seconds(stamps: NDArray[np.int64], since: int) -> Floats:
    """Seconds from `since` to each stamp, both ns."""
    return (stamps - since) / NS


POSE_COLUMNS = ("window", "stamp", "x", "y", "heading", "confidence", "localized", "state")


def write_poses(path: Path, streams: Sequence[Stream]) -> None:
    """Writes a row for each pose, as `evaluate --poses` reads it; s, m, rad, exact; `window` counts from 0.

    `confidence` is empty for a pose without a track.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(POSE_COLUMNS)
        for number, stream in enumerate(streams):
            for row in range(len(stream)):
                seconds_, rest = divmod(int(stream.stamps[row]), NS)
                confidence = repr(float(stream.confidence[row])) if stream.tracked[row] else ""
                table.writerow(
                    [
                        *(number, f"{seconds_}.{rest:09d}", *map(repr, stream.poses[row].tolist())),
                        *(confidence, int(stream.localized[row]), int(stream.states[row])),
                    ]
                )
