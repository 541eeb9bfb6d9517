"""Poses and their covariances in bulk, compiled, on `eigenscan.geometry.symmetric`.

What ends in `_each` takes n rows or matrices, and is compiled when it is imported.
"""

from __future__ import annotations

from math import pi

import numpy as np
from eigenscan.geometry.inner import inner
from eigenscan.geometry.symmetric import (
    MATRICES,
    NUMBERS,
    Column,
    Triangle,
    determinant,
    inverse,
    plus,
    put,
    square,
    times,
    triangle,
)
from numba import njit, types
from numpy.typing import NDArray

Array = NDArray[np.float64]
ROWS = types.Array(types.float64, 2, "A", readonly=True)
WEIGHTS = types.Array(types.float64, 1, "A", readonly=True)


@inner()  # pragma: no cover - compiled
def turned(m: Triangle, cos: float, sin: float) -> Triangle:
    """Covariance of x, y, theta in a frame that is turned back by an angle."""
    a, b, c, d, e, f = m
    return (
        cos * cos * a - 2.0 * cos * sin * b + sin * sin * d,
        cos * sin * (a - d) + (cos * cos - sin * sin) * b,
        cos * c - sin * e,
        sin * sin * a + 2.0 * cos * sin * b + cos * cos * d,
        sin * c + cos * e,
        f,
    )


@inner()  # pragma: no cover - compiled
def widest(C: Array) -> float:
    """Variance of (3, 3) along the position's long axis."""
    half = (C[0, 0] + C[1, 1]) / 2
    return float(half + np.hypot((C[0, 0] - C[1, 1]) / 2, C[0, 1]))


@inner()  # pragma: no cover - compiled
def wrapped(angle: float) -> float:
    """Same direction in [-pi, pi)."""
    turn = (angle + pi) % (2.0 * pi) - pi
    # the remainder of a tiny negative number rounds to a full turn
    return turn if turn < pi else -pi


@inner()  # pragma: no cover - compiled
def apart(y: Array, x: Array) -> Column:
    """Pose `y` (3,) minus pose `x` (3,), the heading by the shortest turn."""
    return y[0] - x[0], y[1] - x[1], wrapped(y[2] - x[2])


@njit(types.float64[:, ::1](ROWS, ROWS), cache=True)  # pragma: no cover - compiled
def apart_each(y: Array, x: Array) -> Array:
    """Poses (n, 3) minus poses (n, 3), or minus one (1, 3)."""
    out = np.empty((len(y), 3))
    for i in range(len(y)):
        out[i, 0], out[i, 1], out[i, 2] = apart(y[i], x[min(i, len(x) - 1)])
    return out


@njit(NUMBERS(ROWS, MATRICES), cache=True)  # pragma: no cover - compiled
def mahalanobis_squared_each(delta: Array, covariance: Array) -> Array:
    """Squared Mahalanobis lengths of (n, 3) under (n, 3, 3)."""
    out = np.empty(len(delta))
    for i in range(len(delta)):
        out[i] = square(inverse(triangle(covariance[i])), (delta[i, 0], delta[i, 1], delta[i, 2]))
    return out


@njit(  # pragma: no cover - compiled
    types.Tuple((types.float64[:, ::1], types.float64[:, :, ::1]))(ROWS, MATRICES, ROWS, MATRICES),
    cache=True,
)
def fuse_each(x: Array, C: Array, y: Array, R: Array) -> tuple[Array, Array]:
    """Predicted poses X*, C* with observed Y, C in information form (paper, section 7).

    C^ = (C*^-1 + C^-1)^-1 and X^ = C^ (C*^-1 X* + C^-1 Y), written as X* + C^ C^-1 (Y - X*) so that the
    weighted mean is right on the circle. Shapes (n, 3) and (n, 3, 3).
    """
    fused_x, fused_C = np.empty((len(x), 3)), np.empty((len(x), 3, 3))
    for i in range(len(x)):
        information = inverse(triangle(R[i]))
        fused = inverse(plus(inverse(triangle(C[i])), information))
        step = times(fused, times(information, apart(y[i], x[i])))
        fused_x[i, 0], fused_x[i, 1] = x[i, 0] + step[0], x[i, 1] + step[1]
        fused_x[i, 2] = wrapped(x[i, 2] + step[2])
        put(fused, fused_C[i])
    return fused_x, fused_C


@njit(types.boolean[::1](MATRICES), cache=True)  # pragma: no cover - compiled
def is_covariance_each(m: Array) -> NDArray[np.bool_]:
    """Which of (n, 3, 3) are finite, symmetric and positive definite (by their leading minors)."""
    out = np.empty(len(m), dtype=np.bool_)
    for i in range(len(m)):
        finite, largest, skew = True, 0.0, 0.0
        for j in range(3):
            for k in range(3):
                finite = finite and np.isfinite(m[i, j, k])
                largest = max(largest, abs(m[i, j, k]))
                skew = max(skew, abs(m[i, j, k] - m[i, k, j]))
        a, b, _, d, _, _ = own = triangle(m[i])
        positive = a > 0.0 and a * d - b * b > 0.0 and determinant(own) > 0.0
        out[i] = finite and skew <= 1e-9 * largest and positive
    return out


@njit(  # pragma: no cover - compiled
    types.Tuple((NUMBERS, types.float64[:, ::1]))(ROWS, MATRICES, WEIGHTS), cache=True
)
def moments_of(x: Array, C: Array, weight: Array) -> tuple[Array, Array]:
    """Mean (3,) and covariance (3, 3) of a mixture of Gaussians (n, 3), (n, 3, 3) around its heaviest."""
    centre, total = x[np.argmax(weight)], weight.sum()
    shift, mean, covariance = np.zeros(3), np.empty(3), np.zeros((3, 3))
    for i in range(len(x)):
        delta = apart(x[i], centre)
        for j in range(3):
            shift[j] += weight[i] / total * delta[j]
    for i in range(len(x)):
        share, delta = weight[i] / total, apart(x[i], centre)
        for j in range(3):
            for k in range(j, 3):
                covariance[j, k] += share * (C[i, j, k] + (delta[j] - shift[j]) * (delta[k] - shift[k]))
                covariance[k, j] = covariance[j, k]
    mean[0], mean[1], mean[2] = centre[0] + shift[0], centre[1] + shift[1], wrapped(centre[2] + shift[2])
    return mean, covariance
