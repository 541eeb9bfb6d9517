"""A region seen by one sensor: its panoramas on the analysis grid, its eigenspace, its tree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.eigenspace.components import Eigenspace, all_coefficients, analyse
from eigenscan.eigenspace.model import RegionModel
from eigenscan.eigenspace.panorama import Sensor, resample
from eigenscan.eigenspace.ranges import RangeTransform
from eigenscan.projector.observation import ANALYSIS_TURN
from numpy.typing import NDArray
from scipy.spatial import cKDTree


@dataclass(frozen=True)
class Subspace:
    """P positions, N headings each; the pose (p, k) has the index p * N + k.

    `panoramas` (P, 2 N) transformed ranges, twice around; `positions` (P, 2) m, map frame; `headings` (N,)
    of the sensor.
    """

    region: str
    sensor: Sensor
    transform: RangeTransform
    positions: NDArray[np.float64]
    headings: NDArray[np.float64]
    panoramas: NDArray[np.float32]
    space: Eigenspace
    tree: cKDTree

    def poses(self, index: NDArray[np.int64]) -> NDArray[np.float64]:
        """Sensor poses (n, 3) in the map frame of pose indices (n,)."""
        position, heading = np.divmod(index, len(self.headings))
        return np.column_stack([self.positions[position], self.headings[heading]])

    def project(self, coarse: NDArray[np.float32]) -> tuple[NDArray[np.float64], float]:
        """Coefficients (M,) of a scan (J,), and the root mean square of its error vector, m.

        Missing beams take no part: least squares on the others, held by the coefficients' own variances
        where these do not fix them.
        """
        seen = ~np.isnan(coarse)
        basis = self.space.vectors[:, seen].astype(np.float64)
        scan = self.transform(coarse[seen]).astype(np.float64) - self.space.mean
        left_over = max(self.space.total_variance - float(self.space.eigenvalues.sum()), 1e-12)
        noise = left_over / self.space.beams
        normal = basis @ basis.T + np.diag(noise / np.maximum(self.space.eigenvalues, 1e-12))
        alpha: NDArray[np.float64] = np.linalg.solve(normal, basis @ scan)
        error = scan - alpha @ basis
        return alpha, float(np.sqrt(np.mean(error**2)))


def make_subspace(model: RegionModel, sensor: Sensor, transform: RangeTransform, components: int) -> Subspace:
    """Subspace of `model` for a sensor on the analysis grid."""
    panoramas = transform(resample(model.panoramas, ANALYSIS_TURN))
    space = analyse(panoramas, sensor.beams, count=components)
    table = all_coefficients(panoramas, space).reshape(-1, len(space.vectors))
    return Subspace(
        model.region,
        sensor,
        transform,
        model.positions,
        sensor.headings(ANALYSIS_TURN),
        np.ascontiguousarray(np.concatenate([panoramas, panoramas], axis=1)),
        space,
        cKDTree(table, leafsize=32, balanced_tree=False, compact_nodes=False),
    )
