"""A stretch of the way as one rigid piece: its walls, its free space, and its agreement with another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from eigenscan.geometry.carving import Carving
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.pose import Array, between, inverse, transform
from eigenscan.mapbuilder.mapping.alignment import on_walls
from eigenscan.mapbuilder.mapping.chain import Keyframe, Sweep
from eigenscan.mapbuilder.mapping.cloud import Cloud
from eigenscan.mapbuilder.mapping.correlation import CELL, Ground
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

REACH = 12.0
"""m, beyond which beams are too sparse to compare walls by."""
_CLEAR = 0.3
"""m, that free space is away from every wall."""
_CELL = 0.1


@dataclass(frozen=True)
class Submap:
    """`first` to `last`: its keyframes. `anchor`: the keyframe whose frame it uses.

    `cloud`: thinned walls within REACH of the sensor; `middle` (2,): of the robot's way.
    """

    first: int
    last: int
    anchor: int
    cloud: Cloud
    carved: GridMap
    middle: Array

    @classmethod
    def of(cls, keyframes: Sequence[Keyframe], sweeps: Sequence[Sweep], core: range, around: range) -> Submap:
        """Submap of the keyframes `core`; those of `around`, of the same part, lend it their walls."""
        anchor = core[len(core) // 2]
        origin = keyframes[anchor].pose
        poses = [between(origin, keyframes[k].pose) for k in around]
        clouds, views = [], []
        for k, pose in zip(around, poses, strict=True):
            cloud = keyframes[k].cloud
            near = np.hypot(*cloud.points.T) < REACH
            clouds.append(Cloud(cloud.points[near], cloud.directions[near], cloud.lengths[near]).moved(pose))
            views.append(transform(pose, sweeps[keyframes[k].sweep].mount[:2]))
        carving = Carving.around(np.vstack([*(c.points for c in clouds), *(v[None] for v in views)]), _CELL)
        for cloud, view in zip(clouds, views, strict=True):
            carving.add(view, cloud.points)
        way = np.array([pose[:2] for k, pose in zip(around, poses, strict=True) if k in core])
        return cls(
            core[0], core[-1], anchor, Cloud.joined(clouds).thinned(_CELL), carving.to_map(), way.mean(axis=0)
        )

    @cached_property
    def clear(self) -> NDArray[np.bool_]:
        """Cells (H, W) that were seen free, away from every wall."""
        wall = self.carved.cells == OCCUPIED
        away: NDArray[np.bool_] = np.asarray(distance_transform_edt(~wall) * _CELL > _CLEAR)
        clear: NDArray[np.bool_] = (self.carved.cells == FREE) & away
        return clear

    @cached_property
    def ground(self) -> Ground:
        """Its raster for the correlation."""
        block = round(CELL / _CELL)
        rows, columns = np.nonzero(self.clear[::block, ::block])
        free = self.carved.to_map(np.column_stack([columns * block, rows * block]) + 0.5)
        return Ground(self.cloud, free)

    def looks_through(self, points: Array) -> NDArray[np.bool_]:
        """Which of the points (K, 2), anchor's frame, lie in space that this piece saw free."""
        column, row = np.floor(self.carved.to_grid(points)).astype(np.int64).T
        height, width = self.clear.shape
        inside: NDArray[np.bool_] = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        inside[inside] = self.clear[row[inside], column[inside]]
        return inside


@dataclass(frozen=True)
class Agreement:
    """How two submaps fit: points of both on the other's walls, and in the other's free space."""

    agree: int
    contradict: int
    points: int
    """Points of the smaller piece."""

    @property
    def overlap(self) -> float:
        """Agreeing points of both, of twice the smaller."""
        return self.agree / max(2 * self.points, 1)

    @property
    def score(self) -> float:
        """-2..1: share of agreeing points less twice the share of contradicting ones."""
        return (self.agree - 2 * self.contradict) / max(self.agree + self.contradict, 1)


def compare(one: Submap, other: Submap, pose: Array) -> Agreement:
    """How `other` fits on `one` at `pose` (3,), anchor seen from anchor."""
    agree = contradict = 0
    for seen, checked, where in ((one, other, pose), (other, one, inverse(pose))):
        near = on_walls(seen.cloud, checked.cloud, where, within=0.2)
        agree += int(np.count_nonzero(near))
        contradict += int(
            np.count_nonzero(~near & seen.looks_through(transform(where, checked.cloud.points)))
        )
    return Agreement(agree, contradict, min(len(one.cloud.points), len(other.cloud.points)))
