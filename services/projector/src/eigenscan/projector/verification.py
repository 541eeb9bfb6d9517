"""How well predicted scans explain a scan: truncated L1 over windows of the panoramas."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

TRUNCATION = 1.0
"""m: a beam that is off by more says no more."""


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def truncated_l1(
    panoramas: NDArray[np.float32],
    index: NDArray[np.int64],
    scan: NDArray[np.float32],
    weight: NDArray[np.float32],
    truncation: np.float32,
) -> NDArray[np.float32]:
    """Mean cost (n,) of poses `index` (n,), over the beams that have weight.

    `panoramas` (P, 2 N) twice around, `scan` (J,) finite, `weight` (J,) 0 where missing.
    """
    turn = panoramas.shape[1] // 2
    total = max(weight.sum(), np.float32(1e-9))
    out = np.empty(len(index), dtype=np.float32)
    for i in range(len(index)):
        position, heading = index[i] // turn, index[i] % turn
        window = panoramas[position, heading : heading + len(scan)]
        cost = np.float32(0.0)
        for j in range(len(scan)):
            cost += weight[j] * min(abs(window[j] - scan[j]), truncation)
        out[i] = cost / total
    return out
