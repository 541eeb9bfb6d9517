"""One scan's end points on walls, with the direction of the wall at each, for the alignment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from eigenscan.geometry.circle import TURN, wrap
from eigenscan.geometry.pose import Array, transform
from numpy.typing import ArrayLike
from scipy.spatial import KDTree


@dataclass(frozen=True)
class Outline:
    """One scan: ranges (B,), m, along bearings (B,), rad, ascending; only finite ranges count."""

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
    def walls(self) -> tuple[Array, Array]:
        """Directions (B,), rad, of the wall through each point, and its length there, m; 0: on no wall."""
        before, after = self.points[:-4], self.points[4:]
        step = np.zeros_like(self.points)
        step[2:-2] = after - before
        length = np.linalg.norm(step, axis=1)
        # across a jump between two walls the step is much longer than along one
        step_limit = 0.3 + 0.1 * self.ranges
        return np.arctan2(step[:, 1], step[:, 0]), np.where(length < step_limit, length, 0.0)


@dataclass(frozen=True)
class Cloud:
    """Points (K, 2), m, the directions (K,), rad, of their walls, and the wall's length there (K,), m.

    A wall runs along its direction with the seen side on the left, as a scan passes it counter-clockwise
    with the sensor inside. Length 0: the point is on no wall, and its direction means nothing.
    """

    points: Array
    directions: Array
    lengths: Array

    @classmethod
    def of(cls, outline: Outline, mount: ArrayLike) -> Cloud:
        """Cloud of one scan in the base frame; `mount` (3,) is the sensor in it."""
        turn = float(np.asarray(mount)[2])
        directions, lengths = outline.walls
        return cls(transform(mount, outline.points), wrap(directions + turn), lengths)

    @classmethod
    def joined(cls, clouds: Sequence[Cloud]) -> Cloud:
        """All points of several clouds of one frame."""
        return cls(
            np.concatenate([cloud.points for cloud in clouds]),
            np.concatenate([cloud.directions for cloud in clouds]),
            np.concatenate([cloud.lengths for cloud in clouds]),
        )

    def moved(self, pose: ArrayLike) -> Cloud:
        """The cloud, given in the frame of `pose` (3,), in the frame that `pose` is given in."""
        turn = float(np.asarray(pose)[2])
        return Cloud(transform(pose, self.points), wrap(self.directions + turn), self.lengths)

    def thinned(self, cell: float) -> Cloud:
        """One point, the first, of each square of `cell` m and quarter of directions."""
        place = np.floor(self.points / cell).astype(np.int64)
        quarter = np.floor(np.mod(self.directions, TURN) * (4 / TURN)).astype(np.int64)
        _, first = np.unique(np.column_stack([place, quarter]), axis=0, return_index=True)
        first.sort()
        return Cloud(self.points[first], self.directions[first], self.lengths[first])

    @cached_property
    def normals(self) -> Array:
        """Unit normals (K, 2) of the walls; 0 for a point on no wall."""
        normal = np.column_stack([-np.sin(self.directions), np.cos(self.directions)])
        return np.where(self.lengths[:, None] > 0, normal, 0.0)

    @cached_property
    def tree(self) -> KDTree:
        """The points, for nearest neighbours."""
        return KDTree(self.points, balanced_tree=False, compact_nodes=False)
