"""One frame, and one map, for scans at unknown poses (paper, section 3, figure 2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.geometry.pose import compose, inverse, transform
from eigenscan.mapbuilder.registration import Outline, register
from numpy.typing import NDArray
from skimage.draw import polygon

Array = NDArray[np.float64]

_LONGEST_GAP = np.deg2rad(3.0)
"""Between two beams of which something is known of the space between them."""


def composite(outlines: Sequence[Outline], least: float = 0.35) -> Array:
    """Poses (K, 3) of the scans in the first one's frame; NaN for a scan that none of the others joins.

    Every pair is registered; pairs that score at least `least` join, best first. Which of two scans comes
    first does not matter to the result but for rounding.
    """
    pairs = [
        (found.score, i, j, found.pose)
        for i in range(len(outlines))
        for j in range(i)
        if (found := register(outlines[j], outlines[i])) and found.score >= least
    ]
    poses = np.full((len(outlines), 3), np.nan)
    poses[0] = 0.0
    open_pairs = sorted(pairs, key=lambda pair: -pair[0])
    while True:
        reachable = [p for p in open_pairs if np.isnan(poses[p[1], 0]) != np.isnan(poses[p[2], 0])]
        if not reachable:
            return poses
        _, i, j, pose = reachable[0]
        if np.isnan(poses[i, 0]):
            poses[i] = compose(poses[j], pose)
        else:
            poses[j] = compose(poses[i], inverse(pose))


def composite_map(outlines: Sequence[Outline], poses: Array, resolution: float = 0.05) -> GridMap:
    """Map of scans at poses (K, 3), in the poses' frame.

    Free where a scan looked through, occupied where one ended, `resolution` in m per cell. Scans with a
    pose of NaN are left out. Raises ValueError where none is left.
    """
    placed = [(o, p) for o, p in zip(outlines, poses, strict=True) if np.isfinite(p).all() and len(o.ranges)]
    if not placed:
        raise ValueError("no scan with a pose to make a map of")
    points = [transform(pose, outline.points) for outline, pose in placed]
    reach = np.vstack([*points, *(pose[None, :2] for _, pose in placed)])
    low = np.floor(reach.min(axis=0) / resolution) - 2
    shape = (np.ceil(reach.max(axis=0) / resolution) - low + 3).astype(np.int64)[::-1]
    cells = np.full(shape, UNKNOWN, dtype=np.uint8)
    for (outline, pose), ends in zip(placed, points, strict=True):
        breaks = np.nonzero(np.diff(outline.bearings) > _LONGEST_GAP)[0] + 1
        for part in np.split(ends, breaks):
            corners = np.vstack([pose[None, :2], part]) / resolution - low
            rows, columns = polygon(corners[:, 1], corners[:, 0], cells.shape)
            cells[rows, columns] = FREE
    column, row = (np.floor(np.vstack(points) / resolution) - low).astype(np.int64).T
    cells[row, column] = OCCUPIED
    return GridMap(cells, resolution, np.array([*(low * resolution), 0.0]))
