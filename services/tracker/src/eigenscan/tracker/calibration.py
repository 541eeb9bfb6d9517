"""Where a lidar is mounted, and how far it sees the robot move, by odometry and the scans' own motion.

A mount that is stated wrongly displaces or turns every pose, and no scan shows it. The robot's motion does:
on a straight way the scans move aside, in a turn they move where the robot does not. Where odometry shows the
way t and the turn w, the scans move by scale R(yaw) t - (I - R(w)) lever. That is linear in four numbers, so
least squares find them (Censi et al., "Simultaneous calibration of odometry and sensor parameters for mobile
robots", IEEE T-RO 2013).
"""

from __future__ import annotations

from math import atan2, degrees, erf, hypot, inf, log, sqrt

import numpy as np
from eigenscan.tracker.evidence import NEAR_M, NEAR_RAD
from eigenscan.tracker.planar import Pose, wrap
from eigenscan.tracker.scan_motion import SIGMA_M, SIGMA_RAD, SIGMA_SHARE
from eigenscan.tracker.set_up import PROVEN, WRONG, right_share
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

RIGHT, START = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.5, 1.0, 1.0, 1.0])
"""Scale cos(yaw), scale sin(yaw) and the lever, m, m, before any motion, and their wide sigmas."""
FIRST_INFORMATION: Array = np.diag(START**-2)
FIRST = 2.0
"""Intervals that the noise assumed in `scan_motion` counts as, before their own noise is learned."""
YAW_RAD, LEVER_M, SCALE = float(np.radians(0.5)), 0.02, 0.01
"""Sigmas that remain however far the robot drives: errors of scan motion that do not average out."""
LEAST_TURN = 2.0 * SIGMA_RAD
"""rad between two scans: less may be noise, which would seem to show that a turn displaces nothing."""
SIGMAS = 4.0
"""So many sigmas beyond half of what a claim allows, a mount is reported.

The robots of ten logs are off by up to 1.7 degrees, 10 cm and 5 %, which never came to these many
(benchmarks/integrity.py: no alarm without a fault).
"""
NOTED_RAD, NOTED_M = float(np.radians(2.0)), 0.1
"""So far off and as many sigmas more, it is noted: a claim allows it, but each pose errs by as much."""
TAIL = 3.0
"""Degrees of freedom of a motion's errors: odometry errs heavily, now and then (Student's t)."""
SCALE_OFF = 0.14
"""What a claim allows of the ranges' scale, as a share: a wall 3.5 m away is seen NEAR_M too near."""

NOISE_SHOWS = 4.0
"""Information on the scale, of an interval, that is due to odometry's noise alone.

On an arc of one radius scale and lever explain the same motions; least squares then find a scale that leaves
the noise out ("errors in variables"). For normal noise it is 2, with heavy tails more.
"""

MOST_NATS, AGAIN_RIGHT = 3.0, log(1000.0)
"""Nats by which what is stated explains motion better than what was found: of an interval at most, and of
several in a row, from which what was found no longer holds (CUSUM; Page, "Continuous inspection schemes",
Biometrika 1954). Wheels have slipped. `eigenscan simtest` draws such slips.
"""

TURNED = (
    "scans move {}° off odometry's way: is the lidar's mount turned by as much, "
    "or odometry's heading not in radians?"
)
AWAY = (
    "in turns scans move like those of a lidar {:.1f} m away from this one's mount: is it measured rightly?"
)
SCALED = "scans move {:.1f} times as far as odometry: do ranges or wheels have another scale?"


