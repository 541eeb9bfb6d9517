"""Overlapping scans at unknown poses, registered by scan correlation (paper, section 3; Weiss et al. 1995).

The histogram of the directions of a scan's walls turns with the scan: the circular correlation of two of
them gives the rotation. Once they are parallel, the histograms of x and y along the walls only shift: their
correlations give the translation. In a room of right angles several rotations and shifts correlate alike,
so the peaks are candidates: the one under which each scan sees what the other saw, and no wall where the
other looked through, is refined by point-to-line matching.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from eigenscan.geometry.circle import TURN, wrap
from eigenscan.geometry.pose import inverse, transform
from numpy.typing import ArrayLike, NDArray
from scipy import fft
from scipy.spatial import KDTree

Array = NDArray[np.float64]

_DIRECTIONS = 360
_BIN = 0.1
"""m, of the histograms of x and y."""
_AGREE = 0.2
"""m, within which two scans see the same wall, before refinement."""
_ALIGNED = 0.7
"""Cosine of the angle within which two walls are one."""
_ROTATIONS, _SHIFTS, _REFINED = 8, 4, 6
"""Peaks that are tried, and candidates that are refined."""


@dataclass(frozen=True)
class Outline:
    """What one scan saw: ranges (B,), m, along bearings (B,), rad, ascending; only finite ranges count."""

    bearings: Array
    ranges: Array

    @classmethod
    def of(cls, ranges: ArrayLike, bearings: ArrayLike) -> Outline:
        """Outline of a scan (N,), m at rad; ranges that are not positive and finite are left out."""
        distance, angle = np.asarray(ranges, dtype=np.float64), np.asarray(bearings, dtype=np.float64)
        valid = np.isfinite(distance) & (distance > 0)
        return cls(angle[valid], distance[valid])

    @cached_property
    def points(self) -> Array:
        """Points (B, 2) in the sensor's frame."""
        directions: Array = np.column_stack([np.cos(self.bearings), np.sin(self.bearings)])
        return self.ranges[:, None] * directions

    @cached_property
    def tree(self) -> KDTree:
        """The points, for nearest neighbours."""
        return KDTree(self.points)

    @cached_property
    def _walls(self) -> tuple[Array, Array]:
        """Directions (B,), rad, of the wall through each point, and its length there, m; 0: on no wall."""
        before, after = self.points[:-4], self.points[4:]
        step = np.zeros_like(self.points)
        step[2:-2] = after - before
        length = np.linalg.norm(step, axis=1)
        # across a jump between two walls the step is much longer than along one
        step_limit = 0.3 + 0.1 * self.ranges
        return np.arctan2(step[:, 1], step[:, 0]), np.where(length < step_limit, length, 0.0)

    @property
    def directions(self) -> Array:
        """Direction (B,), rad, of the wall through each point."""
        return self._walls[0]

    @property
    def lengths(self) -> Array:
        """Length (B,), m, of the wall that a point stands for; 0 where it is on no wall."""
        return self._walls[1]

    def angle_histogram(self) -> Array:
        """Length of wall (360,) in each direction, smoothed over neighbouring bins."""
        place = np.floor(np.mod(self.directions, TURN) * (_DIRECTIONS / TURN)).astype(np.int64) % _DIRECTIONS
        counts = np.bincount(place, self.lengths, _DIRECTIONS).astype(np.float64)
        return (np.roll(counts, 1) + 2 * counts + np.roll(counts, -1)) / 4

    def looks_through(self, points: Array) -> NDArray[np.bool_]:
        """Which of the points (K, 2), sensor's frame, lie where this scan saw free space."""
        distance, angle = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
        turns = np.mod(angle - self.bearings[0], TURN)
        beam = np.searchsorted(self.bearings - self.bearings[0], turns).clip(1, len(self.bearings) - 1)
        gap = self.bearings[beam] - self.bearings[beam - 1]
        seen = (turns <= self.bearings[-1] - self.bearings[0]) & (gap < np.deg2rad(3.0))
        free = np.minimum(self.ranges[beam], self.ranges[beam - 1])
        through: NDArray[np.bool_] = seen & (distance < free - 2 * _AGREE)
        return through


@dataclass(frozen=True)
class Registration:
    """`pose` (3,) of the second scan in the first one's frame; m, rad.

    `score` in -1..1: share of the points that agree, less the share that contradict. `runner_up`: the
    score of the best pose elsewhere; close to `score` where the place is ambiguous.
    """

    pose: Array
    score: float
    runner_up: float


def register(first: Outline, second: Outline) -> Registration | None:
    """Pose of the second scan in the first one's frame, or None where one has too few points to say."""
    if min(len(first.ranges), len(second.ranges)) < 20:
        return None
    coarse = np.concatenate([_shifts(first, second, turn) for turn in _rotations(first, second)])
    scores = np.array([_score(first, second, pose) for pose in coarse])
    best = coarse[np.argsort(-scores, kind="stable")[:_REFINED]]
    refined = np.array([_refine(first, second, pose) for pose in best])
    scores = np.array([_score(first, second, pose) for pose in refined])
    winner = int(np.argmax(scores))
    away = np.hypot(*(refined[:, :2] - refined[winner, :2]).T) > 0.5
    turned = np.abs(wrap(refined[:, 2] - refined[winner, 2])) > np.deg2rad(10.0)
    others = scores[away | turned]
    return Registration(refined[winner], float(scores[winner]), float(others.max(initial=-1.0)))


