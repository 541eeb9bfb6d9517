"""A robot whose place is sure: each scan is fitted around the pose that the tracker predicts.

Such a list omits other places. Where the scan does not fit there, the whole map is searched for it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import cos, hypot, isfinite, nan, radians, remainder, sin, tau

import numpy as np
from eigenscan.geometry.pose import FARTHEST_M
from eigenscan.projector.candidates import Fitted
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.hypotheses_pb2 import SEARCH_LOCAL, SearchRequest
from eigenscan.schemas.recently_used import RecentlyUsed
from numpy.typing import NDArray

Array = NDArray[np.float64]

REACH_M, REACH_RAD = 0.5, radians(10.0)
"""As far from the predicted pose as the fit may end: what the tracker counts as one place."""
LONGEST_NS = 500_000_000
"""Between two scans: over a longer time a velocity predicts no pose. Two scans of a lidar of 4 Hz."""
WHOLE_NS = 2_000_000_000
"""Age of the last search of the whole map, from which its ordinary place is no measure any more."""
PLACES = 16
"""At most of a request's: a request is no way to keep a projector busy."""
KEPT = 16
"""Requests kept of each lidar: more than come between two scans."""
BESIDE_M, BESIDE_RAD = 0.15, 0.1
"""Where the fit starts beside the predicted pose: a step of its descent away."""
STARTS = np.vstack([np.zeros(3), *(sign * np.diag([BESIDE_M, BESIDE_M, BESIDE_RAD]) for sign in (1.0, -1.0))])
"""Of each fit, (n, 3), beside the predicted pose."""


@dataclass(frozen=True)
class Around:
    """Where to fit a scan: the predicted sensor pose (3,), map frame.

    `ordinary`: support of an ordinary place, and `least`: the log-likelihood below which the whole map is
    searched.
    """

    sensor: Array
    ordinary: float
    least: float

    @property
    def starts(self) -> Array:
        """Sensor poses (n, 3) from which the scan is fitted."""
        return self.sensor + STARTS

    def holds(self, found: Fitted) -> bool:
        """Whether what was found is the predicted place, as sure as it was."""
        x, y, turn = (found.pose - self.sensor).tolist()
        near = hypot(x, y) <= REACH_M and abs(remainder(turn, tau)) <= REACH_RAD
        return near and found.log_likelihood >= self.least


@dataclass(frozen=True)
class Asked:
    """What a tracker asks for: a local fit, None if the whole map must be searched; then also at `places`.

    `places` (n, 3): sensor poses in the map frame.
    """

    around: Around | None = None
    places: Array = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass
class _Lidar:
    """Its requests, the stamp of its last scan, and the last search of the whole map."""

    requests: deque[SearchRequest] = field(default_factory=lambda: deque(maxlen=KEPT))
    scan: int | None = None
    whole: int | None = None
    ordinary: float = 0.0


class LocalSearch:
    """What each robot's lidars are asked for.

    An answer follows from the scan, the one before it, and the request of that one's stamp, whenever that
    came; where it did not come in time, the whole map is searched.
    """

    def __init__(self) -> None:
        self._lidars: RecentlyUsed[tuple[str, str], _Lidar] = RecentlyUsed()

    def receive(self, lidar: tuple[str, str], request: SearchRequest) -> None:
        """Takes a request for a lidar, by its robot's and its own name."""
        self._lidars.use(lidar, _Lidar).requests.append(request)

    def searched_whole(self, lidar: tuple[str, str], stamp: int, ordinary: float) -> None:
        """Records a search of the whole map, and the support of an ordinary place in it."""
        known = self._lidars.use(lidar, _Lidar)
        known.whole, known.ordinary = stamp, ordinary

    def asked(self, lidar: tuple[str, str], stamp: int, frame_id: str, mount: Pose2) -> Asked:
        """Where to look for the scan of `stamp`, ns, of a lidar at `mount` in the base frame."""
        known = self._lidars.use(lidar, _Lidar)
        before, known.scan = known.scan, stamp
        if before is None or not 0 < stamp - before <= LONGEST_NS:
            return Asked()
        newest = next((r for r in reversed(known.requests) if nanoseconds(r.timestamp) == before), None)
        if newest is None or newest.frame_id != frame_id:
            return Asked()
        seconds = (stamp - before) * 1e-9
        recent = known.whole is not None and 0 < stamp - known.whole <= WHOLE_NS
        local = newest.search == SEARCH_LOCAL and recent
        around = _around(newest, seconds, mount, known.ordinary) if local else None
        return Asked(around, _predicted(newest.places[:PLACES], newest.velocity, seconds, mount))


def _around(request: SearchRequest, seconds: float, mount: Pose2, ordinary: float) -> Around | None:
    """The predicted place, `seconds` after the request; None where it is none, or vaguer than one place."""
    c, place = request.covariance, _predicted([request.pose], request.velocity, seconds, mount)
    is_sure = 0.0 < c.xx + c.yy <= REACH_M**2 and 0.0 < c.tt <= REACH_RAD**2
    if not (len(place) and is_sure and isfinite(request.least_log_likelihood)):
        return None
    return Around(place[0], ordinary, request.least_log_likelihood)


def _predicted(poses: Iterable[Pose2], velocity: Pose2, seconds: float, mount: Pose2) -> Array:
    """Sensor poses (n, 3) from base poses, `seconds` later; without those that are no places."""
    step = velocity.x * seconds, velocity.y * seconds, velocity.theta * seconds
    places = list[tuple[float, float, float]]()
    for pose in poses:
        x, y, theta = _after(pose, step)
        x, y, theta = _after(Pose2(x=x, y=y, theta=theta), (mount.x, mount.y, mount.theta))
        if abs(x) < FARTHEST_M and abs(y) < FARTHEST_M and isfinite(theta):
            places.append((x, y, theta))
    return np.array(places).reshape(-1, 3)


def _after(pose: Pose2, step: tuple[float, float, float]) -> tuple[float, float, float]:
    """A pose given in the frame of `pose`; not finite where one of them is not."""
    if not isfinite(pose.theta):
        return nan, nan, nan
    x, y, turn = step
    ahead, aside = cos(pose.theta), sin(pose.theta)
    return pose.x + ahead * x - aside * y, pose.y + aside * x + ahead * y, pose.theta + turn
