"""Ranks the regions for a scan by some of its beams against every panorama, before tables exist.

An eigenspace cannot do that: similar offices have similar spaces. Their panoramas differ.
"""

from __future__ import annotations

import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN, HEADING_STRIDE
from eigenscan.projector.lattice import Lattice
from numba import njit
from numpy.typing import NDArray

BEAMS = 24
"""Number of the scan's beams, evenly spread."""
CAP, WRONG = 10.0, 1.0
"""m: beyond the first ranges are alike; a beam that is off by more than the second is as wrong as any."""
_TURNED = ANALYSIS_TURN // HEADING_STRIDE


def first_look(lattice: Lattice, coarse: NDArray[np.float32], used: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Least sum of beams' errors (R,), m, in each region, over all its positions at every searched heading.

    `coarse` (J,) is the scan on the analysis grid; only the beams `used` (J,) count.
    """
    among = np.flatnonzero(used)
    beams = among[np.linspace(0, len(among) - 1, min(BEAMS, len(among))).astype(np.int64)]
    scan = np.minimum(coarse[beams], np.float32(CAP))
    cost = np.empty(len(lattice.panoramas), dtype=np.float32)
    _look(lattice.panoramas, scan, beams, cost)
    return np.array([cost[positions].min() for positions in lattice.regions], dtype=np.float64)


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _look(
    panoramas: NDArray[np.float32],
    scan: NDArray[np.float32],
    beams: NDArray[np.int64],
    cost: NDArray[np.float32],
) -> None:
    # headings side by side for the vector units: beam b at heading h is ahead[b % STRIDE, b // STRIDE + h]
    ahead = np.empty((HEADING_STRIDE, 2 * _TURNED), dtype=np.float32)
    total = np.empty(_TURNED, dtype=np.float32)
    for p in range(len(panoramas)):
        for k in range(ANALYSIS_TURN):
            r = min(panoramas[p, k], np.float32(CAP))
            ahead[k % HEADING_STRIDE, k // HEADING_STRIDE] = r
            ahead[k % HEADING_STRIDE, k // HEADING_STRIDE + _TURNED] = r
        for h in range(_TURNED):
            total[h] = 0.0
        for j in range(len(beams)):
            row, first, z = ahead[beams[j] % HEADING_STRIDE], beams[j] // HEADING_STRIDE, scan[j]
            for h in range(_TURNED):
                total[h] += min(abs(row[first + h] - z), np.float32(WRONG))
        least = total[0]
        for h in range(1, _TURNED):
            least = min(least, total[h])
        cost[p] = least
