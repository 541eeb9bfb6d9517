"""Where odometry and scans were in the last seconds: what the other shows if its stamps are late."""

from __future__ import annotations

from math import ceil

import numpy as np
from eigenscan.tracker.odometry import OdometryTrail
from eigenscan.tracker.planar import IDENTITY, Pose, compose, inverse, scaled, wrap
from numpy.typing import NDArray

Array = NDArray[np.float64]

KEPT = 256
"""Samples that are kept, at least half of them."""


class _Past:
    """Poses at steps of some tenths of a second; those before the first are guessed from how it moved."""

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
        """How far the robot has come over the last `seconds` (n,): m and rad, none where nothing is known."""
        poses = self.poses
        if not len(poses):
            return np.zeros(len(seconds)), np.zeros(len(seconds))
        then = poses[np.searchsorted(poses[:, 0], poses[-1, 0] - seconds)]
        off = np.abs(poses[-1, 1:] - then[:, 1:])
        return np.hypot(off[:, 0], off[:, 1]), off[:, 2]

    def _guess(self, pose: Pose, moved: Pose, begin: int, earliest: int) -> None:
        """Keeps where the robot was before `begin`, ns, if each step moved it so to the pose it had there."""
        back, guessed = inverse(moved), list[tuple[int, Pose]]()
        for stamp in range(begin - self._step, earliest - self._step, -self._step):
            pose = compose(pose, back)
            guessed.append((stamp, pose))
        for stamp, where in reversed(guessed):
            self._keep(stamp, where)
        self.known_since = begin * 1e-9

    def _keep(self, stamp: int, pose: Pose) -> None:
        """Keeps the pose at a stamp, ns, that is newer than the last."""
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


class PastOdometry(_Past):
    """Poses of odometry."""

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
        moved = scaled(trail.between(begin, until).delta, step / max(until - begin, 1))
        self._guess(known[0][1] if known else oldest.chained, moved, begin, earliest)
        for stamp, where in known:
            self._keep(stamp, where)


class PastScans(_Past):
    """Poses by scan motion alone."""

    def take(self, since: int, seconds: float, moved: Pose) -> None:
        """Keeps the end of an interval; one that does not begin where the last one ended begins anew."""
        until = since + round(1e9 * seconds)
        if not self._count or abs(self.poses[-1, 0] - since * 1e-9) > 1e-3:
            self._count = 0
            step = scaled(moved, self._step / max(until - since, 1))
            self._guess(IDENTITY, step, since, since - self._longest)
            self._keep(since, IDENTITY)
        x, y, heading = self.poses[-1, 1:].tolist()
        self._keep(until, compose((x, y, heading), moved))
