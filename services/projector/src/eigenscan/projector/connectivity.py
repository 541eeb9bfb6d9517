"""Keeps only the best candidate of each patch of the pose space (paper, section 5.1)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_BUCKETS = 2048
"""Of the hash of the plane's squares; a power of two, several times what is kept."""


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def best_of_neighbourhoods(
    poses: NDArray[np.float64], order: NDArray[np.int64], apart_m: float, apart_rad: float, count: int
) -> NDArray[np.int64]:
    """At most `count` indices of poses (n, 3) out of `order`, best first, none near a better one in both."""
    kept = np.empty(count, dtype=np.int64)
    # those kept, by the square of the plane that they lie in: a near one lies in one of nine
    bucket = np.full(_BUCKETS, -1, dtype=np.int32)
    following = np.empty(count, dtype=np.int32)
    found = 0
    for i in order:
        if found == count:
            break
        column, row = int(np.floor(poses[i, 0] / apart_m)), int(np.floor(poses[i, 1] / apart_m))
        free = True
        for step in range(9):
            square = (step + 4) % 9  # its own first: most of those near it lie there
            k = bucket[_hashed(column + square % 3 - 1, row + square // 3 - 1)]
            while k >= 0 and free:
                free = not _are_near(poses, i, kept[np.uint64(k)], apart_m, apart_rad)
                k = following[np.uint64(k)]
            if not free:
                break
        if free:
            own = _hashed(column, row)
            kept[found], following[found], bucket[own] = i, bucket[own], found
            found += 1
    return kept[:found]


@njit(cache=True, nogil=True, inline="always")  # pragma: no cover - compiled
def _are_near(poses: NDArray[np.float64], i: int, k: int, apart_m: float, apart_rad: float) -> bool:
    if (poses[i, 0] - poses[k, 0]) ** 2 + (poses[i, 1] - poses[k, 1]) ** 2 > apart_m * apart_m:
        return False
    turn = abs(poses[i, 2] - poses[k, 2]) % (2.0 * np.pi)
    return bool(min(turn, 2.0 * np.pi - turn) <= apart_rad)


@njit(cache=True, nogil=True, inline="always")  # pragma: no cover - compiled
def _hashed(column: int, row: int) -> np.uint64:
    # unsigned: an index that cannot be negative is not looked at twice
    return np.uint64((column * 73856093 ^ row * 19349663) & (_BUCKETS - 1))


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def lattice_poses(
    positions: NDArray[np.float64],
    position: NDArray[np.int64],
    window: NDArray[np.int64],
    turn: int,
    angle_min: float,
) -> NDArray[np.float64]:
    """Poses (n, 3) of a sensor that sees the window (n,) of `turn` from the position (n,) of (P, 2), m."""
    poses = np.empty((len(position), 3))
    headings = (np.arange(turn) * (2.0 * np.pi / turn) - angle_min + np.pi) % (2.0 * np.pi) - np.pi
    for i in range(len(position)):
        poses[i, 0], poses[i, 1] = positions[position[i], 0], positions[position[i], 1]
        poses[i, 2] = headings[window[i]]
    return poses
