"""Principal components of all windows of a set of panoramas (paper, section 2).

Every heading of every position is in the set. So the mean scan is one constant, and the covariance of
two beams depends only on their distance: it is the Toeplitz matrix of the panoramas' mean circular
autocorrelation, which takes one FFT a panorama instead of N outer products.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from eigenscan.eigenspace.symmetric_toeplitz import eigenpairs
from numpy.typing import ArrayLike, NDArray
from scipy import fft
from threadpoolctl import threadpool_limits

_BLOCK = 1024
"""Panoramas transformed at once, which bounds the memory."""
_CACHED = 32
"""Panoramas whose coefficients stay in the cache until they are put in place."""


@dataclass(frozen=True)
class Eigenspace:
    """Mean constant, unit eigenvectors (M, B) by decreasing eigenvalue (M,), and the covariance's trace.

    Units follow the values that were analysed: m and m^2 for plain ranges.
    """

    mean: float
    vectors: NDArray[np.float32]
    eigenvalues: NDArray[np.float32]
    total_variance: float

    @property
    def beams(self) -> int:
        """B of a scan."""
        return int(self.vectors.shape[1])

    @property
    def explained(self) -> float:
        """Share of the variance that the kept components hold."""
        return float(self.eigenvalues.sum(dtype=np.float64)) / max(self.total_variance, 1e-300)

    def project(self, scans: ArrayLike) -> NDArray[np.float32]:
        """Coefficients (..., M) of scans (..., B): the inner products with S - mean (paper, eq. 2)."""
        offset: NDArray[np.float32] = np.asarray(scans, dtype=np.float32) - np.float32(self.mean)
        coefficients: NDArray[np.float32] = np.matmul(offset, self.vectors.T)
        return coefficients

    def reconstruct(self, coefficients: ArrayLike) -> NDArray[np.float32]:
        """Scans (..., B) that coefficients (..., M) stand for (paper, eq. 3)."""
        scans: NDArray[np.float32] = np.asarray(coefficients, dtype=np.float32) @ self.vectors + np.float32(
            self.mean
        )
        return scans

    def error(self, scans: ArrayLike) -> NDArray[np.float32]:
        """Error vectors E = S - S^ (..., B) of scans (..., B) (paper, eq. 4)."""
        error: NDArray[np.float32] = np.asarray(scans, dtype=np.float32) - self.reconstruct(
            self.project(scans)
        )
        return error

    def energy(self, scans: ArrayLike) -> NDArray[np.float32]:
        """Norms ||E|| (...,) of the error vectors of scans (..., B)."""
        norms: NDArray[np.float32] = np.linalg.norm(self.error(scans), axis=-1)
        return norms


def autocovariance(values: NDArray[np.float32], workers: int = 1) -> tuple[float, NDArray[np.float64]]:
    """Mean of panoramas (P, N), and their mean circular autocovariance (N,) about it."""
    mean = float(values.mean(dtype=np.float64))
    turn = values.shape[1]
    power = np.zeros(turn // 2 + 1)
    for block in _blocks(values):
        spectrum = fft.rfft(block.astype(np.float64) - mean, axis=1, workers=workers)
        power += (spectrum.real**2 + spectrum.imag**2).sum(axis=0)
    return mean, fft.irfft(power, turn) / (turn * len(values))


def analyse(
    values: NDArray[np.float32],
    beams: int,
    count: int | None = None,
    share: float = 0.9,
    workers: int = 1,
) -> Eigenspace:
    """Eigenspace of all N windows of `beams` beams of panoramas (P, N).

    Keeps `count` components, or the fewest that hold `share` of the variance. Raises ValueError for an empty
    set, values that are not finite (see RangeTransform), or a window beyond a turn. Limits the process's
    BLAS to one thread.
    """
    if values.ndim != 2 or not values.size:
        raise ValueError(f"no panoramas to analyse: shape {values.shape}")
    if not 1 <= beams <= values.shape[1]:
        raise ValueError(f"a window of {beams} beams in a panorama of {values.shape[1]}")
    mean, covariance = autocovariance(values, workers)
    if not np.isfinite(covariance).all():
        raise ValueError("panoramas hold values that are not finite: clip them first")
    one_blas_thread()
    total = float(covariance[0]) * beams
    wanted = beams if count is None else min(count, beams)
    eigenvalues, vectors = eigenpairs(covariance[:beams], wanted)
    if count is None:
        # rounding must not ask for components that hold nothing
        held = np.cumsum(eigenvalues)
        wanted = min(int(np.searchsorted(held, share * total * (1 - 1e-12))) + 1, beams)
    kept = np.maximum(eigenvalues[:wanted], 0.0).astype(np.float32)
    return Eigenspace(mean, _upright(vectors[:wanted]), kept, total)


def all_coefficients(values: NDArray[np.float32], space: Eigenspace) -> NDArray[np.float32]:
    """Coefficients (P, N, M) of every window of panoramas (P, N): [p, k] is the window k of panorama p."""
    turn = values.shape[1]
    filters = np.conj(fft.rfft(space.vectors, turn, axis=1))
    out = np.empty((len(values), turn, len(space.vectors)), dtype=np.float32)
    for start in range(0, len(values), _CACHED):
        block = values[start : start + _CACHED] - np.float32(space.mean)
        spectrum = fft.rfft(block, axis=1)
        every = fft.irfft(spectrum[:, None] * filters, turn, axis=-1)
        out[start : start + _CACHED] = every.transpose(0, 2, 1)
    return out


@cache
def one_blas_thread() -> None:
    """From the first analysis on, linear algebra has one thread in this process, and sums have one order.

    Our matrices are small, several are solved at once, and OpenBLAS's threads spin while they wait for
    a busy core: on a loaded robot that made an analysis a hundred times slower.
    """
    threadpool_limits(1, user_api="blas")


def _blocks(values: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    return [values[start : start + _BLOCK] for start in range(0, len(values), _BLOCK)]


def _upright(vectors: NDArray[np.float64]) -> NDArray[np.float32]:
    """Each row with the sign that makes its first large element positive: the same on every machine."""
    large = np.abs(vectors) > 0.5 * np.abs(vectors).max(axis=1, keepdims=True)
    first = np.take_along_axis(vectors, large.argmax(axis=1)[:, None], axis=1)
    upright: NDArray[np.float32] = np.ascontiguousarray(vectors * np.sign(first), dtype=np.float32)
    return upright
