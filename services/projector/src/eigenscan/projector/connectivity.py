"""Of each patch of the pose space only the best candidate goes on (paper, section 5.1)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def best_of_neighbourhoods(
    poses: NDArray[np.float64], apart_m: float, apart_rad: float, count: int
) -> NDArray[np.int64]:
    """Indices of at most `count` poses (n, 3), given best first, none within both distances of a better one."""
    kept = np.empty(count, dtype=np.int64)
    found = 0
    for i in range(len(poses)):
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
