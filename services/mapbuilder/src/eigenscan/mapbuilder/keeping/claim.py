"""A robot's claimed pose, and whether it continues from a sure one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.circle import TURN, wrap
from eigenscan.geometry.pose import Array, compose
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate

CONFIDENCE = 0.9
SIGMA_M, SIGMA_RAD = 0.1, float(np.deg2rad(3.0))
"""Largest standard deviations of a pose that is sure."""
MOVED_M, MOVED_RAD = 0.2, float(np.deg2rad(10.0))
"""A robot that has not moved so far sees nothing new: in hours of standing it gets one view."""
JUMP_M, JUMP_SHARE = 0.3, 0.1
"""m, and share of the way: a pose farther than this from where odometry leads is another place."""
SPEED = 3.0
"""m/s, without odometry."""
FARTHEST_M, FARTHEST_NS = 5.0, 60 * 1_000_000_000
"""Way, or time, for which odometry is believed from one sure pose to the next."""


Pose = tuple[float, float, float]
"""x, y, m, and heading, rad: every scan compares a few, and numpy takes ten times as long for one."""


@dataclass(frozen=True)
class Claim:
    """A base pose in the map, and in the odometry frame if there is one."""

    stamp: int
    base: Pose
    odometry: Pose | None
    is_sure: bool

    @classmethod
    def of(cls, pose: PoseEstimate) -> Claim | None:
        """The claim of a tracker's pose; None for invalid numbers."""
        base, frame = _of(pose.pose), _of(pose.map_to_odom) if pose.has_odometry else None
        if not all(map(math.isfinite, (*base, *(frame or ())))):
            return None
        odometry = None if frame is None else _between(frame, base)
        square, turned = pose.covariance.xx + pose.covariance.yy, pose.covariance.tt
        # zeros are a covariance that is not known
        small = 0 < square <= SIGMA_M**2 and 0 < turned <= SIGMA_RAD**2
        sure = pose.state == STATE_LOCALIZED and pose.confidence >= CONFIDENCE and small
        return cls(nanoseconds(pose.timestamp), base, odometry, sure)

    def way_to(self, other: Claim) -> Pose:
        """Motion from here to there: by odometry, or as claimed."""
        if self.odometry is None or other.odometry is None:
            return _between(self.base, other.base)
        return _between(self.odometry, other.odometry)

    def leads_to(self, other: Claim) -> bool:
        """Whether the robot can have come from here to the other claim."""
        passed = other.stamp - self.stamp
        if not 0 <= passed <= FARTHEST_NS:
            return False
        way = self.way_to(other)
        if self.odometry is None or other.odometry is None:
            return _length(way) <= JUMP_M + SPEED * passed * 1e-9
        x, y, theta = self.base
        cos, sin = math.cos(theta), math.sin(theta)
        led = x + cos * way[0] - sin * way[1], y + sin * way[0] + cos * way[1]
        return math.dist(led, other.base[:2]) <= JUMP_M + JUMP_SHARE * _length(way)

    def is_left_behind(self, other: Claim) -> bool:
        """Whether the robot has gone too far since to be led on from here."""
        within = 0 <= other.stamp - self.stamp <= FARTHEST_NS
        return not within or _length(self.way_to(other)) > FARTHEST_M

    def has_moved(self, other: Claim) -> bool:
        """Whether there is something new to be seen there."""
        way = self.way_to(other)
        return _length(way) >= MOVED_M or abs(way[2]) >= MOVED_RAD


def bridge(start: Claim, end: Claim, claims: Sequence[Claim]) -> list[Array]:
    """Base poses (3,) of `claims` between two sure ones: by odometry, its error spread evenly over the time.

    Empty without odometry.
    """
    if start.odometry is None or end.odometry is None or not claims:
        return []
    raw = compose(start.base, start.way_to(end))
    error = np.subtract(end.base, raw)
    error[2] = wrap(error[2])
    share = [(claim.stamp - start.stamp) / max(end.stamp - start.stamp, 1) for claim in claims]
    return [
        compose(start.base, start.way_to(claim)) + s * error for claim, s in zip(claims, share, strict=True)
    ]


def _of(message: Pose2) -> Pose:
    return message.x, message.y, message.theta


def _between(a: Pose, b: Pose) -> Pose:
    """Pose `b` seen from `a`."""
    dx, dy, cos, sin = b[0] - a[0], b[1] - a[1], math.cos(a[2]), math.sin(a[2])
    return cos * dx + sin * dy, cos * dy - sin * dx, (b[2] - a[2] + math.pi) % TURN - math.pi


def _length(way: Pose) -> float:
    return math.hypot(way[0], way[1])
