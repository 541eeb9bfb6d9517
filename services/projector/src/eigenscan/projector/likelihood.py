"""How much likelier a scan is at a pose than at a place that the map does not show.

A beam speaks for a pose where it ends on a wall, and against it where it went through one. A beam that ends
before its wall (a person, furniture) does neither. What the beams say is averaged, less what they say of
places that merely look similar.
"""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.pose import compose, inverse
from eigenscan.projector.observation import by_reach
from eigenscan.projector.wall_field import WallField, unpack
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

WALL_SCALE = 0.15
"""m from a wall at which an end point counts half: noise, the map's resolution, rest of the pose's error."""
THROUGH_MARGIN = 0.3
"""m behind the predicted wall before a beam counts as having gone through it."""
THROUGH_WEIGHT = 0.8
"""What a beam through a wall says against a pose, in beams on a wall."""
ORDINARY_RANK = 3
"""The support of so manieth place after the best tells what a place gets that merely looks similar."""
NATS, STRANGE, SIMILAR = 41.9, -0.06, 0.74
"""ln odds per support; the support that counts for nothing: STRANGE, and SIMILAR times an ordinary place's.

By maximum likelihood of what is right, on scans of two buildings in their own maps and in foreign ones; held
against the others (benchmarks/likelihood.py).
"""


def support(
    field: WallField,
    poses: Array,
    bearings: Array,
    seen: NDArray[np.float32],
    predicted: NDArray[np.float32],
    margin: float = THROUGH_MARGIN,
) -> tuple[Array, Array]:
    """Mean support (n,) of a scan for sensor poses (n, 3), at most 1, and the share (n,) of explained beams.

    `seen` (B,) are finite ranges along `bearings` (B,), `predicted` (n, B) the map's, +inf where no wall is
    in sight. A beam is explained that ends within `margin`, m, of the predicted wall. Beams count `by_reach`.
    """
    local = np.ascontiguousarray(compose(inverse(field.origin), poses))
    out = np.empty((2, len(local)))
    share = by_reach(seen) / max(len(seen), 1)
    _support(field.cells, field.cell, local, bearings, seen, share, predicted, margin, out)
    return out[0], out[1]


def ordinary_support(supports: Array, parts: int = 1) -> float:
    """What an ordinary place gets, by the supports (n,) of places, best first.

    Of a site that is searched in `parts`, each holds its share of the places that look similar, so that what
    all parts say compares.
    """
    if not len(supports):
        return 0.0
    # where all places are spoken against, that one is less so is no evidence
    return max(float(supports[min(max(round(ORDINARY_RANK / parts), 1), len(supports) - 1)]), 0.0)


def log_likelihood(supports: Array, ordinary: float) -> Array:
    """Values (n,) of ln p(scan | pose) / p(scan | unknown place) for supports (n,) of places, best first.

    A plain scan (a wall, a corner) finds support in many places, also of a foreign building: what an ordinary
    place gets is no evidence.
    """
    odds: Array = NATS * (supports - STRANGE - SIMILAR * ordinary)
    return odds


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _support(
    cells: NDArray[np.uint32],
    cell: float,
    poses: Array,
    bearings: Array,
    seen: NDArray[np.float32],
    share: Array,
    predicted: NDArray[np.float32],
    margin: float,
    out: Array,
) -> None:
    height, width = cells.shape[:2]
    beams = len(seen)
    px, py = seen * np.cos(bearings), seen * np.sin(bearings)
    for i in range(len(poses)):
        cos, sin = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        total, explained = 0.0, 0
        for j in range(beams):
            u = (poses[i, 0] + cos * px[j] - sin * py[j]) / cell + 1.0
            v = (poses[i, 1] + sin * px[j] + cos * py[j]) / cell + 1.0
            u, v = min(max(u, 0.0), width - 0.5), min(max(v, 0.0), height - 0.5)
            column, row = int(u), int(v)
            centre, gx, gy = unpack(cells[row, column])
            d = centre + (gx * (u - column - 0.5) + gy * (v - row - 0.5)) * cell
            for_it = WALL_SCALE**2 / (WALL_SCALE**2 + d * d)
            # +inf minus a range stays out of both comparisons under fast math
            wall = min(predicted[i, j], np.float32(1e9))
            if seen[j] > wall + margin:
                for_it -= THROUGH_WEIGHT
            elif seen[j] > wall - margin:
                explained += 1
            total += share[j] * for_it
        out[0, i] = total
        out[1, i] = explained / max(beams, 1)
