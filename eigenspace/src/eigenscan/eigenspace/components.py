"""Principal components of all windows of a set of panoramas (paper, section 2), with F channels a beam.

The set has every heading of every position. So the mean of a channel is one constant, and the covariance of
channel f at beam j and channel g at beam l depends on j - l only: it is block Toeplitz, and exact by one FFT
a panorama instead of N outer products. With one channel it is the Toeplitz matrix of plain ranges.
The result is rounded to single precision, as on the wire, so an analysis of the same panoramas gives the same
bits as a received one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.linalg import eigh
from threadpoolctl import threadpool_limits

Channels = NDArray[np.float32]

_CACHED = 64
"""Panoramas whose spectra stay in the cache."""


@dataclass(frozen=True)
class Eigenspace:
    """Mean (F,) of the channels, unit eigenvectors (M, F, J), their eigenvalues (M,), decreasing.

    `total_variance` is the covariance's trace. Units follow the channels: m and m^2 for both embeddings.
    """

    mean: NDArray[np.float32]
    vectors: NDArray[np.float32]
    eigenvalues: NDArray[np.float32]
    total_variance: float

    @property
    def beams(self) -> int:
        """J of a scan."""
        return int(self.vectors.shape[2])

    @property
    def explained(self) -> float:
        """Share of the variance that the kept components hold."""
        return float(self.eigenvalues.sum(dtype=np.float64)) / max(self.total_variance, 1e-300)

    @property
    def noise(self) -> float:
        """Mean variance of a channel of a beam that the kept components leave out."""
        left_over = self.total_variance - float(self.eigenvalues.sum(dtype=np.float64))
        return float(max(left_over / self.vectors[0].size, 1e-9 * self.total_variance, 1e-12))

    def reconstruct(self, coefficients: NDArray[np.float32]) -> Channels:
        """Channels (F, J) that coefficients (M,) stand for (paper, eq. 3)."""
        whole: Channels = np.tensordot(coefficients, self.vectors, 1) + self.mean[:, None]
        return whole


def analyse(channels: Channels, beams: int, count: int) -> Eigenspace:
    """Space of all N windows of `beams` beams of panoramas with channels (F, P, N), `count` components.

    Fewer where F * J are fewer. Raises ValueError for an empty set, values that are not finite, or a window
    beyond a turn. Limits the process's BLAS to one thread.
    """
    one_blas_thread()
    many, positions, turn = channels.shape
    if not positions or not np.isfinite(channels).all():
        raise ValueError(f"no finite panoramas to analyse: shape {channels.shape}")
    if not 1 <= beams <= turn:
        raise ValueError(f"a window of {beams} beams in a panorama of {turn}")
    mean = channels.mean(axis=(1, 2), dtype=np.float64)
    covariance = _block_toeplitz(_autocovariance(channels, mean), beams)
    size = many * beams
    kept = min(count, size)
    eigenvalues, vectors = eigh(covariance, subset_by_index=(size - kept, size - 1), check_finite=False)
    return Eigenspace(
        mean.astype(np.float32),
        _upright(vectors.T[::-1]).reshape(kept, many, beams),
        np.maximum(eigenvalues[::-1], 0.0).astype(np.float32),
        float(np.float32(np.trace(covariance))),
    )


def coefficients(channels: Channels, space: Eigenspace, every: int = 1) -> NDArray[np.float32]:
    """Coefficients (P, N / every, M) of every `every`-th window of panoramas with channels (F, P, N).

    They are the inner products with S - mean (paper, eq. 2), by one FFT a panorama.
    """
    turn = channels.shape[2]
    filters = np.conj(fft.rfft(space.vectors, turn, axis=2))
    out = np.empty((channels.shape[1], -(-turn // every), len(space.vectors)), dtype=np.float32)
    for start in range(0, channels.shape[1], _CACHED):
        block = channels[:, start : start + _CACHED] - space.mean[:, None, None]
        spectrum = np.einsum("fpk,mfk->pmk", fft.rfft(block, axis=2), filters)
        out[start : start + _CACHED] = fft.irfft(spectrum, turn, axis=2)[:, :, ::every].transpose(0, 2, 1)
    return out


def error_squares(
    channels: Channels, space: Eigenspace, held: NDArray[np.float32], every: int = 1
) -> NDArray[np.float64]:
    """Mean squares (P, N / every) of the error vectors of windows with coefficients `held`; paper, eq. 4."""
    beams = space.beams
    squares = ((channels - space.mean[:, None, None].astype(np.float64)) ** 2).sum(axis=0)
    running = np.cumsum(np.concatenate([squares, squares[:, :beams]], axis=1), axis=1)
    norms = running[:, beams - 1 : -1] - running[:, :-beams] + squares
    explained = (held.astype(np.float64) ** 2).sum(axis=2)
    square: NDArray[np.float64] = np.maximum(norms[:, ::every] - explained, 0.0) / space.vectors[0].size
    return square


@cache
def one_blas_thread() -> None:
    """Limits linear algebra in this process to one thread, so that sums have one order.

    Our matrices are small, several are solved at once, and OpenBLAS's threads spin while they wait for a busy
    core: on a loaded robot that made an analysis a hundred times slower.
    """
    threadpool_limits(1, user_api="blas")


def _autocovariance(channels: Channels, mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean circular covariance (F, F, N) of two channels, by the number of beams between them."""
    many, positions, turn = channels.shape
    power = np.zeros((many, many, turn // 2 + 1), dtype=np.complex128)
    for start in range(0, positions, _CACHED):
        spectrum = fft.rfft(channels[:, start : start + _CACHED] - mean[:, None, None], axis=2)
        power += np.einsum("fpk,gpk->fgk", spectrum, np.conj(spectrum))
    lags: NDArray[np.float64] = fft.irfft(power, turn, axis=2) / (turn * positions)
    return lags


def _block_toeplitz(lags: NDArray[np.float64], beams: int) -> NDArray[np.float64]:
    """Covariance (F * J, F * J) of the channels of a window."""
    many, _, turn = lags.shape
    beam = np.arange(beams)
    apart = (beam[:, None] - beam[None, :]) % turn
    blocks: NDArray[np.float64] = lags[:, :, apart].transpose(0, 2, 1, 3)
    return blocks.reshape(many * beams, many * beams)


def _upright(vectors: NDArray[np.float64]) -> NDArray[np.float32]:
    """Each row with the sign that makes its first large element positive: the same on every machine."""
    large = np.abs(vectors) > 0.5 * np.abs(vectors).max(axis=1, keepdims=True)
    first = np.take_along_axis(vectors, large.argmax(axis=1)[:, None], axis=1)
    upright: NDArray[np.float32] = np.ascontiguousarray(vectors * np.sign(first), dtype=np.float32)
    return upright
