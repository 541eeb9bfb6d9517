"""Principal components of windows of panoramas with several channels a beam.

As in one channel (paper, section 2) every heading of every position is in the set, so the covariance of
channel f at beam j and channel g at beam l depends on j - l only: it is block Toeplitz, and exact by one FFT
a panorama.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.eigenspace.components import one_blas_thread
from numba import njit
from numpy.typing import NDArray
from scipy import fft
from scipy.linalg import eigh

_CACHED = 64


@dataclass(frozen=True)
class ChannelSpace:
    """Mean (F,) of the channels, unit eigenvectors (M, F, J), eigenvalues (M,), trace of the covariance."""

    mean: NDArray[np.float64]
    vectors: NDArray[np.float64]
    eigenvalues: NDArray[np.float64]
    total_variance: float

    @property
    def noise(self) -> float:
        """Mean variance of a channel of a beam that the kept components leave out."""
        left_over = self.total_variance - float(self.eigenvalues.sum())
        return float(max(left_over / self.vectors[0].size, 1e-9 * self.total_variance, 1e-12))


@dataclass(frozen=True)
class ChannelSpaces:
    """The spaces of R regions: mean (R, F), vectors (R, M, F, J), prior (R, M) = noise / eigenvalue."""

    mean: NDArray[np.float32]
    vectors: NDArray[np.float32]
    prior: NDArray[np.float64]

    @classmethod
    def of(cls, spaces: list[ChannelSpace]) -> ChannelSpaces:
        """Stack of spaces of the same sensor."""
        return cls(
            np.stack([space.mean for space in spaces]).astype(np.float32),
            np.stack([space.vectors for space in spaces]).astype(np.float32),
            np.stack([space.noise / np.maximum(space.eigenvalues, 1e-12) for space in spaces]),
        )

    def project(
        self,
        channels: NDArray[np.float32],
        seen: NDArray[np.bool_],
        among: NDArray[np.bool_] | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Coefficients (R, M) of a scan (F, J), and its error's mean square (R,) over the beams `seen` (J,).

        Beams that are not seen take no part: least squares on the others, held by the coefficients' own
        variances where these do not fix them. A region that is not `among` (R,) gets 0 and +inf.
        """
        alpha, square = np.zeros(self.prior.shape), np.full(len(self.prior), np.inf)
        which = np.arange(len(self.prior)) if among is None else np.flatnonzero(among)
        _project(which, self.mean, self.vectors, self.prior, channels, seen, alpha, square)
        return alpha, square


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _project(
    which: NDArray[np.int64],
    mean: NDArray[np.float32],
    vectors: NDArray[np.float32],
    prior: NDArray[np.float64],
    channels: NDArray[np.float32],
    seen: NDArray[np.bool_],
    alpha: NDArray[np.float64],
    square: NDArray[np.float64],
) -> None:
    _, components, many, beams = vectors.shape
    lacking = np.flatnonzero(~seen)
    scan = np.empty(many * beams, dtype=np.float32)
    hidden = np.empty((components, many * len(lacking)), dtype=np.float32)
    gram, normal = np.empty((components, components)), np.empty((components, components))
    target = np.empty(components)
    for r in which:
        for f in range(many):
            for j in range(beams):
                scan[f * beams + j] = (channels[f, j] - mean[r, f]) if seen[j] else np.float32(0.0)
        energy = _dot(scan, scan)
        for m in range(components):
            target[m] = _dot(vectors[r, m].reshape(-1), scan)
            for f in range(many):
                for h in range(len(lacking)):
                    hidden[m, f * len(lacking) + h] = vectors[r, m, f, lacking[h]]
        # the vectors are orthonormal over all beams
        for m in range(components):
            for n in range(m + 1):
                gram[m, n] = gram[n, m] = (1.0 if m == n else 0.0) - _dot(hidden[m], hidden[n])
                normal[m, n] = gram[m, n] + (prior[r, m] if m == n else 0.0)
        _solve(normal, target, alpha[r])
        # ||S - V a||^2 = ||S||^2 - 2 a V'S + a V'V a
        left_over = float(energy)
        for m in range(components):
            left_over -= alpha[r, m] * (2.0 * target[m] - _dot64(gram[m], alpha[r]))
        square[r] = max(left_over, 0.0) / max(many * (beams - len(lacking)), 1)


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _dot(a: NDArray[np.float32], b: NDArray[np.float32]) -> np.float32:
    total = np.float32(0.0)
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _dot64(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _solve(normal: NDArray[np.float64], target: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Solution of normal @ out = target by Cholesky; the lower triangle of `normal` is used up."""
    size = len(target)
    for m in range(size):
        for n in range(m):
            normal[m, n] = (normal[m, n] - _dot64(normal[m, :n], normal[n, :n])) / normal[n, n]
        normal[m, m] = np.sqrt(max(normal[m, m] - _dot64(normal[m, :m], normal[m, :m]), 1e-12))
        out[m] = (target[m] - _dot64(normal[m, :m], out[:m])) / normal[m, m]
    for m in range(size - 1, -1, -1):
        out[m] /= normal[m, m]
        for n in range(m):
            out[n] -= normal[m, n] * out[m]


def analyse_channels(channels: NDArray[np.float32], beams: int, count: int) -> ChannelSpace:
    """Space of all N windows of `beams` beams of panoramas with channels (F, P, N), `count` components.

    Raises ValueError for an empty set or values that are not finite.
    """
    one_blas_thread()
    many, positions, turn = channels.shape
    if not positions or not np.isfinite(channels).all():
        raise ValueError(f"no finite panoramas to analyse: shape {channels.shape}")
    mean = channels.mean(axis=(1, 2), dtype=np.float64)
    power = np.zeros((many, many, turn // 2 + 1), dtype=np.complex128)
    for start in range(0, positions, _CACHED):
        spectrum = fft.rfft(channels[:, start : start + _CACHED] - mean[:, None, None], axis=2)
        power += np.einsum("fpk,gpk->fgk", spectrum, np.conj(spectrum))
    lag = fft.irfft(power, turn, axis=2) / (turn * positions)
    beam = np.arange(beams)
    apart = (beam[:, None] - beam[None, :]) % turn
    covariance = lag[:, :, apart].transpose(0, 2, 1, 3).reshape(many * beams, many * beams)
    size = many * beams
    kept = min(count, size)
    eigenvalues, vectors = eigh(covariance, subset_by_index=(size - kept, size - 1))
    return ChannelSpace(
        mean,
        np.ascontiguousarray(vectors.T[::-1]).reshape(kept, many, beams),
        np.maximum(eigenvalues[::-1], 0.0),
        float(np.trace(covariance)),
    )


def error_squares(
    channels: NDArray[np.float32], space: ChannelSpace, coefficients: NDArray[np.float32], every: int = 1
) -> NDArray[np.float64]:
    """Mean squares (P, N / every) of the error vectors of the windows that have these coefficients."""
    beams = space.vectors.shape[2]
    squares = ((channels - space.mean[:, None, None]) ** 2).sum(axis=0)
    running = np.cumsum(np.concatenate([squares, squares[:, :beams]], axis=1), axis=1)
    norms = running[:, beams - 1 : -1] - running[:, :-beams] + squares
    held = (coefficients.astype(np.float64) ** 2).sum(axis=2)
    square: NDArray[np.float64] = np.maximum(norms[:, ::every] - held, 0.0) / space.vectors[0].size
    return square


def coefficients(channels: NDArray[np.float32], space: ChannelSpace, every: int = 1) -> NDArray[np.float32]:
    """Coefficients (P, N / every, M) of every `every`-th window of panoramas with channels (F, P, N)."""
    turn = channels.shape[2]
    filters = np.conj(fft.rfft(space.vectors, turn, axis=2))
    out = np.empty((channels.shape[1], -(-turn // every), len(space.vectors)), dtype=np.float32)
    for start in range(0, channels.shape[1], _CACHED):
        block = channels[:, start : start + _CACHED] - space.mean[:, None, None]
        spectrum = np.einsum("fpk,mfk->pmk", fft.rfft(block, axis=2), filters)
        out[start : start + _CACHED] = fft.irfft(spectrum, turn, axis=2)[:, :, ::every].transpose(0, 2, 1)
    return out
