"""Sums the yaw rate of sensor_msgs/Imu to a heading."""

from __future__ import annotations

from collections import Counter
from math import isfinite
from typing import Any

from eigenscan.geometry.pose import Array
from eigenscan.ros_bridge.inbound import header_stamp
from eigenscan.schemas.envelope import stamp
from eigenscan.schemas.heading_pb2 import Heading

GAP_NS = 100_000_000
"""Longest time between two rates that a sum spans: at 3 rad/s2 it errs by less than 0.004 rad."""
FASTEST = 100.0
"""rad/s; gyroscopes of robots measure up to 35."""
APART_NS = 18_000_000
"""Between two published headings, with a tenth for jitter: 50 Hz, as odometry. A sum loses nothing by it."""


class HeadingSum:
    """The heading of one gyroscope, by the trapezoidal rule; what cannot be summed is counted."""

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._since = self._last = self._published = 0
        self._rate = self._heading = 0.0

    def take(self, body: Any, matrix: Array) -> Heading | None:
        """The heading after an Imu message, if one is due. `matrix` (4, 4): the sensor in the base frame."""
        rate, at = body.angular_velocity, header_stamp(body.header)
        yaw_rate = float(matrix[2, 0] * rate.x + matrix[2, 1] * rate.y + matrix[2, 2] * rate.z)
        if body.angular_velocity_covariance[0] == -1.0:  # by the message's definition
            self._counts["set_aside_imu_without_rate"] += 1
            return None
        if not (isfinite(yaw_rate) and abs(yaw_rate) < FASTEST):
            self._counts["set_aside_imu_not_finite"] += 1
            return None
        if at == self._last:
            self._counts["set_aside_imu_repeated"] += 1
            return None
        seconds = (at - self._last) * 1e-9
        if 0 < at - self._last <= GAP_NS:
            self._heading += 0.5 * (self._rate + yaw_rate) * seconds
        else:
            self._counts["imu_gap"] += self._last != 0
            self._since, self._heading, self._published = at, 0.0, 0
        self._last, self._rate = at, yaw_rate
        if self._published and at - self._published < APART_NS:
            return None
        self._published = at
        return Heading(timestamp=stamp(at), since=stamp(self._since), heading=self._heading)
