"""Places of poses in the eigenspaces of their regions, interpolated from the model's positions."""

from __future__ import annotations

import numpy as np
from eigenscan.projector.lattice import Lattice
from eigenscan.projector.observation import windows_at
from eigenscan.projector.site import SensorView
from numba import njit
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
    position = lattice.nearest(poses[:, :2])
    ranges = np.empty((len(poses), view.spaces.vectors.shape[-1]), dtype=np.float32)
    _look_up(lattice.panoramas, position, windows_at(poses[:, 2], angle_min), ranges)
    found = np.empty((len(poses), view.spaces.vectors.shape[1]), dtype=np.float32)
    _project(view.embedding(ranges), view.spaces.mean, view.spaces.vectors, region, found)
    return found


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _project(
    channels: NDArray[np.float32],
    mean: NDArray[np.float32],
    vectors: NDArray[np.float32],
    region: NDArray[np.int64],
    out: NDArray[np.float32],
) -> None:
    """Inner products of channels (F, n, J) with the vectors (M, F, J) of their regions (n,)."""
    many, count, beams = channels.shape
    for i in range(count):
        r = region[i]
        for m in range(out.shape[1]):
            total = np.float32(0.0)
            for f in range(many):
                for j in range(beams):
                    total += (channels[f, i, j] - mean[r, f]) * vectors[r, m, f, j]
            out[i, m] = total


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _look_up(
    panoramas: NDArray[np.float32],
    position: NDArray[np.int64],
    window: NDArray[np.int64],
    out: NDArray[np.float32],
) -> None:
    """Ranges (n, J) from `window` (n,) on of the panoramas (P, N) of positions (n,)."""
    turn = panoramas.shape[1]
    for i in range(len(position)):
        k = window[i]
        for j in range(out.shape[1]):
            out[i, j] = panoramas[position[i], k]
            k = k + 1 if k + 1 < turn else 0
