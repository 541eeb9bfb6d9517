"""Pose covariances (..., 3, 3) in m^2, m rad, rad^2: validity, fusion in information form, moments.

Headings live on the circle: residuals are shortest turns, means are directions.
"""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.tracker.symmetric import (
    apart_each,
    determinant_each,
    fuse_each,
    inverse_each,
    mahalanobis_squared_each,
)
from numpy.typing import NDArray

Array = NDArray[np.float64]


def is_covariance(matrices: Array) -> NDArray[np.bool_]:
    """Whether each of (..., 3, 3) is finite, symmetric and positive definite (by its leading minors)."""
    m = np.where(np.isfinite(matrices), matrices, 0.0)
    finite = np.isfinite(matrices).all(axis=(-2, -1))
    with np.errstate(over="ignore", invalid="ignore"):
        minor = m[..., 0, 0] * m[..., 1, 1] - m[..., 0, 1] ** 2
        symmetric = np.abs(m - np.swapaxes(m, -1, -2)).max(axis=(-2, -1)) <= 1e-9 * np.abs(m).max(
            axis=(-2, -1)
        )
        positive = (m[..., 0, 0] > 0) & (minor > 0) & (determinant(m) > 0)
        result: NDArray[np.bool_] = finite & symmetric & positive
    return result


def determinant(m: Array) -> Array:
    """Determinant of symmetric (..., 3, 3)."""
    result: Array = determinant_each(m)
    return result


def log_volume(C: Array) -> Array:
    """Logarithm of the integral of exp(-d^2/2), d the Mahalanobis distance under covariances (..., 3, 3)."""
    result: Array = 1.5 * np.log(2.0 * np.pi) + 0.5 * np.log(determinant(C))
    return result


def invert(m: Array) -> Array:
    """Inverse of symmetric (..., 3, 3)."""
    result: Array = inverse_each(m)
    return result


def residual(y: Array, x: Array) -> Array:
    """Pose `y` minus pose `x`, (..., 3), the heading by the shortest turn."""
    result: Array = apart_each(y, x)
    return result


def mahalanobis_squared(delta: Array, covariance: Array) -> Array:
    """Squared Mahalanobis length of (..., 3) under (..., 3, 3)."""
    result: Array = mahalanobis_squared_each(delta, covariance)
    return result


def log_density(delta: Array, covariance: Array) -> Array:
    """Logarithm of the Gaussian density of (..., 3) under (..., 3, 3)."""
    return -0.5 * mahalanobis_squared(delta, covariance) - log_volume(covariance)


def fuse(x: Array, C: Array, y: Array, R: Array) -> tuple[Array, Array]:
    """Predicted poses X*, C* with observed Y, C in information form (paper, section 7).

    C^ = (C*^-1 + C^-1)^-1 and X^ = C^ (C*^-1 X* + C^-1 Y), written as X* + C^ C^-1 (Y - X*) so that the
    weighted mean is right on the circle. Shapes (..., 3) and (..., 3, 3).
    """
    pose, covariance = fuse_each(x, C, y, R)
    return pose, covariance


def moments(x: Array, C: Array, weight: Array) -> tuple[Array, Array]:
    """Mean (3,) and covariance (3, 3) of a mixture of Gaussians (n, 3), (n, 3, 3) around its heaviest."""
    share = weight / weight.sum()
    centre = x[np.argmax(share)]
    delta = residual(x, centre)
    shift = share @ delta
    spread = delta - shift
    covariance = np.einsum("n,nij->ij", share, C) + np.einsum("n,ni,nj->ij", share, spread, spread)
    mean = centre + shift
    mean[2] = wrap(mean[2])
    return mean, (covariance + covariance.T) / 2
