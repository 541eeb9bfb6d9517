"""How well predicted scans explain a scan: one-sided truncated L1 over windows of the panoramas.

A beam that ends in the wall, between where it enters it and where it would leave it, costs nothing.

Each candidate of the search lattice is tried at the neighbouring headings, and the better ones also at the
neighbouring positions of the model's own grid.
"""

from __future__ import annotations

import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN
from eigenscan.geometry.circle import TURN
from eigenscan.projector.lattice import Lattice
from eigenscan.projector.observation import by_reach
from numba import njit
from numpy.typing import NDArray

SHORT, LONG = 0.5, 1.0
"""m: a beam that ends before its wall by more says no more, nor one that ends behind it: people and open
doors shorten a beam, but nothing lets it through a wall."""
RANGE_CAP = 10.0
"""m: beyond, ranges differ too much within a grid cell to be compared."""
OVERSHOT_M = 0.5
"""m behind a wall from which on a beam went through it: what a panorama shows half a grid cell off is no
nearer to what a pose sees.
"""
EMPTY_WEIGHT = 0.5
"""Of a beam that came back empty to a short-sighted sensor: dark and slanted walls give none either."""


def predicted(panoramas: NDArray[np.float32], beams: int, range_max: float) -> NDArray[np.float32]:
    """Panoramas (P, N) clipped, with their first beams once more behind their last: (P, N + beams)."""
    cap = _cap(range_max)
    clipped = np.minimum(panoramas, np.float32(cap))
    return np.concatenate([clipped, clipped[:, :beams]], axis=1)


def _cap(range_max: float) -> float:
    return min(RANGE_CAP, range_max) if range_max > 0 else RANGE_CAP


def verify(
    windows: NDArray[np.float32],
    leaves: NDArray[np.float32],
    lattice: Lattice,
    position: NDArray[np.int64],
    heading: NDArray[np.int64],
    coarse: NDArray[np.float32],
    range_max: float,
    climbing: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """The best neighbours of candidates: position (n,), heading (n,) and cost (n,), m, in the same order.

    Beams count `by_reach`.
    `windows` and `leaves` as of `predicted`; `coarse` (J,) the scan; the `climbing` best also move in
    position.
    """
    cap = _cap(range_max)
    empty_counts = 0.0 < range_max <= RANGE_CAP
    finite, empty = np.isfinite(coarse), np.isinf(coarse)
    weight = np.where(empty, np.float32(EMPTY_WEIGHT if empty_counts else 0.0), np.float32(0.0))
    scan = np.where(finite | empty, np.minimum(coarse, np.float32(cap)), np.float32(0.0))
    weight[finite] = by_reach(scan[finite])
    best_position, best_heading = position.copy(), heading.copy()
    cost = np.empty(len(position), dtype=np.float32)
    _turn(windows, leaves, best_position, best_heading, scan, weight, cost)
    if lattice.finer:
        better = np.argsort(cost)[:climbing]
        _climb(windows, leaves, lattice.neighbours, better, best_position, best_heading, scan, weight, cost)
    return best_position, best_heading, cost / max(float(weight.sum()), 1e-9)


def overshot(
    leaves: NDArray[np.float32],
    lattice: Lattice,
    home: NDArray[np.int64],
    poses: NDArray[np.float64],
    beams: NDArray[np.int64],
    seen: NDArray[np.float32],
    angle_min: float,
    range_max: float,
) -> NDArray[np.float32]:
    """Whether `beams` (B,) of poses (n, 3) near positions `home` (n,) went through a wall: (n, B), 1 or 0.

    By the nearest panorama, half a grid cell off: what costs nothing, for what needs no more. `leaves` as of
    `predicted`; `seen` (B,) are the beams' ranges.
    """
    out = np.empty((len(poses), len(beams)), dtype=np.float32)
    grid = lattice.positions, lattice.neighbours, lattice.spacing
    beams = np.ascontiguousarray(beams)
    _overshot(leaves, grid, home, poses, angle_min, beams, seen, np.float32(_cap(range_max)), out)
    return out


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _overshot(
    leaves: NDArray[np.float32],
    grid: tuple[NDArray[np.float64], NDArray[np.int32], float],
    home: NDArray[np.int64],
    poses: NDArray[np.float64],
    angle_min: float,
    beams: NDArray[np.int64],
    seen: NDArray[np.float32],
    cap: np.float32,
    out: NDArray[np.float32],
) -> None:
    positions, neighbours, spacing = grid
    one, zero = np.float32(1.0), np.float32(0.0)
    for i in range(len(poses)):
        near = home[i]
        column = int(min(max(np.rint((poses[i, 0] - positions[near, 0]) / spacing), -1.0), 1.0))
        row = int(min(max(np.rint((poses[i, 1] - positions[near, 1]) / spacing), -1.0), 1.0))
        there = neighbours[near, 3 * (column + 1) + row + 1]
        panorama = leaves[near if there < 0 else there]
        first = int(np.rint((poses[i, 2] + angle_min) * (ANALYSIS_TURN / TURN))) % ANALYSIS_TURN
        for j in range(len(beams)):
            leave = panorama[first + beams[j]]
            # at the cap nothing is known of where it leaves
            out[i, j] = one if leave < cap and seen[j] > leave + np.float32(OVERSHOT_M) else zero


@njit(cache=True, nogil=True, fastmath=True, inline="always")  # pragma: no cover - compiled
def _cost(
    enter: NDArray[np.float32],
    leave: NDArray[np.float32],
    scan: NDArray[np.float32],
    weight: NDArray[np.float32],
) -> np.float32:
    total, none = np.float32(0.0), np.float32(0.0)
    for j in range(len(scan)):
        beyond, before = scan[j] - leave[j], enter[j] - scan[j]
        total += weight[j] * max(min(beyond, np.float32(LONG)), min(before, np.float32(SHORT)), none)
    return total


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _turn(
    windows: NDArray[np.float32],
    leaves: NDArray[np.float32],
    position: NDArray[np.int64],
    heading: NDArray[np.int64],
    scan: NDArray[np.float32],
    weight: NDArray[np.float32],
    cost: NDArray[np.float32],
) -> None:
    beams = len(scan)
    turn = windows.shape[1] - beams
    for i in range(len(position)):
        centre = heading[i]
        cost[i] = np.float32(np.inf)
        for step in (0, -1, 1):
            k = (centre + step) % turn
            c = _cost(windows[position[i], k : k + beams], leaves[position[i], k : k + beams], scan, weight)
            if c < cost[i]:
                cost[i], heading[i] = c, k


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _climb(
    windows: NDArray[np.float32],
    leaves: NDArray[np.float32],
    neighbours: NDArray[np.int32],
    which: NDArray[np.int64],
    position: NDArray[np.int64],
    heading: NDArray[np.int64],
    scan: NDArray[np.float32],
    weight: NDArray[np.float32],
    cost: NDArray[np.float32],
) -> None:
    beams = len(scan)
    turn = windows.shape[1] - beams
    for w in range(len(which)):
        i = which[w]
        around, centre = neighbours[position[i]], heading[i]
        for n in range(9):
            p = around[n]
            if p < 0:
                continue
            for step in (-1, 0, 1):
                k = (centre + step) % turn
                c = _cost(windows[p, k : k + beams], leaves[p, k : k + beams], scan, weight)
                if c < cost[i]:
                    cost[i], heading[i], position[i] = c, k, p
