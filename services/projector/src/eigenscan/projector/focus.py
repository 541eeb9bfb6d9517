"""Limits the search of a large site to the region around the tracker's pose."""

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
"""Age beyond which a pose is not used, ns before a scan."""
MARGIN_M, SIGMAS, SPEED = 2.0, 3.0, 2.0
"""Reach around a pose: m, standard deviations, and m/s since then."""
_REMEMBERED = 128
"""Poses of a robot: more than come within STALE at 80 Hz."""


@dataclass(frozen=True)
class Scope:
    """The regions (R,) that are searched, None for all; and the least support that an ordinary place has."""

    regions: NDArray[np.bool_] | None = None
    ordinary: float = -np.inf

    def among(self, flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which of the regions that the flags (R,) name are searched."""
        return flags if self.regions is None else flags & self.regions


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
    """State of one robot: its poses, and for each lidar the last search of the whole site."""

    poses: deque[tuple[int, PoseEstimate]] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))
    full: dict[str, tuple[int, float]] = field(default_factory=dict)


class Focus:
    """Poses of each robot, and the time at which each of its lidars last searched the whole site.

    Its answers depend on the stamps of scan and poses, not on their order of arrival, if a pose arrives
    within SETTLED of its stamp.
    """

    def __init__(self) -> None:
        self._robots: RecentlyUsed[str, _Known] = RecentlyUsed()

    def receive(self, robot: str, estimate: PoseEstimate) -> None:
        """Takes a pose."""
        known = self._robots.use(robot, _Known)
        known.poses.append((nanoseconds(estimate.timestamp), estimate))

    def searched_whole(self, robot: str, lidar: str, stamp: int, ordinary: float) -> None:
        """Records a search of the whole site, and the support of an ordinary place in it."""
        self._robots.use(robot, _Known).full[lidar] = stamp, ordinary

    def ordinary(self, robot: str, lidar: str) -> float:
        """Support of an ordinary place at the last search of the whole site."""
        return self._robots.use(robot, _Known).full[lidar][1]

    def reach(self, robot: str, lidar: str, stamp: int, frame_id: str) -> Reach | None:
        """The reach of the robot at `stamp`, ns; None if the whole site must be searched."""
        robot_known = self._robots.use(robot, _Known)
        full = robot_known.full.get(lidar)
        if full is None or not 0 <= stamp - full[0] < FULL_EVERY:
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
