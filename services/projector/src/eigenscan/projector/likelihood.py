"""Computes how much likelier a scan is at a pose than at a place outside the map.

A beam that ends on a wall supports a pose; a beam through a wall contradicts it. A beam that ends before its
wall (a person, furniture) does neither. The mean over the beams counts, less the support of places that
merely look similar.
"""

from __future__ import annotations

from math import atan, hypot, sqrt
from typing import NamedTuple

import numpy as np
from eigenscan.geometry.surfaces import POINT_SIGMA
from eigenscan.projector.observation import by_reach
from eigenscan.projector.wall_field import REACH, unpack
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

WALL_SCALE = 0.15
"""m from an exact map's wall at which an end point counts half: noise, cells, rest of the pose's error."""
THROUGH_WEIGHT = 0.8
"""Weight of a beam through a wall against a pose, in beams on a wall."""
ORDINARY_RANK = 10
"""Rank, after the best, of the place whose support counts as that of a similar place."""
NATS, STRANGE, SIMILAR = 33.0, 0.08, 0.54
"""ln odds per support; and the support that counts as zero: STRANGE, and SIMILAR times an ordinary place's.

Less than the maximum likelihood of single scans (docs/reports.md), because the errors of consecutive scans
are correlated.
"""
FULL_BEAMS = 45
"""Beams, 2 degrees apart, that came back: a scan of fewer counts in proportion.

What a depth camera sees of a wall fits many places that its list leaves out: benchmarks/narrow_scans.py.
"""


class Exactness(NamedTuple):
    """What follows from how far a map's surfaces are off: for compiled code, too.

    `scale`, m from a wall, at which an end point counts half. `sure`: how surely a wall is there, 0 to 1.
    `gain`: how much more counts what support lacks, for a wide scale makes it alike everywhere.
    """

    scale: float
    sure: float
    gain: float

    @classmethod
    def of(cls, inexactness: float) -> Exactness:
        """For surfaces that are off by `inexactness`, m, standard deviation: anywhere in walls.

        An end point half of the walls' thickness away counts about half. An inexact map draws walls that
        are not there, and beams from the right pose go through them: what is left is the share of a scan's
        information that such walls leave. The gain is such that an end point anywhere within REACH of a wall
        lacks as much as in an exact map (benchmarks/maps.py --way smeared --way fatter --way "thick, coarse,
        warped").
        """
        scale = hypot(WALL_SCALE, sqrt(3.0) * inexactness)
        sure = POINT_SIGMA**2 / (POINT_SIGMA**2 + inexactness**2)
        return cls(scale, sure, (1.0 - _by_chance(WALL_SCALE)) / (1.0 - _by_chance(scale)))

    def as_drawn(self) -> Exactness:
        """For walls that are as thick as the same map draws them: exact, and no surer to be there."""
        return EXACT._replace(sure=self.sure)


def _by_chance(scale: float) -> float:
    """Mean of what end points count whose distances from a wall, up to REACH, are equally likely."""
    return scale / REACH * atan(REACH / scale)


EXACT = Exactness.of(0.0)


def share_of(seen: NDArray[np.float32]) -> Array:
    """What each of the beams (B,) counts `by_reach` of all."""
    return by_reach(seen) / max(len(seen), 1)


@njit(inline="always")  # pragma: no cover - compiled
def sure_beyond(clear: np.float32, scale: float) -> np.float32:
    """How surely a beam went through a wall, 0 to 1, that got so far, m, away from every wall behind it.

    What an end point as far from a wall lacks of counting whole.
    """
    square = clear * clear
    return np.float32(square / (square + np.float32(scale**2)))


def ordinary_support(supports: Array, parts: int = 1) -> float:
    """Support of an ordinary place, from the supports (n,) of places, best first.

    If a site is searched in `parts`, each has its share of the similar places, so the results of all parts
    are comparable.
    """
    if not len(supports):
        return 0.0
    # where all places are spoken against, that one is less so is no evidence
    return max(float(supports[min(max(round(ORDINARY_RANK / parts), 1), len(supports) - 1)]), 0.0)


def log_likelihood(supports: Array, ordinary: float, beams: int) -> Array:
    """Values (n,) of ln p(scan | pose) / p(scan | unknown place) for supports (n,) of places, best first.

    A plain scan (a wall, a corner) has support in many places, even of another building, so the support of an
    ordinary place is no evidence; nor are the few `beams` of a narrow scan worth as much as a whole one's.
    """
    odds: Array = NATS * min(1.0, beams / FULL_BEAMS) * (supports - STRANGE - SIMILAR * ordinary)
    return odds


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def find_support(
    cells: NDArray[np.uint32],
    cell: float,
    poses: Array,
    bearings: Array,
    seen: NDArray[np.float32],
    share: Array,
    through: NDArray[np.float32],
    scale: float,
    out: Array,
) -> None:
    """Mean support of a scan for sensor `poses` (n, 3) in cells, at most 1, and the share of explained beams.

    `out` (2, n). `seen` (B,) are finite ranges along `bearings` (B,), of which each counts its `share` (B,);
    `through` (n, B), 0 to 1, shows how surely beams went through a wall. `scale` as of `Exactness`. A beam is
    explained that ends at a wall, and more likely than not at the first one.
    """
    # single precision and no branches, so that it fits vector units
    one, half, zero, unit = np.float32(1.0), np.float32(0.5), np.float32(0.0), np.float32(cell)
    flat, columns = cells.reshape(-1), np.int32(cells.shape[1])
    right, top = np.float32(cells.shape[1]) - half, np.float32(cells.shape[0]) - half
    s2, against = np.float32(scale**2), np.float32(THROUGH_WEIGHT)
    px, py = (seen * np.cos(bearings) / cell).astype(np.float32), np.empty(len(seen), dtype=np.float32)
    py[:] = seen * np.sin(bearings) / cell
    weight = share.astype(np.float32)
    at, words = np.empty(len(seen), dtype=np.uint32), np.empty(len(seen), dtype=np.uint32)
    column_of, row_of = np.empty(len(seen), dtype=np.float32), np.empty(len(seen), dtype=np.float32)
    for i in range(len(poses)):
        cos, sin = np.float32(np.cos(poses[i, 2])), np.float32(np.sin(poses[i, 2]))
        x, y = np.float32(poses[i, 0]), np.float32(poses[i, 1])
        behind, total, explained = through[i], zero, zero
        # the words in a loop of their own: not every processor's vector units look up
        for j in range(len(px)):
            u = min(max(x + cos * px[j] - sin * py[j], zero), right)
            v = min(max(y + sin * px[j] + cos * py[j], zero), top)
            column_of[j], row_of[j] = u, v
            at[j] = np.uint32(np.int32(np.int32(v) * columns) + np.int32(u))
        for j in range(len(px)):
            words[j] = flat[np.uint64(at[j])]
        for j in range(len(px)):
            u, v = column_of[j], row_of[j]
            column, row = np.int32(u), np.int32(v)
            centre, gx, gy = unpack(words[j])
            d = centre + (gx * (u - np.float32(column) - half) + gy * (v - np.float32(row) - half)) * unit
            on_wall = s2 / (s2 + d * d)
            total += weight[j] * (on_wall - against * behind[j])
            explained += one if min(on_wall, one - behind[j]) > half else zero
        out[0, i] = total
        out[1, i] = explained / max(len(px), 1)
