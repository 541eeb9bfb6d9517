"""Finds poses of a cloud on another without a prior: the correlation of paper section 3, on two axes at once.

Cross-correlated histograms of the walls' directions give the rotation (Weiss et al. 1995). The histograms of
x and of y are projections of one plane histogram; that one is correlated as a whole, so that neighbouring
rooms do not blur each other. A wall in space that was seen free counts against the pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from eigenscan.geometry.circle import TURN, wrap
from eigenscan.geometry.pose import Array, between, transform
from eigenscan.mapbuilder.mapping.cloud import Cloud
from numpy.typing import ArrayLike, NDArray
from scipy import fft
from scipy.ndimage import gaussian_filter

CELL = 0.2
"""m, of the plane histogram."""
DIRECTIONS = 360
ROTATIONS, SHIFTS = 6, 3
"""Peaks that are followed."""
AGAINST = 0.5
"""Weight of a wall in free space, relative to one on a wall."""
_BESIDE = np.indices((5, 5)).reshape(2, -1) - 2
"""Rows and columns, relative to a peak's, of the cells (25,) that it is the highest of."""


@dataclass(frozen=True)
class Ground:
    """A cloud, and the points (F, 2) of a lattice of CELL m that were seen free, to be correlated with."""

    cloud: Cloud
    free: Array

    @cached_property
    def directions(self) -> Array:
        """Length of wall (360,) in each direction, smoothed over neighbouring bins."""
        return direction_histogram(self.cloud)

    @cached_property
    def low(self) -> NDArray[np.int64]:
        """First cell (2,), column and row, of the raster."""
        places = [_cells(self.cloud.points), _cells(self.free)]
        low: NDArray[np.int64] = np.concatenate(places).min(axis=0) - 2
        return low

    @cached_property
    def raster(self) -> Array:
        """Cells (H, W): 1 on walls, fading over a cell; -AGAINST in free space; 0 in unknown space."""
        wall, free = _cells(self.cloud.points) - self.low, _cells(self.free) - self.low
        shape = np.concatenate([wall, free]).max(axis=0) + 3
        raster = np.zeros((shape[1], shape[0]))
        raster[wall[:, 1], wall[:, 0]] = 1.0
        near = np.minimum(gaussian_filter(raster, 0.7) / 0.4, 1.0)
        raster[free[:, 1], free[:, 0]] = -AGAINST
        return np.where(near > 0.1, near, np.minimum(raster, 0.0))


def direction_histogram(cloud: Cloud) -> Array:
    """Length of wall (360,) in each direction, smoothed over neighbouring bins."""
    place = np.floor(np.mod(cloud.directions, TURN) * (DIRECTIONS / TURN)).astype(np.int64) % DIRECTIONS
    counts = np.bincount(place, cloud.lengths, DIRECTIONS).astype(np.float64)
    return (np.roll(counts, 1) + 2 * counts + np.roll(counts, -1)) / 4


def correlate(
    ground: Ground, cloud: Cloud, expected: ArrayLike, window: ArrayLike, least: float = -np.inf
) -> tuple[Array, Array]:
    """Poses (K, 3) of the cloud at peaks of its correlation with the ground, and heights (K,), best first.

    Only within `window` (2,), m and rad, of `expected` (3,): the distance of the cloud's middle, and of its
    heading. Only heights above `least`; a height of 1: every point is on a wall.
    """
    expected, (reach, turn) = np.asarray(expected, dtype=np.float64), np.asarray(window, dtype=np.float64)
    middle = cloud.points.mean(axis=0)
    at = transform(expected, middle)
    found = [
        _shifts(ground, cloud, angle, middle, at, reach, least)
        for angle in _rotations(ground, cloud, expected[2], turn)
    ]
    if not found:
        return np.zeros((0, 3)), np.zeros(0)
    poses, heights = np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found])
    order = np.argsort(-heights, kind="stable")
    return poses[order], heights[order]


def _rotations(ground: Ground, cloud: Cloud, expected: float, window: float) -> Array:
    """Turns, rad, of the cloud at which the histograms of directions correlate most."""
    one, other = fft.rfft(ground.directions), fft.rfft(direction_histogram(cloud))
    correlation = fft.irfft(one * np.conj(other), DIRECTIONS)
    angles = np.arange(DIRECTIONS, dtype=np.float64) * (TURN / DIRECTIONS)
    inside = np.abs(wrap(angles - expected)) <= window
    top = (correlation >= np.roll(correlation, 1)) & (correlation > np.roll(correlation, -1)) & inside
    where = np.nonzero(top)[0]
    best: Array = angles[where[np.argsort(-correlation[where], kind="stable")[:ROTATIONS]]]
    return best


def _shifts(
    ground: Ground, cloud: Cloud, angle: float, middle: Array, at: Array, reach: float, least: float
) -> tuple[Array, Array]:
    """Poses (K, 3) with one heading, their middle within `reach` of `at`, and their heights (K,)."""
    turned = transform([0.0, 0.0, angle], cloud.points)
    cells = _cells(turned)
    low = cells.min(axis=0)
    cells -= low
    extent = cells.max(axis=0) + 1
    height, width = ground.raster.shape
    size = [fft.next_fast_len(int(n), real=True) for n in (height + extent[1], width + extent[0])]
    counts = np.zeros((extent[1], extent[0]))
    np.add.at(counts, (cells[:, 1], cells[:, 0]), 1.0 / len(cells))
    product = fft.rfft2(ground.raster, size) * np.conj(fft.rfft2(counts, size))
    surface = fft.irfft2(product, size)
    row, column = np.nonzero(surface > least)  # few: to look for peaks among all takes longer than the rest
    # a shift of cells moves the cloud's own first cell onto the ground's
    x = (np.where(column > width, column - size[1], column) + ground.low[0] - low[0]) * CELL
    y = (np.where(row > height, row - size[0], row) + ground.low[1] - low[1]) * CELL
    away = at - transform([0.0, 0.0, angle], middle)
    near = np.nonzero(np.hypot(x - away[0], y - away[1]) <= reach)[0]
    rows, columns = row[near, None] + _BESIDE[0], column[near, None] + _BESIDE[1]
    heights = surface[row, column]
    top = near[heights[near] >= surface[rows % size[0], columns % size[1]].max(axis=1)]
    best = top[np.argsort(-heights[top], kind="stable")[:SHIFTS]]
    return np.column_stack([x[best], y[best], np.full(len(best), wrap(angle))]), heights[best]


def _cells(points: Array) -> NDArray[np.int64]:
    return np.floor(points / CELL).astype(np.int64)


def apart(
    poses: Array, pose: Array, metres: float = 0.5, radians: float = float(np.deg2rad(10.0))
) -> NDArray[np.bool_]:
    """Which of the poses (K, 3) differ from `pose`."""
    step = between(pose, poses)
    elsewhere: NDArray[np.bool_] = (np.hypot(step[:, 0], step[:, 1]) > metres) | (
        np.abs(step[:, 2]) > radians
    )
    return elsewhere
