"""The odometry Kalman filter and its validation gate (paper, section 7; Crowley and Reignier 1993).

The filter tracks the base's velocity, each of its three parts by itself; a reading outside the gate is
slip, one that no robot of this speed can make is a jump of the odom frame.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from math import hypot
from operator import add, sub

from eigenscan.tracker.planar import Pose
from scipy.special import chdtri

ACCELERATION = (3.0, 1.0, 6.0)
"""m/s^2 ahead, m/s^2 sideways, rad/s^2: sigma of a wheeled robot's change of velocity."""
STEP_NOISE = (0.01, 0.01, 0.01)
"""m, m, rad: resolution of a reading, including the jitter of its stamp."""
JUMP_SLACK_M, JUMP_SLACK_RAD = 0.2, 0.3
"""What bad stamps may add to an increment before it counts as a jump."""
OUTLIERS_IN_ROW = 3
"""So many readings outside the gate in a row are a new velocity, not slip."""
GATE = float(chdtri(3, 1e-6))


class Reading(Enum):
    """What the gate makes of one increment."""

    TAKEN = "taken"
    SLIP = "taken_as_slip"
    JUMP = "taken_as_jump"


class VelocityGate:
    """Judges odometry increments one after another."""

    def __init__(self, v_max: float, turn_max: float) -> None:
        self._limit = (v_max, turn_max)
        self._velocity: Pose | None = None
        self._variance: Pose = (0.0, 0.0, 0.0)
        self._outliers = 0

    def forget(self) -> None:
        """Starts anew, as after a jump."""
        self._velocity = None
        self._outliers = 0

    def judge(self, step: Pose, seconds: float) -> Reading:
        """Reading of increment `step` in the base frame over `seconds` > 0."""
        way, turn = hypot(step[0], step[1]), abs(step[2])
        v_max, turn_max = self._limit
        if way > 2.0 * v_max * seconds + JUMP_SLACK_M or turn > 2.0 * turn_max * seconds + JUMP_SLACK_RAD:
            self.forget()
            return Reading.JUMP
        # three numbers in plain Python take a fifth of numpy's time
        velocity = _each(lambda s: s / seconds, step)
        noise = _each(lambda n: (n / seconds) ** 2, STEP_NOISE)
        if self._velocity is None:
            self._velocity, self._variance = velocity, noise
            return Reading.TAKEN
        self._variance = _each(lambda v, a: v + (a * seconds) ** 2, self._variance, ACCELERATION)
        return self._validate(_each(sub, velocity, self._velocity), self._velocity, noise)

    def _validate(self, innovation: Pose, velocity: Pose, noise: Pose) -> Reading:
        total = _each(add, self._variance, noise)
        if sum(_each(lambda i, t: i * i / t, innovation, total)) <= GATE:
            self._outliers = 0
            self._velocity = _each(
                lambda v, p, t, i: v + p / t * i, velocity, self._variance, total, innovation
            )
            self._variance = _each(lambda p, n, t: p * n / t, self._variance, noise, total)
            return Reading.TAKEN
        self._outliers += 1
        if self._outliers >= OUTLIERS_IN_ROW:
            self.forget()
        return Reading.SLIP


def _each(rule: Callable[..., float], *of: Pose) -> Pose:
    """What a rule makes of the first, second and third numbers."""
    first, second, third = map(rule, *of)
    return first, second, third
