"""Eigenvectors of a symmetric Toeplitz matrix, at a quarter of the work of a general one.

Such a matrix is the same read backwards. So each eigenvector is even or odd about its middle, and the even
and the odd ones are those of two matrices of half the size (Cantoni and Butler 1976).
"""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.pose import Array
from scipy.linalg import eigh, toeplitz


def eigenpairs(first_row: Array, count: int) -> tuple[Array, Array]:
    """The `count` largest eigenvalues (M,), decreasing, and their unit eigenvectors (M, B) as rows."""
    beams = len(first_row)
    half = beams // 2
    matrix = toeplitz(first_row)
    corner, mirrored = matrix[:half, :half], matrix[:half, beams - half :][:, ::-1]
    even = corner + mirrored
    if beams % 2:
        edge = np.sqrt(2.0) * matrix[:half, half : half + 1]
        even = np.block([[even, edge], [edge.T, matrix[half : half + 1, half : half + 1]]])
    even_values, even_vectors = _largest(even, count)
    odd_values, odd_vectors = _largest(corner - mirrored, count)
    values = np.concatenate([even_values, odd_values])
    order = np.argsort(-values, kind="stable")[:count]
    vectors = np.concatenate([_whole(even_vectors, beams, 1.0), _whole(odd_vectors, beams, -1.0)])
    return values[order], vectors[order]


def _largest(matrix: Array, count: int) -> tuple[Array, Array]:
    """Eigenvalues and rows of eigenvectors, the largest `count` if there are so many."""
    size = len(matrix)
    if not size:
        return np.empty(0), np.empty((0, 0))
    values, vectors = eigh(matrix, subset_by_index=(max(size - count, 0), size - 1), check_finite=False)
    return values, vectors.T


def _whole(halves: Array, beams: int, sign: float) -> Array:
    """Vectors (M, B) from their first halves, and their middle if it is there."""
    half = beams // 2
    vectors = np.zeros((len(halves), beams))
    if len(halves):
        vectors[:, :half] = halves[:, :half] / np.sqrt(2.0)
        vectors[:, beams - half :] = sign * vectors[:, :half][:, ::-1]
        if halves.shape[1] > half:
            vectors[:, half] = halves[:, half]
    return vectors
