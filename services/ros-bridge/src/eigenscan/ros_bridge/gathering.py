"""One scan of all that narrow sensors saw over the last metres: depth cameras, lidars that hardly overlap.

What was seen is kept in the odometry frame, so it is as true as odometry is over that way.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.message_floats import floats_of
from eigenscan.geometry.normalize import Sweep, limit, limits, orient
from eigenscan.geometry.pose import Array, between, compose, from_message, from_pose3, inverse, transform
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.scan_pb2 import RawScan
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from numpy.typing import NDArray

LIDAR = "gathered"
"""Its name in keys."""
BEAMS = 360
"""Of a full turn: 1 deg, half the projector's step."""
TURNS = 0.5
"""Whole turns after which what was seen is forgotten, as after the way."""
STEP_M, STEP_RAD = 0.05, 0.05
"""Nearer to each other, one of two scans is enough to keep."""
KEPT_NS = 1_000_000_000
"""Of odometry, to find where the robot was at a scan's stamp."""
AHEAD_NS = 200_000_000
"""Beyond the newest odometry the last motion goes on so long at most."""
APART_NS = 45_000_000
"""Between two gathered scans: 20 Hz, with a tenth for jitter."""
MOST_SENSORS = 32
"""Of a robot; what the first of more saw is forgotten."""
FARTHEST_STEP_M = 1.0
"""Between two odometries: a longer one is a jump, and what was seen before it is forgotten."""


@dataclass(frozen=True)
class _View:
    """What one scan saw: points (n, 2) in the odometry frame, and how far the robot had come, 1: too far."""

    base: Array
    points: Array
    progress: float


class Gathering:
    """Keeps what all sensors of a robot saw over the last `way`, m."""

    def __init__(self, way: float) -> None:
        self._way = way
        self._odometry: deque[tuple[int, Array]] = deque()
        self._views: dict[str, deque[_View]] = {}
        self._progress, self._published = 0.0, 0

    def receive_odometry(self, message: Odometry) -> None:
        """Takes the base in the odometry frame; after a jump, also of the clock, all begins anew."""
        at, pose = nanoseconds(message.timestamp), from_pose3(message.pose)
        if self._odometry:
            last, before = self._odometry[-1]
            moved = between(before, pose)
            way = float(np.hypot(moved[0], moved[1]))
            if at == last:
                return
            if at < last or way > FARTHEST_STEP_M:
                self._odometry.clear()
                self._views.clear()
                self._published = 0
            self._progress += way / self._way + abs(float(moved[2])) / (TURN * TURNS)
        self._odometry.append((at, pose))
        while at - self._odometry[0][0] > KEPT_NS:
            self._odometry.popleft()

    def knows(self, raw: RawScan) -> bool:
        """Whether there is odometry of a scan's time."""
        return self._base_at(nanoseconds(raw.timestamp)) is not None

    def gather(self, raw: RawScan) -> RawScan | None:
        """All that was seen, as from the base; None right after another one, or where odometry is missing.

        Raises ScanError for a scan that is none.
        """
        at = nanoseconds(raw.timestamp)
        base = self._base_at(at)
        if base is None:
            return None
        self._keep(raw, base)
        if at - self._published < APART_NS:
            return None
        self._published = at
        seen = np.concatenate([view.points for views in self._views.values() for view in views])
        ranges = np.full(BEAMS, np.nan)
        points = transform(inverse(base), seen)
        beams = nearest(points)
        ranges[beam_of(points[beams])] = np.hypot(*points[beams].T)
        return RawScan(
            timestamp=raw.timestamp,
            frame_id=LIDAR,
            angle_min=-np.pi,
            angle_increment=TURN / BEAMS,
            ranges=ranges.tolist(),
            gathered=self._way,
        )

    def _base_at(self, at: int) -> Array | None:
        """Between two odometries, or a little beyond the last one as the robot moved before."""
        known = self._odometry
        if not known or not known[0][0] <= at <= known[-1][0] + AHEAD_NS:
            return None
        later = next((k for k, (time, _) in enumerate(known) if time >= at), len(known) - 1)
        (since, start), (until, end) = known[max(later - 1, 0)], known[later]
        share = (at - since) / (until - since) if until > since else 0.0
        return compose(start, between(start, end) * share)

    def _keep(self, raw: RawScan, base: Array) -> None:
        points = points_of(raw)
        views = self._views.setdefault(raw.frame_id, deque())
        if len(self._views) > MOST_SENSORS:
            del self._views[next(iter(self._views))]
        if len(views) > 1 and _is_near(views[-2].base, base):
            views.pop()  # it showed no more than the one before and this one do
        views.append(_View(base, transform(base, points), self._progress))
        for each in self._views.values():
            while each and self._progress - each[0].progress > 1.0:
                each.popleft()


def points_of(raw: RawScan) -> Array:
    """End points (n, 2) of a scan's beams in the base frame, the nearest of each direction of the sensor.

    Raises ScanError.
    """
    sweep = orient(Sweep(floats_of(raw, "ranges"), raw.angle_min, raw.angle_increment), raw.upside_down)
    ranges = limit(sweep.ranges, *limits(raw.range_min, raw.range_max)).astype(np.float64)
    bearings = sweep.angle_min + sweep.angle_increment * np.arange(len(ranges))
    seen = np.isfinite(ranges)
    directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    points = directions[seen] * ranges[seen, None]
    return transform(from_message(raw.mount), points[nearest(points)])


def nearest(points: Array) -> NDArray[np.intp]:
    """Indices of the nearest point of each direction, of points (n, 2)."""
    order = np.argsort(-np.hypot(points[:, 0], points[:, 1]), kind="stable")
    found = np.full(BEAMS, -1)
    found[beam_of(points[order])] = order  # the last of a direction stays: the nearest
    return found[found >= 0]


def beam_of(points: Array) -> NDArray[np.intp]:
    """Directions (n,) of points (n, 2), counted from -pi."""
    turned = np.arctan2(points[:, 1], points[:, 0]) + np.pi
    return np.rint(turned * (BEAMS / TURN)).astype(np.intp) % BEAMS


def _is_near(a: Array, b: Array) -> bool:
    moved = between(a, b)
    return bool(np.hypot(moved[0], moved[1]) < STEP_M and abs(moved[2]) < STEP_RAD)
