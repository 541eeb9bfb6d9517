"""Where odometry was in the last seconds: what scans that come late would show."""

from __future__ import annotations

from math import ceil

import numpy as np
from eigenscan.tracker.odometry import OdometryTrail
from eigenscan.tracker.planar import Pose, compose, inverse, scaled, wrap
from numpy.typing import NDArray

Array = NDArray[np.float64]

KEPT = 256
"""Samples that are kept, at least half of them."""


class Past:
    """Poses of odometry at steps of some tenths of a second."""

    def __init__(self, longest_s: float, step_s: float) -> None:
        self._longest, self._step = round(1e9 * longest_s), round(1e9 * step_s)
        self._kept, self._count = np.empty((KEPT, 4)), 0
        self.known_since = 0.0
        """s, stamp of the first pose that was not guessed."""

    @property
    def poses(self) -> Array:
        """Stamp [s] and pose (n, 4), without jumps in the heading."""
        return self._kept[: self._count]

    def moved(self, seconds: Array) -> tuple[Array, Array]:
        """How far odometry has come over the last `seconds` (n,): m and rad, none where it has not come."""
        poses = self.poses
        if not len(poses):
            return np.zeros(len(seconds)), np.zeros(len(seconds))
        then = poses[np.searchsorted(poses[:, 0], poses[-1, 0] - seconds)]
        off = np.abs(poses[-1, 1:] - then[:, 1:])
        return np.hypot(off[:, 0], off[:, 1]), off[:, 2]

    def take(self, since: int, seconds: float, trail: OdometryTrail) -> None:
        """Keeps where odometry was at steps of an interval."""
        if not self._count:
            self._look_back(since, seconds, trail)
        steps = max(ceil(2e9 * seconds / self._step), 1)
        for step in range(steps + 1):
            stamp = since + round(1e9 * seconds * step / steps)
            sample = trail.at(stamp)
            if sample is not None:
                self._keep(stamp, sample.chained)

    def _look_back(self, since: int, seconds: float, trail: OdometryTrail) -> None:
        """Keeps where odometry was before; before its first, as if the robot had moved as it then did."""
        oldest, earliest, step = trail.oldest, since - self._longest, self._step
        if oldest is None:
            return
        begin = max(earliest, min(oldest.stamp, since))
        known = [
            (stamp, sample.chained) for stamp in range(begin, since, step) if (sample := trail.at(stamp))
        ]
        until = min(begin + step, since + round(1e9 * seconds))
        back = inverse(scaled(trail.between(begin, until).delta, step / max(until - begin, 1)))
        pose, guessed = known[0][1] if known else oldest.chained, list[tuple[int, Pose]]()
        for stamp in range(begin - step, earliest - step, -step):
            pose = compose(pose, back)
            guessed.append((stamp, pose))
        for stamp, where in (*reversed(guessed), *known):
            self._keep(stamp, where)
        self.known_since = begin * 1e-9

    def _keep(self, stamp: int, pose: Pose) -> None:
        """Keeps where odometry was at a stamp, ns, that is newer than the last."""
        before = self._kept[self._count - 1] if self._count else None
        x, y, heading = pose
        if before is not None:
            if stamp * 1e-9 <= before[0]:
                return
            heading = before[3] + wrap(heading - before[3])
        if self._count == len(self._kept):
            self._count //= 2
            self._kept[: self._count] = self._kept[self._count :]
        self._kept[self._count] = stamp * 1e-9, x, y, heading
        self._count += 1
