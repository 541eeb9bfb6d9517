"""Pose covariances (..., 3, 3) in m^2, m rad, rad^2: validity, volume, distance, density.

Headings live on the circle: residuals are shortest turns.
"""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.symmetric import determinant_each
from eigenscan.tracker.symmetric import apart_each, is_covariance_each, mahalanobis_squared_each
from numpy.typing import NDArray

Array = NDArray[np.float64]


def is_covariance(matrices: Array) -> NDArray[np.bool_]:
    """Whether each of (..., 3, 3) is finite, symmetric and positive definite (by its leading minors)."""
    shape = matrices.shape[:-2]
    result: NDArray[np.bool_] = is_covariance_each(_rows(matrices, shape, 2)).reshape(shape)
    return result


def determinant(m: Array) -> Array:
    """Determinant of symmetric (..., 3, 3)."""
    result: Array = determinant_each(_rows(m, m.shape[:-2], 2)).reshape(m.shape[:-2])
    return result


def log_volume(C: Array) -> Array:
    """Logarithm of the integral of exp(-d^2/2), d the Mahalanobis distance under covariances (..., 3, 3)."""
    result: Array = 1.5 * np.log(2.0 * np.pi) + 0.5 * np.log(determinant(C))
    return result


def residual(y: Array, x: Array) -> Array:
    """Pose `y` minus pose `x`, (..., 3), the heading by the shortest turn."""
    if x.ndim == 1 and y.ndim == 2:
        each: Array = apart_each(y, x[None])
        return each
    shape = np.broadcast_shapes(y.shape, x.shape)
    result: Array = apart_each(_rows(y, shape[:-1], 1), _rows(x, shape[:-1], 1)).reshape(shape)
    return result


def mahalanobis_squared(delta: Array, covariance: Array) -> Array:
    """Squared Mahalanobis length of (..., 3) under (..., 3, 3)."""
    shape = np.broadcast_shapes(delta.shape[:-1], covariance.shape[:-2])
    result: Array = mahalanobis_squared_each(_rows(delta, shape, 1), _rows(covariance, shape, 2)).reshape(
        shape
    )
    return result


def log_density(delta: Array, covariance: Array) -> Array:
    """Logarithm of the Gaussian density of (..., 3) under (..., 3, 3)."""
    return -0.5 * mahalanobis_squared(delta, covariance) - log_volume(covariance)


def _rows(array: Array, shape: tuple[int, ...], inner: int) -> Array:
    """What has `inner` dimensions of its own, once for each of a leading `shape`, one after the other."""
    own = array.shape[array.ndim - inner :]
    if array.shape != shape + own:
        array = np.broadcast_to(array, shape + own)
    return array if len(shape) == 1 else array.reshape(-1, *own)