class Calibration:
    """The mount of one lidar and the scale of its motion, against what is stated and what odometry shows.

    What motion has shown is kept as information (4, 4) and its sums (4,), and what was assumed before apart
    from it: so what is forgotten or left out never costs more than was shown.
    """

    def __init__(self, drift_rad: float) -> None:
        """From one interval to the next the mount may turn by `drift_rad`."""
        self._drift_rad = drift_rad
        self._found, self._spread = RIGHT, np.diag(START**2)
        """The four numbers and their covariance, without what noise alone may show of the scale."""
        self.fault = ""
        """What is wrong with the mount or the scale, in words for the person who can mend it; or empty."""
        self.within = 0.0
        """Probability that the mount turns and displaces poses by less than a claim allows."""
        self.proven = 1.0 - WRONG
        """Probability that mount and ranges are right, of the least that motion leaves of it.

        Each against one that is wrong by as much as a claim allows. Another scale leaves 0.9: it may be that
        of the wheels.
        """
        self._forget()

    def _forget(self) -> None:
        self._information, self._sums = np.zeros((4, 4)), np.zeros(4)
        self._added, self._added2 = np.zeros(4), np.zeros(4)
        """Information (4,) of all intervals, and the sum of its squares: by how many each number is shown."""
        self._intervals = self._squares = FIRST
        self._again_right = 0.0

    def take(self, scans: Pose, spread: tuple[float, float, float], driven: Pose, way: float) -> float:
        """Takes the motion between two scans, its covariance, m^2, and odometry's motion, `way` m long.

        Gives the log-density of that motion, as predicted by what was found before.
        """
        self._loosen(self._drift_rad**2)
        x, y, _ = driven
        noise = (SIGMA_M + SIGMA_SHARE * way) ** 2
        if abs(scans[2]) < LEAST_TURN:
            scans = scans[0], scans[1], 0.0
        scale = self._squares / self._intervals
        before = np.diag(self._information).copy()
        squares, better, fits = _update(
            self._information, self._sums, scans, spread, noise, x, y, scale, TAIL
        )
        added = np.diag(self._information) - before
        self._added += added
        self._added2 += added * added
        self._again_right = max(self._again_right + min(better, MOST_NATS), 0.0)
        if self._again_right > AGAIN_RIGHT:
            self._forget()
            self._judge()
            return fits
        self._intervals += 1.0
        self._squares += 0.5 * squares
        self._judge()
        return fits

    def suspect_turn(self, seen: float, driven: float) -> None:
        """The mount may have been turned where scans turn and odometry does not, rad."""
        turned = wrap(seen - driven)
        if abs(turned) > SIGMAS * (SIGMA_RAD + SIGMA_SHARE * abs(driven)):
            self._loosen(turned * turned)
            self._judge()

    def suspect_any(self) -> None:
        """Two scans that should fit each other do not: the mount may have been turned by any angle."""
        self._loosen(inf)
        self._judge()

    def _loosen(self, variance: float) -> None:
        """The mount may have turned by so much, rad^2: a Kalman prediction in information form."""
        turned = self._information[1].copy()
        own = turned[1] + self._squares / (self._intervals * variance)
        if own > 0.0:
            self._sums -= turned * (self._sums[1] / own)
            self._information -= np.outer(turned, turned) / own

    @property
    def yaw(self) -> float:
        """By how much scans move off odometry's way: a mount is turned by as much the other way, rad."""
        return atan2(self._found[1], self._found[0])

    @property
    def lever(self) -> float:
        """How far the mount is from where it is stated, m."""
        return hypot(self._found[2], self._found[3])

    @property
    def scale(self) -> float:
        """How much farther the scans move than odometry."""
        return hypot(self._found[0], self._found[1])

    @property
    def sigmas(self) -> tuple[float, float, float]:
        """Standard deviations of yaw, rad, lever, m, and scale."""
        along, aside, x, y = (1.0 / (self._shown + START**-2)).tolist()
        return sqrt(aside + YAW_RAD**2), sqrt(max(x, y) + LEVER_M**2), sqrt(along + SCALE**2)

    @property
    def _shown(self) -> Array:
        """Information (4,) that motion has shown: its noise scales this, and not what was assumed before."""
        shown = np.maximum(1.0 / np.diag(self._spread) - START**-2, 0.0)
        return np.asarray(shown * (self._intervals / self._squares))

    @property
    def _shown_alone(self) -> Array:
        """The same (4,) where the noise of the intervals that show each number is known by these alone.

        A single turn between straight ways may have come with a noise of its own.
        """
        noise = self._squares / self._intervals
        count = self._added * self._added / np.maximum(self._added2, 1e-300)
        return np.asarray(self._shown * np.minimum(noise * (FIRST + count) / (FIRST + count * noise), 1.0))

    @property
    def note(self) -> str:
        """By how much the mount is off where a claim allows that, in words; empty: by nothing that shows."""
        yaw, lever, _ = self.sigmas
        return self._beyond(NOTED_RAD + SIGMAS * yaw, NOTED_M + SIGMAS * lever)

    def _beyond(self, rad: float, metres: float) -> str:
        """By how much the mount is off by more than so much, in words; or empty."""
        if abs(self.yaw) > rad:
            return TURNED.format(round(degrees(self.yaw)))
        return AWAY.format(self.lever) if self.lever > metres else ""

    def _judge(self) -> None:
        noise = NOISE_SHOWS * (self._intervals - FIRST) * (self._squares / self._intervals)
        self._found, self._spread = _without_noise(self._information, self._sums, noise)
        yaw, lever, scale = self.sigmas
        self.within = _below(NEAR_RAD, abs(self.yaw), yaw) * _below(NEAR_M, self.lever, lever)
        mount, scaled = self._ratios(self._shown)
        if mount > 0.0 or scaled > 0.0:  # doubt needs information that stands alone
            alone = self._ratios(self._shown_alone)
            mount, scaled = min(mount, max(alone[0], 0.0)), min(scaled, max(alone[1], 0.0))
        self.fault = self._beyond(NEAR_RAD / 2.0 + SIGMAS * yaw, NEAR_M / 2.0 + SIGMAS * lever)
        if not self.fault and abs(self.scale - 1.0) > SCALE_OFF / 2.0 + SIGMAS * scale:
            self.fault = SCALED.format(self.scale)
        self.proven = min(right_share(mount), max(right_share(scaled), 1.0 - WRONG))
        if self.fault or self.proven < PROVEN:  # what happens to agree by chance is no proof
            self.proven = min(self.proven, 1.0 - WRONG)

    def _ratios(self, shown: Array) -> tuple[float, float]:
        """Log-likelihood ratios of a wrong mount, and of another scale, by the information `shown` (4,)."""
        along, turned, *away = shown.tolist()
        return max(
            _ratio(NEAR_RAD, abs(self.yaw), turned, START[1], YAW_RAD),
            _ratio(NEAR_M, self.lever, min(away), START[2], LEVER_M),
        ), _ratio(SCALE_OFF, abs(self.scale - 1.0), along, START[0], SCALE)


