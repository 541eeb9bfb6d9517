"""What a scan led to: its place in each eigenspace, and the poses that this stands for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Projected:
    """A scan in each region's space: coefficients (R, M) and its error, root mean square (R,), m.

    `searched` (R,): the region's space explains the scan well enough.
    """

    coefficients: Array
    error_energy: Array
    searched: NDArray[np.bool_]


@dataclass(frozen=True)
class Candidates:
    """n poses of the sensor, most likely first. `region` (n,) proposed each.

    `ordinary` is the support of a place that merely looks similar.
    """

    poses: Array
    covariances: Array
    supports: Array
    log_likelihoods: Array
    explained: Array
    region: Index
    projected: Projected
    unlisted_log_likelihood: float
    ordinary: float
