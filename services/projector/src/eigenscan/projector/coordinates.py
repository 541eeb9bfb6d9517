"""Where poses lie in the eigenspaces of their regions, as far as the model's own positions tell."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.circle import TURN
from eigenscan.projector.lattice import Lattice
from eigenscan.projector.observation import ANALYSIS_TURN
from eigenscan.projector.site import SensorView
from numpy.typing import NDArray


def coordinates(
    view: SensorView,
    lattice: Lattice,
    poses: NDArray[np.float64],
    region: NDArray[np.int64],
    angle_min: float,
) -> NDArray[np.float32]:
    """Coefficients (n, M) of the model's poses nearest to sensor poses (n, 3), in spaces `region` (n,).

    A panorama that is there costs a fifth of casting the rays of the pose itself.
    """
    position = np.asarray(lattice.tree.query(poses[:, :2])[1])
    window = np.rint((poses[:, 2] + angle_min) * (ANALYSIS_TURN / TURN)).astype(np.int64)
    beams = np.arange(view.spaces.vectors.shape[-1])
    ranges = lattice.panoramas[position[:, None], (window[:, None] + beams) % ANALYSIS_TURN]
    away = view.embedding(ranges) - view.spaces.mean[region].T[..., None]
    found: NDArray[np.float32] = np.einsum(
        "fnj,nmfj->nm", away, view.spaces.vectors[region], optimize=True
    ).astype(np.float32)
    return found
