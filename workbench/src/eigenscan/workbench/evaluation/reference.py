"""The reference trajectory that judges; the pipeline never sees it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from functools import cached_property
from pathlib import Path

import numpy as np
from eigenscan.geometry.circle import difference, wrap
from eigenscan.geometry.pose import FARTHEST_M
from eigenscan.schemas.envelope import LATEST_S
from numpy.typing import ArrayLike, NDArray

NS = 1_000_000_000

LONGEST_GAP_S = 1.0
"""Between references further apart than this nothing is known, unless the robot stood still."""
STILL_M, STILL_RAD = 0.05, np.radians(2.0)
EDGE_S = 0.05
"""Stamps this far outside the trajectory take its end, because writers round stamps, s."""
STEP_M = 0.02
"""Path length counts in steps of at least this: the jitter of a standing robot is no way."""


class EvaluationError(ValueError):
    """An input that cannot be evaluated; the message names the file, the field and the fix."""


@dataclass(frozen=True)
class Trajectory:
    """Poses of the robot's base in the map frame: `stamps` (n,) ns, increasing; `poses` (n, 3)."""

    stamps: NDArray[np.int64]
    poses: NDArray[np.float64]

    def at(self, stamps: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Poses (m, 3) at `stamps` (m,) ns, and which of them are known (m,).

        Linear between neighbours, headings on the shorter arc.
        """
        wanted = np.asarray(stamps, dtype=np.int64)
        clipped = np.clip(wanted, self.stamps[0], self.stamps[-1])
        right = np.clip(np.searchsorted(self.stamps, clipped), min(1, len(self.stamps) - 1), None)
        left = np.maximum(right - 1, 0)
        gap = self.stamps[right] - self.stamps[left]
        part = ((clipped - self.stamps[left]) / np.maximum(gap, 1))[:, None]
        a, b = self.poses[left], self.poses[right]
        poses = a + part * (b - a)
        turn = difference(b[:, 2], a[:, 2])
        poses[:, 2] = wrap(a[:, 2] + part[:, 0] * turn)
        still = (np.hypot(*(b - a)[:, :2].T) < STILL_M) & (np.abs(turn) < STILL_RAD)
        on_stamp = (clipped == self.stamps[left]) | (clipped == self.stamps[right])
        inside = np.abs(wanted - clipped) <= EDGE_S * NS
        return poses, inside & (on_stamp | still | (gap <= LONGEST_GAP_S * NS))

    def restamped(self, logged: Mapping[int, int]) -> Trajectory:
        """The same poses with the stamps of the log as read, which may differ from the logged ones.

        `logged`: the logged stamp, ns, by the stamp as read.
        """
        given = {old: new for new, old in logged.items()}
        stamps = np.asarray([given.get(stamp, stamp) for stamp in self.stamps.tolist()], dtype=np.int64)
        unique, first = np.unique(stamps, return_index=True)
        return Trajectory(unique, self.poses[first])

    def travelled(self, stamps: ArrayLike) -> NDArray[np.float64]:
        """Way (m,) in metres that was driven up to each stamp, ns, from the trajectory's start."""
        return np.interp(np.asarray(stamps, dtype=np.int64), self._corners[0], self._corners[1])

    @cached_property
    def _corners(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        # thinned to steps of STEP_M; a plain loop, because each corner decides the next one
        kept, way = [0], [0.0]
        x, y = self.poses[0, :2]
        for index, (px, py) in enumerate(self.poses[:, :2].tolist()):
            step = float(np.hypot(px - x, py - y))
            if step >= STEP_M:
                kept.append(index)
                way.append(way[-1] + step)
                x, y = px, py
        return self.stamps[kept], np.asarray(way)


def nanoseconds_of(text: str) -> int:
    """Nanoseconds of a decimal number of seconds, without the rounding of a float."""
    value = Decimal(text)
    if not value.is_finite() or value.adjusted() > 10 or abs(value) > LATEST_S:
        raise InvalidOperation
    return int((value * NS).to_integral_value())


def read_trajectory(path: Path, offset_s: float = 0.0) -> Trajectory:
    """Trajectory of a TUM file (`t x y z qx qy qz qw`), `offset_s` seconds added to its stamps.

    Raises EvaluationError naming the file and the line.
    """
    stamps: list[int] = []
    poses: list[tuple[float, float, float]] = []
    for number, line in enumerate(read_lines(path), start=1):
        fields = line.replace(",", " ").split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            if len(fields) != 8:
                raise ValueError
            stamp = nanoseconds_of(fields[0])
            x, y, _, qx, qy, qz, qw = (float(field) for field in fields[1:])
            theta = np.arctan2(2 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
            near = abs(x) <= FARTHEST_M and abs(y) <= FARTHEST_M  # one by one: max passes over a NaN
            if not near or not np.isfinite(theta) or qx == qy == qz == qw == 0.0:
                raise ValueError
        except (ValueError, InvalidOperation):
            raise EvaluationError(
                f"{path}: line {number}: {line.strip()[:60]!r}: give t x y z qx qy qz qw, in s and m"
            ) from None
        stamps.append(stamp + round(offset_s * NS))
        poses.append((x, y, float(theta)))
    if not stamps:
        raise EvaluationError(f"{path}: no pose in it: give a TUM file, t x y z qx qy qz qw")
    unique, first = np.unique(np.asarray(stamps, dtype=np.int64), return_index=True)
    return Trajectory(unique, np.asarray(poses, dtype=np.float64)[first])


def read_lines(path: Path) -> list[str]:
    """Lines of a text file. Raises EvaluationError."""
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise EvaluationError(f"{path}: cannot be read: {error.strerror}: check the path") from error
    except UnicodeDecodeError as error:
        raise EvaluationError(f"{path}: is no text file") from error
