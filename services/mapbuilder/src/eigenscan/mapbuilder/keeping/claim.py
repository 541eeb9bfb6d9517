"""Where a robot reports that it is, and whether that goes on from where it was sure to be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.pose import Array, between, compose, covariance_from_message, from_message
from eigenscan.schemas.envelope import nanoseconds
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


@dataclass(frozen=True)
class Claim:
    """A base pose (3,) in the map, and the same by odometry where there is one."""

    stamp: int
    base: Array
    odometry: Array | None
    is_sure: bool

    @classmethod
    def of(cls, pose: PoseEstimate) -> Claim | None:
        """The claim of a tracker; None where its numbers make no sense."""
        base = from_message(pose.pose)
        odometry = between(from_message(pose.map_to_odom), base) if pose.has_odometry else None
        if not np.isfinite(base).all() or (odometry is not None and not np.isfinite(odometry).all()):
            return None
        x, y, theta = np.diagonal(covariance_from_message(pose.covariance))
        # zeros are a covariance that is not known
        small = 0 < x + y <= SIGMA_M**2 and 0 < theta <= SIGMA_RAD**2
        sure = pose.state == STATE_LOCALIZED and pose.confidence >= CONFIDENCE and small
        return cls(nanoseconds(pose.timestamp), base, odometry, bool(sure))

    def way_to(self, other: Claim) -> Array:
        """Motion (3,) from here to there: by odometry, or as claimed."""
        if self.odometry is None or other.odometry is None:
            return between(self.base, other.base)
        return between(self.odometry, other.odometry)

    def leads_to(self, other: Claim) -> bool:
        """Whether the robot can have come from here to where it claims to be there."""
        passed = other.stamp - self.stamp
        if not 0 <= passed <= FARTHEST_NS:
            return False
        way = self.way_to(other)
        if self.odometry is None or other.odometry is None:
            return _length(way) <= JUMP_M + SPEED * passed * 1e-9
        apart = between(compose(self.base, way), other.base)
        return _length(apart) <= JUMP_M + JUMP_SHARE * _length(way)

    def is_left_behind(self, other: Claim) -> bool:
        """Whether the robot has gone too far since to be led on from here."""
        within = 0 <= other.stamp - self.stamp <= FARTHEST_NS
        return not within or _length(self.way_to(other)) > FARTHEST_M

    def has_moved(self, other: Claim) -> bool:
        """Whether there is something new to be seen there."""
        way = self.way_to(other)
        return bool(_length(way) >= MOVED_M or abs(way[2]) >= MOVED_RAD)


def bridge(start: Claim, end: Claim, claims: Sequence[Claim]) -> list[Array]:
    """Base poses (3,) of `claims` between two sure ones: by odometry, its error spread evenly over the time.

    Empty without odometry.
    """
    if start.odometry is None or end.odometry is None or not claims:
        return []
    raw = compose(start.base, start.way_to(end))
    error = np.array([*(end.base - raw)[:2], wrap(end.base[2] - raw[2])])
    share = [(claim.stamp - start.stamp) / max(end.stamp - start.stamp, 1) for claim in claims]
    return [
        compose(start.base, start.way_to(claim)) + s * error for claim, s in zip(claims, share, strict=True)
    ]


def _length(way: Array) -> float:
    return float(np.hypot(way[0], way[1]))
