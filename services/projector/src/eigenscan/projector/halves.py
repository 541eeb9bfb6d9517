"""Chooses scans that are searched for again, and the halves of their beams by which they are.

Where walls are missing in the map, or people hide them, a part of the beams contradicts the right pose, and
the whole scan resembles others more. The rest of the beams alone may still find it.
"""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.circle import difference
from eigenscan.projector.candidates import Candidates
from numpy.typing import NDArray

SURE_LEAD = 3.0
"""Nats by which the best pose leads the next place when no second search is needed. With 5, at most 2 of 100
scans more are found (benchmarks/maps.py --way missing: one scan)."""
APART_M, APART_RAD = 0.5, np.deg2rad(10.0)
"""Poses this far from each other are two places."""
HALVES = 4
"""Each begins a quarter of the beams after the last, so that each quarter is left out with each beside it."""


def is_unsure(found: Candidates) -> bool:
    """Whether another place explains the scan nearly as well as the best pose does."""
    if not len(found.poses):
        return False
    away = np.hypot(*(found.poses - found.poses[0])[:, :2].T)
    turn = np.abs(difference(found.poses[:, 2], found.poses[0, 2]))
    other = (away > APART_M) | (turn > APART_RAD)
    next_best = found.log_likelihoods[other].max(initial=-np.inf)
    return bool(found.log_likelihoods[0] - next_best < SURE_LEAD)


def halves(returned: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """Halves (J,) of the beams `returned` (J,), each in one piece around the scan."""
    which = np.flatnonzero(returned)
    found = []
    for k in range(HALVES):
        half = np.zeros_like(returned)
        half[np.roll(which, -(k * len(which) // HALVES))[: -(-len(which) // 2)]] = True
        found.append(half)
    return found
