"""Compares predicted scans with a scan: truncated L1 over windows of the panoramas.

A beam that ends in the wall, between the ranges at which it enters and leaves it, costs nothing. Each
candidate of the search lattice is tried at the neighbouring headings, and the better ones also at the
neighbouring positions of the model's grid.
"""

from __future__ import annotations

import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN
from eigenscan.geometry.circle import TURN
from eigenscan.projector.lattice import Lattice
from eigenscan.projector.observation import by_reach
from numba import njit
from numpy.typing import NDArray

UNLIKE = 0.5
"""m: a beam that ends farther from its wall counts no more, on either side. People and open doors shorten
beams; what is gone since the map was made lengthens them (benchmarks/single_scan.py).
"""
RANGE_CAP = 10.0
"""m: beyond, ranges differ too much within a grid cell to be compared."""
OVERSHOT_M = 0.5
"""m behind a wall from which on a beam went through it: what a panorama shows half a grid cell off is no
nearer to what a pose sees.
"""
Steps = NDArray[np.int16]
"""Ranges in STEPS."""
STEPS = 2000
"""Of a metre: ranges are whole numbers of 16 bits, so that vectors hold twice as many and caches too."""
_SHARES = 2048
"""Steps of a beam's weight. A cost is at most STEPS * UNLIKE * _SHARES * ANALYSIS_TURN, and fits 32 bits."""
_MOST = np.iinfo(np.int16).max
_LANES = 32
"""Such numbers in the widest vector registers."""
EMPTY_WEIGHT = 0.5
"""Weight of a beam without a return of a short-range sensor: dark and slanted walls give none either."""


def predicted(panoramas: NDArray[np.float32], beams: int, range_max: float) -> Steps:
    """Panoramas (P, N) clipped, in STEPS, with their first beams repeated after their last: (P, W)."""
    around = np.arange(width(beams)) % panoramas.shape[1]
    return _in_steps(np.minimum(panoramas, cap(range_max)))[:, around]


def width(beams: int) -> int:
    """W: beams of a panorama and those repeated, for a scan of this many beams and the windows beside it."""
    return ANALYSIS_TURN + _room(beams) + 2


