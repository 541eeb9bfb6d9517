"""Makes a better map of a given one: scans that were located on it keep its frame, and show its true walls.

Walls of a given map may be thick, displaced or gone. The scans of a drive fit to each other better than to
it: their own pose graph gives the walls their shape, and the poses on the given map hold the graph in its
frame. Where the drive saw nothing, the given map remains, with thick walls drawn by their middles: a map has
one thickness of walls, and with two neither the seen nor the other walls are where a scan expects them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.distance_tiles import distance_tiles
from eigenscan.geometry.gridmap import OCCUPIED, UNKNOWN, GridMap
from eigenscan.geometry.pose import Array, between, compose, inverse, transform
from eigenscan.geometry.surfaces import Surfaces
from eigenscan.mapbuilder.mapping.chain import Keyframe
from eigenscan.mapbuilder.mapping.pose_graph import Edge
from numpy.typing import NDArray

INEXACT = np.diag([0.3, 0.3, np.deg2rad(3.0)]) ** 2
"""Covariance (3, 3) of what a given map is displaced by, at one keyframe: between maps that are displaced by
0.1 and by 0.4 m. This and the constants below: benchmarks/second_day.py."""
NEAR_M, NEAR_RAD = 3.0, float(np.deg2rad(15.0))
"""Drift of a part from the map, before the graph is optimised; a pose farther off is wrong."""
LEAST = 8
"""Located keyframes that must agree on where a part of the drive lies: some two metres of way."""


@dataclass(frozen=True)
class Located:
    """A given map, and what is known of the scans' poses on it.

    `numbers` (n,): the located scans; `poses` (n, 3): of the base in the map frame; `covariances` (n, 3, 3)
    of the d in compose(pose, d).
    """

    grid: GridMap
    numbers: NDArray[np.int64]
    poses: Array
    covariances: Array


def located_edges(keyframes: Sequence[Keyframe], located: Located, node: int) -> list[Edge]:
    """Edges from the given map, as graph node `node`, to the keyframes whose scans were located."""
    row = {int(number): n for n, number in enumerate(located.numbers)}
    return [
        Edge(node, k, located.poses[n], located.covariances[n] + INEXACT)
        for k, frame in enumerate(keyframes)
        if (n := row.get(frame.sweep)) is not None
    ]


def frame_on(edges: Sequence[Edge], poses: Array) -> Array | None:
    """Pose (3,), on the given map, of the frame of `poses` (K, 3): the one most edges agree on.

    None if fewer than LEAST agree, or less than half of them.
    """
    if not edges:
        return None
    known, own = np.array([edge.pose for edge in edges]), poses[[edge.second for edge in edges]]
    frames = compose(known, inverse(own))
    agree = [np.count_nonzero(_near(known, compose(frame, own))) for frame in frames]
    best = int(np.argmax(agree))
    return np.asarray(frames[best]) if agree[best] >= max(LEAST, len(edges) / 2) else None


def _near(poses: Array, others: Array) -> NDArray[np.bool_]:
    """Whether each pose (K, 3) is about the other."""
    step = between(poses, others)
    return np.asarray((np.hypot(step[:, 0], step[:, 1]) < NEAR_M) & (np.abs(step[:, 2]) < NEAR_RAD))


def filled(carved: GridMap, given: GridMap) -> GridMap:
    """The carved map, with the given one's cells where nothing was seen.

    Thick walls of the given map are thinned to their middles. Nearer to a carved surface than an ordinary
    wall is thick there are none: they are the same wall.
    """
    surfaces = Surfaces.of(given)
    row, column = np.nonzero(carved.cells == UNKNOWN)
    cells = carved.cells.copy()
    cells[row, column] = surfaces.grid.at(carved.to_map(np.stack([column, row], axis=-1) + 0.5))
    if surfaces.thinned:
        reach = surfaces.thickness / carved.resolution
        for part, distance in distance_tiles(carved.cells != OCCUPIED, reach):
            same = (distance <= reach) & (carved.cells[part] == UNKNOWN) & (cells[part] == OCCUPIED)
            cells[part][same] = UNKNOWN
    return GridMap(cells, carved.resolution, carved.origin)


def corners(given: GridMap) -> Array:
    """Corners (4, 2) of a map, in its frame."""
    height, width = given.cells.shape
    outline = np.array([[0, 0], [width, 0], [0, height], [width, height]], dtype=np.float64)
    return transform(given.origin, outline * given.resolution)
