"""Where the tracker says that a robot is, so that a large site need not be searched whole at every scan."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from eigenscan.geometry.pose import covariance_from_message
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.recently_used import RecentlyUsed
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from numpy.typing import NDArray

FULL_EVERY = 1_000_000_000
"""ns: so often the whole site is searched all the same, so that a robot that was carried off is noticed."""
SETTLED = 300_000_000
"""ns before a scan: younger poses do not count, for they come before it or after it by chance."""
STALE = 1_500_000_000
"""ns before a scan: an older pose says nothing of it."""
MARGIN_M, SIGMAS, SPEED = 2.0, 3.0, 2.0
"""Reach around a pose: m, standard deviations, and m/s since then."""
_REMEMBERED = 128


@dataclass(frozen=True)
class Scope:
    """The regions (R,) that are searched, None for all; and the least support that an ordinary place has."""

    regions: NDArray[np.bool_] | None = None
    ordinary: float = -np.inf


WHOLE = Scope()


@dataclass(frozen=True)
class Reach:
    """A robot is within `radius`, m, of `x`, `y` in the map frame."""

    x: float
    y: float
    radius: float

    def regions(self, boxes: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which regions (R,) the reach touches, by their boxes (R, 4): x and y from, x and y to, m."""
        across = np.maximum(np.maximum(boxes[:, 0] - self.x, self.x - boxes[:, 2]), 0.0)
        along = np.maximum(np.maximum(boxes[:, 1] - self.y, self.y - boxes[:, 3]), 0.0)
        return np.asarray(np.hypot(across, along) <= self.radius)


@dataclass(frozen=True)
class _Known:
    """What is known of one robot: its poses, and by lidar when the whole site was searched, and with what."""

    poses: deque[tuple[int, PoseEstimate]] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))
    full: dict[str, tuple[int, float]] = field(default_factory=dict)


class Focus:
    """Poses heard of each robot, and when each of its lidars last searched the whole site.

    What it tells of a scan depends on the stamps of scan and poses, not on the order of their arrival, where
    a pose comes within SETTLED of its stamp.
    """

    def __init__(self) -> None:
        self._robots: RecentlyUsed[str, _Known] = RecentlyUsed()

    def receive(self, robot: str, estimate: PoseEstimate) -> None:
        """Takes a pose."""
        known = self._robots.use(robot, _Known)
        known.poses.append((nanoseconds(estimate.timestamp), estimate))

    def searched_whole(self, robot: str, lidar: str, stamp: int, ordinary: float) -> None:
        """Remembers a search of the whole site, and what support an ordinary place of it had."""
        self._robots.use(robot, _Known).full[lidar] = stamp, ordinary

    def ordinary(self, robot: str, lidar: str) -> float:
        """Support of an ordinary place at the last search of the whole site."""
        return self._robots.use(robot, _Known).full[lidar][1]

    def reach(self, robot: str, lidar: str, stamp: int, frame_id: str) -> Reach | None:
        """Where the robot can be at `stamp`, ns; None where the whole site is to be searched."""
        robot_known = self._robots.use(robot, _Known)
        last, _ = robot_known.full.get(lidar, (0, 0.0))
        if not 0 <= stamp - last < FULL_EVERY:
            return None
        known = [(at, e) for at, e in robot_known.poses if SETTLED <= stamp - at <= STALE]
        if not known:
            return None
        at, newest = max(known, key=lambda each: each[0])
        if newest.state != STATE_LOCALIZED or newest.frame_id != frame_id:
            return None
        spread = np.linalg.eigvalsh(covariance_from_message(newest.covariance)[:2, :2])[-1]
        radius = MARGIN_M + SIGMAS * float(np.sqrt(max(spread, 0.0))) + SPEED * (stamp - at) * 1e-9
        if not np.isfinite([newest.pose.x, newest.pose.y, radius]).all():
            return None
        return Reach(newest.pose.x, newest.pose.y, radius)