def _room(beams: int) -> int:
    """Rounds up to whole vectors, because the rest of a loop is slow."""
    return -(-beams // _LANES) * _LANES


def _in_steps(ranges: NDArray[np.float32]) -> Steps:
    steps: Steps = np.rint(ranges * np.float32(STEPS)).astype(np.int16)
    return steps


def cap(range_max: float) -> np.float32:
    """Range, m, from which on all are alike, for a sensor's longest."""
    return np.float32(min(RANGE_CAP, range_max) if range_max > 0 else RANGE_CAP)


def verify(
    windows: Steps,
    leaves: Steps,
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
    scan, weight, total = in_steps(coarse, range_max)
    unit = STEPS * max(total, 1)
    best_heading, cost = np.empty_like(heading), np.empty(len(position), dtype=np.int32)
    _turn(windows, leaves, position, heading, scan, weight, best_heading, cost)
    if lattice.finer:
        position, better = position.copy(), np.arange(len(cost))
        if climbing < len(cost):
            better = np.argpartition(cost, climbing)[:climbing]
        _climb(windows, leaves, lattice.neighbours, better, position, best_heading, scan, weight, cost)
    return position, best_heading, (cost / unit).astype(np.float32)


def in_steps(coarse: NDArray[np.float32], range_max: float) -> tuple[Steps, Steps, int]:
    """A scan (J,) in STEPS and its beams' weights, filled up to whole vectors; and the sum of the weights."""
    most = cap(range_max)
    counted = by_reach(np.minimum(coarse[np.isfinite(coarse)], most))
    scan, weight = np.zeros((2, _room(len(coarse))), dtype=np.int16)
    return scan, weight, _weigh(coarse, most, counted, 0.0 < range_max <= RANGE_CAP, scan, weight)


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _weigh(
    coarse: NDArray[np.float32],
    cap: np.float32,
    counted: NDArray[np.float64],
    empty_counts: bool,
    scan: Steps,
    weight: Steps,
) -> int:
    """Fills a scan (J,) in STEPS and its weights, `counted` (n,) of beams that came back; gives their sum."""
    returned, total = 0, 0
    for j in range(len(coarse)):
        if np.isnan(coarse[j]):
            continue
        scan[j] = np.int16(np.rint(min(coarse[j], cap) * np.float32(STEPS)))
        count = EMPTY_WEIGHT if empty_counts else 0.0
        if np.isfinite(coarse[j]):
            count, returned = counted[returned], returned + 1
        weight[j] = np.int16(min(np.rint(count * _SHARES), np.float64(_MOST)))
        total += weight[j]
    return total


Grid = tuple[NDArray[np.float64], NDArray[np.int32], float]
"""A lattice as compiled code takes it: positions, neighbours and spacing."""


def grid_of(lattice: Lattice) -> Grid:
    """The lattice for `find_overshot`."""
    return lattice.positions, lattice.neighbours, lattice.spacing


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def find_overshot(
    leaves: Steps,
    grid: Grid,
    home: NDArray[np.int64],
    poses: NDArray[np.float64],
    angle_min: float,
    beams: NDArray[np.int64],
    seen: NDArray[np.float32],
    cap: np.float32,
    out: NDArray[np.float32],
) -> None:
    """Whether `beams` (B,) of poses (n, 3) near positions `home` (n,) went through a wall: 1 or 0, (n, B).

    Uses the nearest panorama, up to half a grid cell away: it costs nothing and is exact enough here.
    `leaves` as of `predicted`; `seen` (B,) are the beams' ranges.
    """
    positions, neighbours, spacing = grid
    farthest = np.int16(np.rint(cap * STEPS))
    # unsigned: an index that cannot be negative is not looked at twice
    ahead = beams.astype(np.uint32)
    for i in range(len(poses)):
        near = home[i]
        column = int(min(max(np.rint((poses[i, 0] - positions[near, 0]) / spacing), -1.0), 1.0))
        row = int(min(max(np.rint((poses[i, 1] - positions[near, 1]) / spacing), -1.0), 1.0))
        there = neighbours[near, 3 * (column + 1) + row + 1]
        window = int(np.rint((poses[i, 2] + angle_min) * (ANALYSIS_TURN / TURN))) % ANALYSIS_TURN
        panorama = leaves[near if there < 0 else there, window:]
        for j in range(len(ahead)):
            leave = panorama[np.uint64(ahead[j])]
            # at the cap nothing is known of where it leaves
            beyond = leave * np.float32(1.0 / STEPS) + np.float32(OVERSHOT_M)
            out[i, j] = np.float32((leave < farthest) & (seen[j] > beyond))


@njit(cache=True, nogil=True, inline="always")  # pragma: no cover - compiled
def cost_of_beam(scan: np.int16, enter: np.int16, leave: np.int16, weight: np.int16) -> np.int32:
    """What a beam of this range costs whose wall is from `enter` to `leave`, all in STEPS."""
    # each step narrow, so that a vector holds many
    beyond, before = np.int16(scan - leave), np.int16(enter - scan)
    steps = min(max(beyond, before, np.int16(0)), np.int16(UNLIKE * STEPS))
    return np.int32(np.int32(weight) * np.int32(steps))


@njit(cache=True, nogil=True, inline="always")  # pragma: no cover - compiled
def _best_of_three(enter: Steps, leave: Steps, scan: Steps, weight: Steps) -> tuple[np.int32, int]:
    """The least cost of a scan (J,) at three windows beside each other, and where: -1, 0 or 1.

    `enter` and `leave` (J + 2,), from the first window's first beam on. What is loaded serves all three.
    """
    left, middle, right = np.int32(0), np.int32(0), np.int32(0)
    for j in range(len(scan)):
        s, w = scan[j], weight[j]
        left = np.int32(left + cost_of_beam(s, enter[j], leave[j], w))
        middle = np.int32(middle + cost_of_beam(s, enter[j + 1], leave[j + 1], w))
        right = np.int32(right + cost_of_beam(s, enter[j + 2], leave[j + 2], w))
    least, step = middle, 0
    if left < least:
        least, step = left, -1
    if right < least:
        least, step = right, 1
    return least, step


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _turn(
    windows: Steps,
    leaves: Steps,
    position: NDArray[np.int64],
    heading: NDArray[np.int64],
    scan: Steps,
    weight: Steps,
    turned: NDArray[np.int64],
    cost: NDArray[np.int32],
) -> None:
    for i in range(len(position)):
        p, first = position[i], (heading[i] - 1) % ANALYSIS_TURN
        last = first + len(scan) + 2
        cost[i], step = _best_of_three(windows[p, first:last], leaves[p, first:last], scan, weight)
        turned[i] = (first + 1 + step) % ANALYSIS_TURN


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _climb(
    windows: Steps,
    leaves: Steps,
    neighbours: NDArray[np.int32],
    which: NDArray[np.int64],
    position: NDArray[np.int64],
    heading: NDArray[np.int64],
    scan: Steps,
    weight: Steps,
    cost: NDArray[np.int32],
) -> None:
    for w in range(len(which)):
        i = which[w]
        around, first = neighbours[position[i]], (heading[i] - 1) % ANALYSIS_TURN
        last = first + len(scan) + 2
        for n in range(9):
            p = around[n]
            if p < 0:
                continue
            c, step = _best_of_three(windows[p, first:last], leaves[p, first:last], scan, weight)
            if c < cost[i]:
                cost[i], heading[i], position[i] = c, (first + 1 + step) % ANALYSIS_TURN, p