def _peaks(correlation: Array, count: int) -> NDArray[np.int64]:
    """The `count` highest local maxima of a circular correlation."""
    top = (correlation >= np.roll(correlation, 1)) & (correlation > np.roll(correlation, -1))
    where = np.nonzero(top)[0]
    return where[np.argsort(-correlation[where], kind="stable")[:count]]


def _rotations(first: Outline, second: Outline) -> Array:
    """Candidate turns, rad, of the second scan."""
    a, b = first.angle_histogram(), second.angle_histogram()
    peaks = _peaks(fft.irfft(fft.rfft(a) * np.conj(fft.rfft(b)), _DIRECTIONS), _ROTATIONS)
    return peaks.astype(np.float64) * (TURN / _DIRECTIONS)


def _shifts(first: Outline, second: Outline, turn: float) -> Array:
    """Candidate poses (K, 3) with the given turn, by the histograms along the first scan's main walls."""
    walls = np.mod(first.directions, TURN / 4)
    main = np.bincount(np.floor(walls * (_DIRECTIONS / TURN)).astype(np.int64), first.lengths).argmax()
    main_angle = (main + 0.5) * (TURN / _DIRECTIONS)
    a = transform([0, 0, -main_angle], first.points)
    b = transform([0, 0, turn - main_angle], second.points)
    shifts = [_along(a[:, axis], first.lengths, b[:, axis], second.lengths) for axis in (0, 1)]
    x, y = np.meshgrid(*shifts)
    moved = transform([0, 0, main_angle], np.column_stack([x.ravel(), y.ravel()]))
    return np.column_stack([moved, np.full(len(moved), wrap(turn))])


def _along(a: Array, weight_a: Array, b: Array, weight_b: Array) -> Array:
    """Candidate shifts, m, of the values b onto a, by the correlation of their histograms."""
    reach = max(np.abs(a).max(), np.abs(b).max())
    size = fft.next_fast_len(4 * int(np.ceil(reach / _BIN)) + 4)
    histograms = [
        np.bincount(np.floor((values + reach) / _BIN).astype(np.int64), weights, size)
        for values, weights in ((a, weight_a), (b, weight_b))
    ]
    one, other = (fft.rfft(h) for h in histograms)
    peak = _peaks(fft.irfft(one * np.conj(other), size), _SHIFTS)
    shifts: Array = np.where(peak > size // 2, peak - size, peak) * _BIN
    return shifts


def _score(first: Outline, second: Outline, pose: Array) -> float:
    """Share of the points of both scans that agree, less the share that contradict."""
    agree, contradict = 0, 0
    for seen, other, where in ((first, second, pose), (second, first, inverse(pose))):
        points = transform(where, other.points)
        distance, nearest = seen.tree.query(points, distance_upper_bound=_AGREE)
        near, match = distance < _AGREE, np.minimum(nearest, len(seen.ranges) - 1)
        # beams run counter-clockwise: a wall that is seen from its other side has the opposite direction
        aligned = np.cos(seen.directions[match] - other.directions - where[2]) > _ALIGNED
        blank = (seen.lengths[match] == 0) | (other.lengths == 0)
        agree += int(np.count_nonzero(near & (aligned | blank)))
        contradict += int(np.count_nonzero(~near & seen.looks_through(points)))
    return (agree - 2 * contradict) / (len(first.ranges) + len(second.ranges))


def _refine(first: Outline, second: Outline, pose: Array) -> Array:
    """Pose after point-to-line matching, with a reach that shrinks (Chen and Medioni 1992)."""
    normals = np.column_stack([-np.sin(first.directions), np.cos(first.directions)])
    for reach in (0.5, 0.5, 0.3, 0.3, 0.15, 0.15, 0.1, 0.1):
        points = transform(pose, second.points)
        distance, nearest = first.tree.query(points, distance_upper_bound=reach)
        match = np.minimum(nearest, len(first.ranges) - 1)
        used = np.isfinite(distance) & (first.lengths[match] > 0)
        if np.count_nonzero(used) < 10:
            return pose
        normal, at = normals[match[used]], points[used]
        offset = np.sum(normal * (first.points[match[used]] - at), axis=1)
        lever = at - pose[:2]
        turned = normal[:, 1] * lever[:, 0] - normal[:, 0] * lever[:, 1]
        step = np.linalg.lstsq(np.column_stack([normal, turned]), offset, rcond=None)[0]
        pose = np.array([*(pose[:2] + step[:2]), float(wrap(pose[2] + step[2]))])
    return pose
