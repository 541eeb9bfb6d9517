"""Symmetric 3 by 3 matrices in bulk, compiled: numpy takes longer to start than a scan's few hundred take.

Inside, a matrix is its upper triangle row by row, six numbers, so that nothing is put in memory. What ends in
`_each` takes arrays of any leading shape, as numpy's own functions do, and is compiled when it is imported.
"""

from __future__ import annotations

from math import pi

import numpy as np
from numba import guvectorize, njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Triangle = tuple[float, float, float, float, float, float]
Column = tuple[float, float, float]


@njit(cache=True)  # pragma: no cover - compiled
def triangle(m: Array) -> Triangle:
    """Upper triangle of (3, 3)."""
    return m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]


@njit(cache=True)  # pragma: no cover - compiled
def put(m: Triangle, out: Array) -> None:
    """Writes a matrix to `out` (3, 3)."""
    out[0, 0], out[0, 1], out[0, 2] = m[0], m[1], m[2]
    out[1, 0], out[1, 1], out[1, 2] = m[1], m[3], m[4]
    out[2, 0], out[2, 1], out[2, 2] = m[2], m[4], m[5]


@njit(cache=True)  # pragma: no cover - compiled
def plus(m: Triangle, n: Triangle) -> Triangle:
    """Sum."""
    return m[0] + n[0], m[1] + n[1], m[2] + n[2], m[3] + n[3], m[4] + n[4], m[5] + n[5]


@njit(cache=True)  # pragma: no cover - compiled
def determinant(m: Triangle) -> float:
    """Determinant, along the first row."""
    a, b, c, d, e, f = m
    return a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)


@njit(cache=True, error_model="numpy")  # pragma: no cover - compiled
def inverse(m: Triangle) -> Triangle:
    """Inverse by the adjugate."""
    a, b, c, d, e, f = m
    scale = 1.0 / determinant(m)
    return (
        (d * f - e * e) * scale,
        (c * e - b * f) * scale,
        (b * e - c * d) * scale,
        (a * f - c * c) * scale,
        (b * c - a * e) * scale,
        (a * d - b * b) * scale,
    )


@njit(cache=True)  # pragma: no cover - compiled
def times(m: Triangle, v: Column) -> Column:
    """Matrix times column."""
    return (
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[1] * v[0] + m[3] * v[1] + m[4] * v[2],
        m[2] * v[0] + m[4] * v[1] + m[5] * v[2],
    )


@njit(cache=True)  # pragma: no cover - compiled
def square(m: Triangle, v: Column) -> float:
    """Squared length of a column under a matrix: v' m v."""
    x, y, z = times(m, v)
    return x * v[0] + y * v[1] + z * v[2]


@njit(cache=True)  # pragma: no cover - compiled
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


@njit(cache=True)  # pragma: no cover - compiled
def apart(y: Array, x: Array) -> Column:
    """Pose `y` (3,) minus pose `x` (3,), the heading by the shortest turn."""
    turn = (y[2] - x[2] + pi) % (2.0 * pi) - pi
    # the remainder of a tiny negative number rounds to a full turn
    return y[0] - x[0], y[1] - x[1], turn if turn < pi else -pi


@guvectorize(["(f8[:,:], f8[:])"], "(n,n)->()", cache=True)  # pragma: no cover - compiled
def determinant_each(m: Array, out: Array) -> None:
    """Determinants of (..., 3, 3)."""
    out[0] = determinant(triangle(m))


@guvectorize(["(f8[:,:], f8[:,:])"], "(n,n)->(n,n)", cache=True)  # pragma: no cover - compiled
def inverse_each(m: Array, out: Array) -> None:
    """Inverses of (..., 3, 3)."""
    put(inverse(triangle(m)), out)


@guvectorize(["(f8[:], f8[:], f8[:])"], "(n),(n)->(n)", cache=True)  # pragma: no cover - compiled
def apart_each(y: Array, x: Array, out: Array) -> None:
    """Poses (..., 3) minus poses (..., 3)."""
    out[0], out[1], out[2] = apart(y, x)


@guvectorize(["(f8[:], f8[:,:], f8[:])"], "(n),(n,n)->()", cache=True)  # pragma: no cover - compiled
def mahalanobis_squared_each(delta: Array, covariance: Array, out: Array) -> None:
    """Squared Mahalanobis lengths of (..., 3) under (..., 3, 3)."""
    out[0] = square(inverse(triangle(covariance)), (delta[0], delta[1], delta[2]))


@guvectorize(  # pragma: no cover - compiled
    ["(f8[:], f8[:,:], f8[:], f8[:,:], f8[:], f8[:,:])"], "(n),(n,n),(n),(n,n)->(n),(n,n)", cache=True
)
def fuse_each(x: Array, C: Array, y: Array, R: Array, fused_x: Array, fused_C: Array) -> None:
    """Kalman updates in information form: poses (..., 3) and covariances (..., 3, 3)."""
    information = inverse(triangle(R))
    fused = inverse(plus(inverse(triangle(C)), information))
    step = times(fused, times(information, apart(y, x)))
    fused_x[0], fused_x[1] = x[0] + step[0], x[1] + step[1]
    turned = (x[2] + step[2] + pi) % (2.0 * pi) - pi
    fused_x[2] = turned if turned < pi else -pi
    put(fused, fused_C)
