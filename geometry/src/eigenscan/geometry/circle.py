"""Angles on the circle, in radians; arrays of any shape, which broadcast."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

TURN = 2.0 * np.pi


def wrap(angle: ArrayLike) -> NDArray[np.float64]:
    """The same directions in [-pi, pi)."""
    wrapped = np.mod(np.asarray(angle, dtype=np.float64) + np.pi, TURN) - np.pi
    # mod of a tiny negative number rounds to a full turn
    return np.where(wrapped >= np.pi, -np.pi, wrapped)


def difference(a: ArrayLike, b: ArrayLike) -> NDArray[np.float64]:
    """Shortest turns from `b` to `a`, in [-pi, pi)."""
    return wrap(np.asarray(a, dtype=np.float64) - np.asarray(b, dtype=np.float64))
