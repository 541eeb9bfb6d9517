"""Searches again for a scan of which no place is sure, without the eigenspace.

Where walls are missing in the map, or people hide them, a part of the beams contradicts the right pose. In
eigenspace each of these moves the whole scan. Here each counts no more than `verify` lets it, and the scan is
compared with the predicted one of every searched position and heading, by every third beam.
"""

from __future__ import annotations

import numpy as np
from eigenscan.eigenspace.analysis import HEADING_STRIDE
from eigenscan.geometry.circle import difference
from eigenscan.projector.candidates import Candidates
from eigenscan.projector.tables import HEADINGS
from eigenscan.projector.verification import Steps, cost_of_beam, in_steps
from numba import njit
from numpy.typing import NDArray

Index = NDArray[np.int64]
Costs = NDArray[np.int32]

SURE_LEAD = 5.0
"""Nats by which the best pose leads the next place when no second search is needed: more is no evidence to
the tracker."""
APART_M, APART_RAD = 0.5, np.deg2rad(10.0)
"""Poses this far from each other are two places."""
_BINS = 2048
"""By which costs are chosen, from the least to the largest."""


def is_unsure(found: Candidates) -> bool:
    """Whether another place explains the scan nearly as well as the best pose does."""
    if not len(found.poses):
        return False
    away = np.hypot(*(found.poses - found.poses[0])[:, :2].T)
    turn = np.abs(difference(found.poses[:, 2], found.poses[0, 2]))
    other = (away > APART_M) | (turn > APART_RAD)
    next_best = found.log_likelihoods[other].max(initial=-np.inf)
    return bool(found.log_likelihoods[0] - next_best < SURE_LEAD)


def most_alike(
    windows: Steps,
    leaves: Steps,
    positions: Index,
    coarse: NDArray[np.float32],
    range_max: float,
    count: int,
) -> tuple[Index, Index]:
    """The poses whose predicted scans differ least, by the cost of `verify`: at most `count`, in no order.

    Given are their positions (n,) among `positions`, and windows (n,). `windows` and `leaves` are those of
    `predicted`, `coarse` (J,) is the scan. Fewer than `count` are given where the next ones are alike.
    """
    few = coarse[::HEADING_STRIDE]
    if not len(positions) or not np.isfinite(few).any():
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    scan, weight, _ = in_steps(few, range_max)
    cost = np.empty((len(positions), HEADINGS), dtype=np.int32)
    _compare(windows, leaves, positions, scan, weight, cost)
    row, heading = _least(cost, count)
    return positions[row], heading * HEADING_STRIDE


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _compare(
    windows: Steps, leaves: Steps, positions: Index, scan: Steps, weight: Steps, cost: Costs
) -> None:
    """Fills the cost of each position (n,) at each heading (n, HEADINGS)."""
    beams = HEADINGS + len(scan)
    enter, leave = np.empty(beams, dtype=np.int16), np.empty(beams, dtype=np.int16)
    for i in range(len(positions)):
        # side by side, so that a vector holds many
        for k in range(beams):
            at = HEADING_STRIDE * (k % HEADINGS)
            enter[k], leave[k] = windows[positions[i], at], leaves[positions[i], at]
        for h in range(HEADINGS):
            total = np.int32(0)
            for j in range(len(scan)):
                total = np.int32(total + cost_of_beam(scan[j], enter[h + j], leave[h + j], weight[j]))
            cost[i, h] = total


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _least(cost: Costs, count: int) -> tuple[Index, Index]:
    """Rows and columns of the least of (n, h)."""
    low, high = cost.min(), cost.max()
    scale = (_BINS - 1) / max(high - low, 1)
    bins = np.zeros(_BINS, dtype=np.int64)
    for i in range(len(cost)):
        for h in range(cost.shape[1]):
            bins[int((cost[i, h] - low) * scale)] += 1
    last, chosen = -1, 0
    while last + 1 < _BINS and chosen + bins[last + 1] <= count:
        last += 1
        chosen += bins[last]
    row, column = np.empty(chosen, dtype=np.int64), np.empty(chosen, dtype=np.int64)
    k = 0
    for i in range(len(cost)):
        for h in range(cost.shape[1]):
            if int((cost[i, h] - low) * scale) <= last:
                row[k], column[k] = i, h
                k += 1
    return row, column