def _below(limit: float, value: float, sigma: float) -> float:
    """Probability that what is normal around `value` lies below `limit`."""
    return 0.5 * (1.0 + erf((limit - value) / (sqrt(2.0) * sigma)))


def _ratio(wrong: float, value: float, shown: float, start: float, least: float) -> float:
    """Log-likelihood ratio of `wrong` against 0, by the information `shown` alone.

    `value` was found with a prior of sigma `start` too. Errors of `least` do not average out.
    """
    pull = (shown + start**-2) * value
    return wrong * (pull - 0.5 * wrong * shown) / (1.0 + least * least * shown)


@njit("Tuple((f8[::1], f8[:,::1]))(f8[:,::1], f8[::1])", cache=True)  # pragma: no cover - compiled
def _found(information: Array, sums: Array) -> tuple[Array, Array]:
    """The four numbers (4,) and their covariance (4, 4), by what was assumed and what motion has shown."""
    P = FIRST_INFORMATION + information
    P[:] = np.linalg.inv(P)
    return P @ (FIRST_INFORMATION @ RIGHT + sums), P


@njit(  # pragma: no cover - compiled
    "Tuple((f8[::1], f8[:,::1]))(f8[:,::1], f8[::1], f8)", cache=True
)
def _without_noise(information: Array, sums: Array, noise: float) -> tuple[Array, Array]:
    """What was found (4,) and its covariance (4, 4), less what `noise` may show of the scale: NOISE_SHOWS.

    At most what motion shows of the scale beside the others.
    """
    explained = information[0, 1:] @ np.linalg.pinv(information[1:, 1:].copy())
    own = information[0, 0] - explained @ information[1:, 0].copy()
    if own <= 0.0:
        return _found(information, sums)
    left_out = min(noise / own, 1.0)
    less, rest = information.copy(), sums.copy()
    less[0, 0] -= left_out * own
    rest[0] -= left_out * (sums[0] - explained @ sums[1:])
    return _found(less, rest)


@njit(  # pragma: no cover - compiled
    "UniTuple(f8, 3)(f8[:,::1], f8[::1], UniTuple(f8, 3), UniTuple(f8, 3), f8, f8, f8, f8, f8)", cache=True
)
def _update(
    information: Array, sums: Array, scans: Pose, spread: tuple[float, float, float], noise: float, x: float,
    y: float, scale: float, tail: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Adds a motion to `information` (4, 4) and `sums` (4,); gives the innovation's squared length.

    By how many nats what is stated explains the motion better than what was found. And the motion's
    log-density (Student's t), as predicted.

    Variances are in units of `scale`, the noise's share of what is assumed. Encoders may have
    no sign, so the direction counts that fits better.
    """
    cos, sin = np.cos(scans[2]), np.sin(scans[2])
    H = np.array([[x, -y, cos - 1.0, -sin], [y, x, sin, cos - 1.0]])
    seen = np.array([scans[0], scans[1]])
    found, P = _found(information, sums)
    back = H.copy()
    back[:, :2] = -H[:, :2]
    if np.abs(seen - back @ found).sum() < np.abs(seen - H @ found).sum():
        H = back
    off = seen - H @ found
    S = H @ P @ H.T
    R = np.array([[spread[0] + noise, spread[1]], [spread[1], spread[2] + noise]])
    forth, backwards = seen - H[:, 0], seen + H[:, 0]
    stated = min(forth @ np.linalg.solve(R, forth), backwards @ np.linalg.solve(R, backwards))
    better = 0.5 * (off @ np.linalg.solve(R, off) - stated) / scale
    distance2 = float(off @ np.linalg.solve(S + R, off)) / scale
    fits = -0.5 * (np.log(np.linalg.det(scale * (S + R))) + (tail + 2.0) * np.log1p(distance2 / tail))
    # the noise is larger by how surprising the innovation is
    R *= max(1.0, (tail + distance2) / (tail + 3.0))
    weighed = H.T @ np.linalg.inv(R)
    information += weighed @ H
    sums += weighed @ seen
    return float(off @ np.linalg.solve(S + R, off)), float(better), float(fits)
