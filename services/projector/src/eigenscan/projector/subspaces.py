"""One scan in the eigenspaces of all regions (paper, eq. 2 and 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.eigenspace.components import Eigenspace
from numba import njit
from numpy.typing import NDArray


@dataclass(frozen=True)
class SeenPart:
    """||S - V a||^2 of a scan S in each of R spaces V, m^2, over the beams seen, for any coefficients a.

    It is energy - 2 a'target + a'gram a: `energy` (R,), `target` (R, M), `gram` (R, M, M).
    """

    energy: NDArray[np.float64]
    target: NDArray[np.float64]
    gram: NDArray[np.float64]


@dataclass(frozen=True)
class Subspaces:
    """The eigenspaces of R regions: mean (R, F), vectors (R, M, F, J), prior (R, M) = noise / eigenvalue."""

    mean: NDArray[np.float32]
    vectors: NDArray[np.float32]
    prior: NDArray[np.float64]

    @classmethod
    def of(cls, spaces: list[Eigenspace]) -> Subspaces:
        """Stack of spaces of the same sensor."""
        components, channels, beams = spaces[0].vectors.shape
        made = cls.reserved(len(spaces), components, channels, beams)
        for r, space in enumerate(spaces):
            made.put(r, space)
        return made

    @classmethod
    def reserved(cls, regions: int, components: int, channels: int, beams: int) -> Subspaces:
        """Room for the spaces of `regions`, each to be put in before it is projected into."""
        return cls(
            np.empty((regions, channels), dtype=np.float32),
            np.empty((regions, components, channels, beams), dtype=np.float32),
            np.empty((regions, components)),
        )

    def put(self, r: int, space: Eigenspace) -> None:
        """Takes the space of region r."""
        self.mean[r], self.vectors[r] = space.mean, space.vectors
        self.prior[r] = space.noise / np.maximum(space.eigenvalues, 1e-12)

    def project(
        self,
        channels: NDArray[np.float32],
        seen: NDArray[np.bool_],
        among: NDArray[np.bool_] | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], SeenPart]:
        """Coefficients (R, M) of a scan (F, J), its error's mean square (R,) over the beams `seen` (J,).

        Then what the error is for other coefficients.

        Beams that are not seen take no part: least squares on the others, held by the coefficients' own
        variances where these do not fix them. A region that is not `among` (R,) gets 0 and +inf.
        """
        regions, components = self.prior.shape
        alpha, square = np.zeros(self.prior.shape), np.full(regions, np.inf)
        which = np.arange(regions) if among is None else np.flatnonzero(among)
        part = SeenPart(
            np.zeros(regions), np.zeros(self.prior.shape), np.zeros((regions, components, components))
        )
        _project(
            which, self.mean, self.vectors, self.prior, channels, seen, alpha, square,
            part.energy, part.target, part.gram,
        )  # fmt: skip
        return alpha, square, part


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
    energies: NDArray[np.float64],
    targets: NDArray[np.float64],
    grams: NDArray[np.float64],
) -> None:
    _, components, many, beams = vectors.shape
    lacking = np.flatnonzero(~seen)
    scan = np.empty(many * beams, dtype=np.float32)
    hidden = np.empty((components, many * len(lacking)), dtype=np.float32)
    normal = np.empty((components, components))
    for r in which:
        gram, target = grams[r], targets[r]
        for f in range(many):
            for j in range(beams):
                scan[f * beams + j] = (channels[f, j] - mean[r, f]) if seen[j] else np.float32(0.0)
        energies[r] = energy = _dot(scan, scan)
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
