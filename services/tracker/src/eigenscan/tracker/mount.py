"""The mount of one lidar, as motion shows it: fixed, or loose, so that it turns on while the robot drives.

What a fixed mount showed long ago counts for ever, so a loose one is followed late. Both are calibrated side
by side, and how well each predicts the next motion tells which it is (multiple model estimation; Blom and
Bar-Shalom, "The interacting multiple model algorithm", IEEE TAC 1988).
"""

from __future__ import annotations

from math import exp, radians

from eigenscan.tracker.calibration import Calibration
from eigenscan.tracker.planar import Pose
from eigenscan.tracker.set_up import BEGINS, ENDS, FARTHEST

FIXED_RAD, LOOSE_RAD = radians(0.2), radians(0.8)
"""From one interval to the next a mount may turn by as much.

benchmarks/integrity.py, jarvis and intel, a mount that turns by 1 degree/s: with the fixed one alone 103
scans are claimed wrongly. With a loose one alone, a mount off by 10 degrees is never named.
"""


class Mount:
    """The calibrations of a fixed and of a loose mount, and how probable the loose one is."""

    def __init__(self) -> None:
        self._fixed, self._loose = Calibration(FIXED_RAD), Calibration(LOOSE_RAD)
        self._is_loose = BEGINS

    @property
    def fault(self) -> str:
        """What is wrong with the mount or the scale, in words for the person who can mend it; or empty."""
        return self._likelier.fault

    @property
    def note(self) -> str:
        """By how much the mount is off where a claim allows that, in words; empty: by nothing that shows."""
        return self._fixed.note

    @property
    def within(self) -> float:
        """Probability that the mount turns and displaces poses by less than a claim allows."""
        return self._likelier.within

    @property
    def proven(self) -> float:
        """Probability that mount and ranges are right, of the least that motion leaves: loose or fixed."""
        return min(self._fixed.proven, self._loose.proven)

    @property
    def right(self) -> float:
        """The same probability by how probably the mount is loose."""
        return self._fixed.proven + self._is_loose * (self._loose.proven - self._fixed.proven)

    @property
    def _likelier(self) -> Calibration:
        """The loose one where it is likelier, unless only the fixed one has a fault."""
        is_loose = self._is_loose > 0.5 and (self._loose.fault or not self._fixed.fault)
        return self._loose if is_loose else self._fixed

    def take(self, scans: Pose, spread: tuple[float, float, float], driven: Pose, way: float) -> None:
        """Takes the motion between two scans, its covariance, m^2, and odometry's motion, `way` m long."""
        fixed = self._fixed.take(scans, spread, driven, way)
        loose = self._loose.take(scans, spread, driven, way)
        before = self._is_loose * (1.0 - ENDS) + (1.0 - self._is_loose) * BEGINS
        self._is_loose = before / (before + (1.0 - before) * exp(min(fixed - loose, FARTHEST)))

    def suspect_turn(self, seen: float, driven: float) -> None:
        """The mount may have been turned where scans turn and odometry does not, rad."""
        self._fixed.suspect_turn(seen, driven)
        self._loose.suspect_turn(seen, driven)

    def suspect_any(self) -> None:
        """Two scans that should fit each other do not: the mount may have been turned by any angle."""
        self._fixed.suspect_any()
        self._loose.suspect_any()
