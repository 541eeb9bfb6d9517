"""The odometry Kalman filter and its validation gate (paper, section 7; Crowley and Reignier 1993).

The filter tracks the base's velocity, each of its three parts by itself; a reading outside the gate is
slip, one that no robot of this speed can make is a jump of the odom frame.
"""

from __future__ import annotations

from enum import Enum
from math import hypot

from eigenscan.tracker.planar import Pose
from scipy.special import chdtri

ACCELERATION = (3.0, 1.0, 6.0)
"""m/s^2 ahead, m/s^2 sideways, rad/s^2: sigma of a wheeled robot's change of velocity."""
STEP_NOISE = 0.01
"""m and rad: resolution of a reading, including the jitter of its stamp."""
JUMP_SLACK_M, JUMP_SLACK_RAD = 0.2, 0.3
"""What bad stamps may add to an increment before it counts as a jump."""
OUTLIERS_IN_ROW = 3
"""So many readings outside the gate in a row are a new velocity, not slip."""
GATE = float(chdtri(3, 1e-6))
"""Squared distance of an increment (3 numbers) that one right reading in a million exceeds."""


def is_possible(step: Pose, seconds: float, v_max: float, turn_max: float) -> bool:
    """Whether a robot of this speed, m/s and rad/s, can make `step` in `seconds`; not if not finite."""
    way, turn = hypot(step[0], step[1]), abs(step[2])
    return way <= 2.0 * v_max * seconds + JUMP_SLACK_M and turn <= 2.0 * turn_max * seconds + JUMP_SLACK_RAD


class Reading(Enum):
    """What the gate makes of one increment."""

    TAKEN = "taken"
    SLIP = "taken_as_slip"
    JUMP = "taken_as_jump"


class VelocityGate:
    """Judges odometry increments one after another."""

    def __init__(self, v_max: float, turn_max: float) -> None:
        self._limit = (v_max, turn_max)
        self._velocity: list[float] = []
        self._variance: list[float] = []
        self._outliers = 0

    def forget(self) -> None:
        """Starts again, as after a jump."""
        self._velocity = []
        self._outliers = 0

    def judge(self, step: Pose, seconds: float) -> Reading:
        """Reading of increment `step` in the base frame over `seconds` > 0."""
        if not is_possible(step, seconds, *self._limit):
            self.forget()
            return Reading.JUMP
        noise = (STEP_NOISE / seconds) ** 2
        if not self._velocity:
            self._velocity, self._variance = [part / seconds for part in step], [noise] * 3
            return Reading.TAKEN
        distance2, velocity, left = 0.0, [], []
        for axis, acceleration in enumerate(ACCELERATION):
            variance = self._variance[axis] = self._variance[axis] + (acceleration * seconds) ** 2
            off, gain = step[axis] / seconds - self._velocity[axis], variance / (variance + noise)
            distance2 += off * off / (variance + noise)
            velocity.append(self._velocity[axis] + gain * off)
            left.append(gain * noise)
        if distance2 <= GATE:
            self._outliers, self._velocity, self._variance = 0, velocity, left
            return Reading.TAKEN
        self._outliers += 1
        if self._outliers >= OUTLIERS_IN_ROW:
            self.forget()
        return Reading.SLIP
