"""How probable a motion is that the scans show: where another is predicted, and where nothing is."""

from __future__ import annotations

from math import log, pi

import numpy as np
from eigenscan.tracker.planar import Pose
from eigenscan.tracker.symmetric import wrapped
from numba import njit

SIGMA_M, SIGMA_RAD, SIGMA_SHARE = 0.03, 0.025, 0.15
"""m, rad: what both motions over an interval differ by where nothing is wrong, and the share of the way and
of the turn on top. These and the chances in `faults` were chosen on intel and fr079: benchmarks/mechanisms.py
--fault."""
DRIVES, SIDEWAYS, TURNS = 0.2, 0.05, 0.2
"""m, m, rad: sigma of a motion between two scans that nothing predicts."""
ODD = 0.02
"""Share of right motions that the fit finds somewhere else."""
SHARES = (1.0, 0.5, 0.25)
EXACT = tuple((of_way, of_turn) for of_way in SHARES for of_turn in SHARES)
"""Shares of these sigmas by which way and turn of a robot that moves may really differ, the whole first.

On intel, whose odometry has steps of 1.4 degrees, they differ by the whole; on guardian 2 by a fifth.
"""


@njit("f8(f8, f8, f8, UniTuple(f8, 3), f8, f8, f8)", cache=True)  # pragma: no cover - compiled
def log_gaussian(
    x: float, y: float, turn: float, spread: tuple[float, float, float], turn_variance: float,
    sigma: float, turn_sigma: float,
) -> float:  # fmt: skip
    """Ln of the density at (x, y, turn), `sigma` m and `turn_sigma` rad beside the fit's own covariance."""
    xx, xy, yy = spread[0] + sigma**2, spread[1], spread[2] + sigma**2
    tt, determinant = turn_variance + turn_sigma**2, xx * yy - xy * xy
    turned = wrapped(turn)
    distance2 = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant + turned * turned / tt
    return float(-0.5 * (distance2 + log(determinant * tt)) - 1.5 * log(2.0 * pi))


@njit("f8(UniTuple(f8, 3), UniTuple(f8, 3), f8)", cache=True)  # pragma: no cover - compiled
def unpredicted(scans: Pose, spread: tuple[float, float, float], turn_variance: float) -> float:
    """Ln of the density of a motion that nothing predicts: half of the robots drive straight on."""
    x, y, turn = scans
    xx, xy, yy = spread
    wide = (xx + DRIVES**2, xy, yy + SIDEWAYS**2)
    straight = log_gaussian(x, y, turn, wide, turn_variance, 0.0, SIGMA_RAD)
    turning = log_gaussian(x, y, turn, wide, turn_variance, 0.0, TURNS)
    return float(np.logaddexp(straight, turning) - log(2.0))
