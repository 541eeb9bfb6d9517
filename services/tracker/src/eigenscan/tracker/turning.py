"""How far scans turn against odometry: wheels stated too near or too far apart, and a heading that drifts.

Where odometry shows the turn w over t seconds, the scans turn by scale w + rate t; least squares find both.
Poses bear either, as scans correct each, so it is reported and lowers no claim.
"""

from __future__ import annotations

from math import degrees, radians, sqrt

import numpy as np
from eigenscan.tracker.calibration import FIRST, SCALE, SCALE_OFF, SIGMAS, TAIL
from eigenscan.tracker.scan_motion import SIGMA_RAD
from numpy.typing import NDArray

Array = NDArray[np.float64]

RIGHT, START = np.array([1.0, 0.0]), np.array([0.5, 0.1])
"""Scale and rate, rad/s, before any motion, and their wide sigmas."""
FIRST_INFORMATION: Array = np.diag(START**-2)
STRAIGHT = 2.0 * SIGMA_RAD
"""rad: an odometry's turn up to this may be mostly noise, and shows no scale: it would seem too large."""
DRIFTS = radians(1.0)
"""rad/s from which on a heading drifts: a cheap gyroscope's bias. By the scans of ten logs, their odometry
drifts by up to 0.5 degrees/s."""

SCALED = "scans turn {:.1f} times as far as odometry: is the distance between its wheels right?"
DRIFTING = "odometry's heading drifts by {:.1f}°/s against the scans: is its gyroscope biased?"


class Turning:
    """Scale and rate of one lidar's turns against odometry's."""

    def __init__(self) -> None:
        self._information, self._sums = np.zeros((2, 2)), np.zeros(2)
        self._spread: Array = np.diag(START**2)
        self._intervals = self._squares = FIRST
        self.scale, self.rate = RIGHT.tolist()
        """How far the scans turn as a share of odometry's turn, and beside it, rad/s."""
        self.note = ""
        """What is wrong with odometry's turns, in words for the person who can mend it; or empty."""

    def take(self, scans: float, variance: float, driven: float, seconds: float) -> None:
        """Takes the turn between two scans, rad, its variance, and odometry's turn."""
        h, noise = np.array([driven, seconds]), variance + SIGMA_RAD**2
        exact = self._intervals / self._squares
        off = scans - (self.scale * driven + self.rate * seconds)
        distance2 = off * off / (float(h @ self._spread @ h) + noise / exact)
        self._intervals += 1.0
        self._squares += distance2 / exact
        noise *= max(1.0, (TAIL + distance2) / (TAIL + 1.0))  # Student's t
        if abs(driven) <= STRAIGHT:
            h[0], scans = 0.0, scans - self.scale * driven
        self._information += np.outer(h, h) / noise
        self._sums += h * (scans / noise)
        # how exact the turns are is learned; what was known before them is not more exact for that
        exact = self._intervals / self._squares
        self._spread = np.asarray(np.linalg.inv(FIRST_INFORMATION + exact * self._information))
        self.scale, self.rate = (self._spread @ (FIRST_INFORMATION @ RIGHT + exact * self._sums)).tolist()
        self._judge()

    def _judge(self) -> None:
        off_scale, off_rate = np.sqrt(np.diag(self._spread)).tolist()
        self.note = ""
        if abs(self.scale - 1.0) > SCALE_OFF / 2.0 + SIGMAS * sqrt(off_scale**2 + SCALE**2):
            self.note = SCALED.format(self.scale)
        elif abs(self.rate) > DRIFTS + SIGMAS * off_rate:
            self.note = DRIFTING.format(abs(degrees(self.rate)))
