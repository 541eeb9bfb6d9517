"""Optimises poses by all relative poses measured between them, and rejects wrong ones.

The optimisation is gtsam's: Levenberg-Marquardt inside graduated non-convexity (Yang et al. 2020), which
starts from least squares and turns, step by step, into a cost that ignores edges that cannot fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
from eigenscan.geometry.pose import Array
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

_ANCHOR = np.array([1e-4, 1e-4, 1e-5])


class MappingExtraError(ValueError):
    """The library that optimises is not installed; the message states how to."""


def check_installed() -> None:
    """Raises MappingExtraError where gtsam, an optional dependency, is not there."""
    if find_spec("gtsam") is None:
        raise MappingExtraError("mapping needs gtsam: pip install 'eigenscan-mapbuilder[mapping]'")


@dataclass(frozen=True)
class Edge:
    """`pose` (3,) of node `second` seen from node `first`, as measured.

    `covariance` (3, 3): of the d in compose(pose, d). `trusted`: never rejected, as the chain's own steps.
    """

    first: int
    second: int
    pose: Array
    covariance: Array
    trusted: bool = False


def parts(count: int, edges: Sequence[Edge]) -> NDArray[np.int64]:
    """Number (count,) of the connected part that each node is in."""
    first, second = np.array([(e.first, e.second) for e in edges], dtype=np.int64).reshape(-1, 2).T
    links = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def optimise(poses: ArrayLike, edges: Sequence[Edge]) -> tuple[Array, NDArray[np.bool_]]:
    """Optimised poses (K, 3), starting at `poses`, and which of the edges (E,) were kept.

    The first node of each connected part stays. Raises MappingExtraError without gtsam.
    """
    check_installed()
    import gtsam

    poses = np.asarray(poses, dtype=np.float64)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for node, pose in enumerate(poses):
        values.insert(node, gtsam.Pose2(*pose))
    for edge in edges:
        noise = gtsam.noiseModel.Gaussian.Covariance(edge.covariance)
        graph.add(gtsam.BetweenFactorPose2(edge.first, edge.second, gtsam.Pose2(*edge.pose), noise))
    _, firsts = np.unique(parts(len(poses), edges), return_index=True)
    hold = gtsam.noiseModel.Diagonal.Sigmas(_ANCHOR)
    for node in firsts.tolist():
        graph.add(gtsam.PriorFactorPose2(node, gtsam.Pose2(*poses[node]), hold))
    trusted = [n for n, edge in enumerate(edges) if edge.trusted]
    if len(trusted) == len(edges):
        found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
        return _array(found, len(poses)), np.ones(len(edges), dtype=np.bool_)
    parameters = gtsam.GncLMParams(gtsam.LevenbergMarquardtParams())
    parameters.setLossType(gtsam.GncLossType.TLS)
    parameters.setKnownInliers([*trusted, *range(len(edges), len(edges) + len(firsts))])
    optimizer = gtsam.GncLMOptimizer(graph, values, parameters)
    found = optimizer.optimize()
    return _array(found, len(poses)), np.asarray(optimizer.getWeights()[: len(edges)] > 0.5)


def _array(values: object, count: int) -> Array:
    import gtsam

    assert isinstance(values, gtsam.Values)
    at = [values.atPose2(node) for node in range(count)]
    return np.array([[pose.x(), pose.y(), pose.theta()] for pose in at])
