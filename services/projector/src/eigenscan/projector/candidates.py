"""Result of a search: the scan's place in each eigenspace, and the poses found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.projector.subspaces import SeenPart
from eigenscan.schemas.hypotheses_pb2 import SURFACES_UNSPECIFIED, Surfaces
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Projected:
    """A scan in each region's space: coefficients (R, M) and its error, root mean square (R,), m.

    `explained` (R,): the region's space can explain the scan; `searched` (R,): and the region is ready.
    """

    coefficients: Array
    error_energy: Array
    explained: NDArray[np.bool_]
    searched: NDArray[np.bool_]
    part: SeenPart
    """Of the scan, what its beams show, `lacking` the share of those that show nothing."""
    lacking: float


@dataclass(frozen=True)
class Fitted:
    """One pose (3,) of the sensor, map frame, that a scan was fitted to; `explained`: share of its beams."""

    pose: Array
    covariance: Array
    log_likelihood: float
    explained: float


@dataclass(frozen=True)
class Candidates:
    """n poses of the sensor, most likely first. `region` (n,): the region that proposed each.

    `ordinary`: support of a place that merely looks similar. `waiting` (R,): regions left to later scans, if
    there are any. `surfaces`: of thick walls, those that the poses fit. `cut`: as many as are published at
    most: others as likely may be missing.
    """

    poses: Array
    covariances: Array
    log_likelihoods: Array
    explained: Array
    region: Index
    projected: Projected
    unlisted_log_likelihood: float
    ordinary: float
    waiting: NDArray[np.bool_] | None = None
    surfaces: Surfaces = SURFACES_UNSPECIFIED
    cut: bool = False
