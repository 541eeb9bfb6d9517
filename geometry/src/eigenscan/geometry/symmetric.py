"""Symmetric 3 by 3 matrices in bulk, compiled, because numpy's overhead exceeds the work on a few hundred.

Inside, a matrix is its upper triangle row by row, six numbers without an array. Functions that end in `_each`
take n matrices and are compiled at import.
Only functions with one signature are cached on disk (CONTRIBUTING.md, compiled code): the small ones are
compiled into their callers. numba's `guvectorize` keeps a kernel and its wrapper in two files, which may not
fit if several processes compile at the same time.
"""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.inner import inner
from eigenscan.geometry.pose import Array
from numba import njit, types

Triangle = tuple[float, float, float, float, float, float]
Column = tuple[float, float, float]
MATRICES = types.Array(types.float64, 3, "A", readonly=True)
NUMBERS = types.float64[::1]


@inner()  # pragma: no cover - compiled
def triangle(m: Array) -> Triangle:
    """Upper triangle of (3, 3)."""
    return m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]


@inner()  # pragma: no cover - compiled
def put(m: Triangle, out: Array) -> None:
    """Writes a matrix to `out` (3, 3)."""
    out[0, 0], out[0, 1], out[0, 2] = m[0], m[1], m[2]
    out[1, 0], out[1, 1], out[1, 2] = m[1], m[3], m[4]
    out[2, 0], out[2, 1], out[2, 2] = m[2], m[4], m[5]


@inner()  # pragma: no cover - compiled
def plus(m: Triangle, n: Triangle) -> Triangle:
    """Sum."""
    return m[0] + n[0], m[1] + n[1], m[2] + n[2], m[3] + n[3], m[4] + n[4], m[5] + n[5]


@inner()  # pragma: no cover - compiled
def determinant(m: Triangle) -> float:
    """Determinant, along the first row."""
    a, b, c, d, e, f = m
    return a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)


@inner(error_model="numpy")  # pragma: no cover - compiled
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


@inner()  # pragma: no cover - compiled
def times(m: Triangle, v: Column) -> Column:
    """Matrix times column."""
    return (
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[1] * v[0] + m[3] * v[1] + m[4] * v[2],
        m[2] * v[0] + m[4] * v[1] + m[5] * v[2],
    )


@inner()  # pragma: no cover - compiled
def square(m: Triangle, v: Column) -> float:
    """Squared length of a column under a matrix: v' m v."""
    x, y, z = times(m, v)
    return x * v[0] + y * v[1] + z * v[2]


@njit(NUMBERS(MATRICES), cache=True)  # pragma: no cover - compiled
def determinant_each(m: Array) -> Array:
    """Determinants of (n, 3, 3)."""
    out = np.empty(len(m))
    for i in range(len(m)):
        out[i] = determinant(triangle(m[i]))
    return out


@njit(types.float64[:, :, ::1](MATRICES), cache=True)  # pragma: no cover - compiled
def inverse_each(m: Array) -> Array:
    """Inverses of (n, 3, 3)."""
    out = np.empty((len(m), 3, 3))
    for i in range(len(m)):
        put(inverse(triangle(m[i])), out[i])
    return out
