"""Of each patch of the pose space only the best candidate goes on (paper, section 5.1)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def best_of_neighbourhoods(
    poses: NDArray[np.float64], order: NDArray[np.int64], apart_m: float, apart_rad: float, count: int
) -> NDArray[np.int64]:
    """At most `count` indices of poses (n, 3) out of `order`, best first, none near a better one in both."""
    kept = np.empty(count, dtype=np.int64)
    found = 0
    for i in order:
        free = True
        for k in range(found):
            other = poses[kept[k]]
            dx, dy = poses[i, 0] - other[0], poses[i, 1] - other[1]
            if dx * dx + dy * dy <= apart_m * apart_m:
                turn = abs(poses[i, 2] - other[2]) % (2.0 * np.pi)
                if min(turn, 2.0 * np.pi - turn) <= apart_rad:
                    free = False
                    break
        if free:
            kept[found] = i
            found += 1
            if found == count:
                break
    return kept[:found]


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
    for i in range(len(position)):
        poses[i, 0], poses[i, 1] = positions[position[i], 0], positions[position[i], 1]
        heading = window[i] * (2.0 * np.pi / turn) - angle_min
        poses[i, 2] = (heading + np.pi) % (2.0 * np.pi) - np.pi
    return poses
