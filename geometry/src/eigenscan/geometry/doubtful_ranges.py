"""Ranges that no lidar on a robot measures: of a covered one, or in another unit than m."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.normalize import Ranges

ONE_VALUE_M = 0.1
"""Spread of the middle nine tenths of the ranges, m, below which all beams have one value: only a cover does,
or a round room with the robot at its centre."""
LEAST_BEAMS, LEAST_SPAN = 10, np.pi / 2.0
"""Fewer beams, or a narrower sector (rad), may well see one value."""
NEAREST_M = 100.0
"""A twentieth of the returns is nearer than this, whatever the lidar, unless its ranges are no metres."""


def one_value(ranges: Ranges, step: float) -> bool:
    """Whether all beams of a canonical scan, `step` rad apart, have one value: a covered lidar."""
    if len(ranges) * step < LEAST_SPAN:
        return False
    known = ranges[np.isfinite(ranges)]
    if len(known) < max(LEAST_BEAMS, len(ranges) // 2):
        return False
    low, high = _most(known)
    return high - low <= ONE_VALUE_M


def not_in_metres(ranges: Ranges) -> bool:
    """Whether a raw scan's ranges are rather millimetres or centimetres.

    Those of a driver that marks beams without a return by one far value, such as 1000, are not.
    """
    known = ranges[(ranges > 0.0) & (ranges < np.inf)]
    if len(known) < LEAST_BEAMS or known[len(known) // 2] < NEAREST_M:  # so for most scans: no need to sort
        return False
    low, high = _most(known)
    return low > NEAREST_M and high - low > ONE_VALUE_M


def _most(known: Ranges) -> tuple[float, float]:
    """Between which values the middle nine tenths of ranges lie, by about a hundred of them."""
    ordered = np.sort(known[:: max(len(known) // 100, 1)])
    tail = len(ordered) // 20
    return float(ordered[tail]), float(ordered[-1 - tail])
