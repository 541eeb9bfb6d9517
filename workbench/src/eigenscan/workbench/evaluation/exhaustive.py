"""Compares one scan with every position and heading of the panoramas, by truncated L1.

It searches the projector's poses without leaving any out: a reference for the projector's hits and cost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.pose import compose, inverse
from numpy.typing import NDArray

TRUNCATION_M = 1.0
"""Largest error of a beam that counts, m: a larger one only shows that the beam does not fit."""
UNIT_M = 0.01
LARGEST = np.iinfo(np.uint16).max


@dataclass(frozen=True)
class Gallery:
    """All panoramas of a map, once each.

    `positions` (P, 2) m in the map frame; `ranges` (P, 2N) int16 in centimetres, each row twice, so
    that every heading is one contiguous stretch; `beams` N over a full turn.
    """

    positions: NDArray[np.float64]
    ranges: NDArray[np.int16]
    beams: int
    cap_m: float

    def up_to(self, reach_m: float) -> Gallery:
        """The same as a sensor of that reach sees it; 0 or less: not limited."""
        if not 0.0 < reach_m < self.cap_m:
            return self
        seen = np.minimum(self.ranges, np.int16(round(reach_m / UNIT_M)))
        return Gallery(self.positions, seen, self.beams, reach_m)

    def first(self) -> Gallery:
        """The first position alone."""
        return Gallery(self.positions[:1], self.ranges[:1], self.beams, self.cap_m)


def gallery(positions: NDArray[np.float64], ranges: NDArray[np.float64], cap_m: float) -> Gallery:
    """Gallery of panoramas (P, N), m, clipped to `cap_m`; values that are not finite become the cap."""
    capped = np.nan_to_num(ranges, nan=cap_m, posinf=cap_m).clip(0.0, cap_m)
    cm = np.round(capped / UNIT_M).astype(np.int16)
    return Gallery(positions, np.ascontiguousarray(np.hstack([cm, cm])), ranges.shape[1], cap_m)


def best_pose(
    shown: Gallery,
    ranges: NDArray[np.float64],
    directions: NDArray[np.float64],
    mount: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """Base pose (3,) of the panorama nearest to a scan; None if no beam can be compared."""
    poses = best_poses(shown, ranges, directions, mount)
    return poses[0] if len(poses) else None


def best_poses(
    shown: Gallery,
    ranges: NDArray[np.float64],
    directions: NDArray[np.float64],
    mount: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Base poses (P, 3), nearest first: each position at its best heading. Arguments as of `best_pose`."""
    limit = round(TRUNCATION_M / UNIT_M)
    used = np.flatnonzero(~np.isnan(ranges))
    if not len(used):
        return np.empty((0, 3))
    # so few that their sum fits 16 bits: every k-th of a very dense sensor
    used = used[:: -(-len(used) // (LARGEST // limit))]
    step = TURN / shown.beams
    exact = directions[used] / step
    bins = np.round(exact).astype(np.int64)
    observed = np.round(np.minimum(ranges[used], shown.cap_m) / UNIT_M).astype(np.int16)
    cost, heading = _nearest(shown.ranges, np.mod(bins, shown.beams), observed, np.int16(limit))
    order = np.argsort(cost, kind="stable")
    # the beams' own rounding to the grid turns the heading by their mean remainder
    theta = (heading[order] - float(np.mean(exact - bins))) * step
    return compose(np.column_stack([shown.positions[order], theta]), inverse(mount))


@numba.njit(cache=True, nogil=True)
def _nearest(
    panoramas: NDArray[np.int16],
    bins: NDArray[np.int64],
    observed: NDArray[np.int16],
    limit: np.int16,
) -> tuple[NDArray[np.uint16], NDArray[np.int64]]:
    """Of each row the least sum of truncated differences and its heading; the first of equals."""
    headings = panoramas.shape[1] // 2
    best = np.empty(panoramas.shape[0], dtype=np.uint16)
    best_heading = np.empty(panoramas.shape[0], dtype=np.int64)
    cost = np.empty(headings, dtype=np.uint16)
    for row in range(panoramas.shape[0]):
        cost[:] = 0
        for beam in range(len(bins)):
            seen = observed[beam]
            predicted = panoramas[row, bins[beam] : bins[beam] + headings]
            for heading in range(headings):
                gap = np.int16(predicted[heading] - seen)
                gap = max(gap, np.int16(-gap))
                cost[heading] = np.uint16(cost[heading] + np.uint16(min(gap, limit)))
        best_heading[row] = np.argmin(cost)
        best[row] = cost[best_heading[row]]
    return best, best_heading
