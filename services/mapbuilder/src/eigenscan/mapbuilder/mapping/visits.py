"""Aligns keyframes with other visits of the same place: these edges make a map sharp."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from eigenscan.geometry.pose import Array, between
from eigenscan.mapbuilder.mapping.alignment import FINE, align
from eigenscan.mapbuilder.mapping.chain import Keyframe
from eigenscan.mapbuilder.mapping.cloud import Cloud
from eigenscan.mapbuilder.mapping.pose_graph import Edge
from numpy.typing import NDArray
from scipy.spatial import KDTree

NEAR = 3.0
"""m between two keyframes that are compared."""
ANOTHER = 40
"""Keyframes apart in order, from which on it is another visit."""
VISITS = 3
AROUND = 4
"""Keyframes before and after the one that a visit is met at, which lend it their walls."""
LEAST = 0.6
"""Share of points on walls that a comparison needs."""


def visit_edges(
    keyframes: Sequence[Keyframe], poses: Array, progress: Callable[[float], None] = lambda _share: None
) -> list[Edge]:
    """Edges between keyframes (K) at `poses` (K, 3) that saw the same walls on different visits."""
    places = poses[:, :2]
    tree: Any = KDTree(places)
    local: dict[int, Cloud] = {}
    edges = []
    for k, place in enumerate(places):
        # one by one: all pairs of a drive of hours in one room would fill the memory
        others = np.array(tree.query_ball_point(place, NEAR, return_sorted=True), dtype=np.int64)
        for other in _met(others[others <= k - ANOTHER], poses, k):
            if other not in local:
                local[other] = _around(keyframes, other)
            start = between(poses[other], poses[k])
            found = align(local[other], keyframes[k].cloud, start, reaches=FINE)
            if found.share >= LEAST:
                edges.append(Edge(other, k, found.pose, found.covariance))
        progress((k + 1) / len(places))
    return edges


def _met(others: NDArray[np.int64], poses: Array, k: int) -> list[int]:
    """The keyframe nearest to `k` of each visit (a run of keyframes); the nearest visits first."""
    if not len(others):
        return []
    runs = np.split(others, np.nonzero(np.diff(others) > ANOTHER)[0] + 1)
    away = [np.hypot(*(poses[run, :2] - poses[k, :2]).T) for run in runs]
    nearest = sorted((float(a.min()), int(run[a.argmin()])) for run, a in zip(runs, away, strict=True))
    return [number for _, number in nearest[:VISITS]]


def _around(keyframes: Sequence[Keyframe], middle: int) -> Cloud:
    """Walls around a keyframe, in its frame, as the chain has them."""
    here = keyframes[middle]
    frames = [
        frame for frame in keyframes[max(middle - AROUND, 0) : middle + AROUND + 1] if frame.part == here.part
    ]
    return Cloud.joined([frame.cloud.moved(between(here.pose, frame.pose)) for frame in frames])
