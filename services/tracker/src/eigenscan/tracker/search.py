"""Which search the next scan of a lidar needs.

A list of the whole map is evidence by how far the robot has moved on since the last one. Between two of them
a sure robot needs no more than to know where it is by now: a fit around its pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.tracker.association import associate
from eigenscan.tracker.branching import fused
from eigenscan.tracker.evidence import EVEN_POOR, likelihood_at
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.planar import IDENTITY, Pose, scaled
from eigenscan.tracker.tracks import Tracks
from numpy.typing import NDArray

Array = NDArray[np.float64]

EVERY_NS = 1_000_000_000
"""At least so often the whole map is searched: standing still, too, a robot may be carried off."""
LONGEST_NS = 500_000_000
"""Between two scans, over which their velocity still predicts the next pose."""
UNKNOWN_S = 0.05
"""Of the motion between two scans, above which it gives no velocity."""
FALL = 5.0
"""Nats that a fit may lack of the last whole search's likelihood there: 0.15 of its support."""


@dataclass(frozen=True)
class Request:
    """For the scan after `stamp`, ns, of a lidar: to be searched around a pose if it is `local`.

    `velocity`: in the base frame, m/s, m/s, rad/s. `least`: log-likelihood below which the pose is lost.
    """

    lidar: str
    stamp: int
    frame: str
    local: bool = False
    pose: Pose = IDENTITY
    covariance: Array | None = None
    velocity: Pose = IDENTITY
    least: float = 0.0


@dataclass
class _Lidar:
    """Stamps, ns, of its last list and of its last whole one; what the robot moved on since then.

    `there`: log-likelihood of the best track's place in the whole one.
    """

    last: int
    whole: int
    progress: float = 0.0
    there: float = 0.0


class Searches:
    """What the lidars of one robot are asked for."""

    def __init__(self) -> None:
        self._lidars: dict[str, _Lidar] = {}

    def last(self, lidar: str, stamp: int) -> int:
        """Stamp of the lidar's last list, ns; `stamp` where this is its first."""
        return self._lidars[lidar].last if lidar in self._lidars else stamp

    def after(
        self, seen: Observation, moved: Motion, progress: float, tracks: Tracks, best: int, *, sure: bool
    ) -> Request:
        """The request that follows a list.

        `moved` and `progress`: since the lidar's last list, 1: a scan is new evidence. `sure`: whether
        nothing else speaks for a whole search.
        """
        known = self._lidars.setdefault(seen.lidar, _Lidar(seen.stamp, seen.stamp))
        known.progress += progress
        interval, known.last = seen.stamp - known.last, seen.stamp
        if seen.usable and not seen.local:
            known.whole, known.progress = seen.stamp, 0.0
            known.there = likelihood_at(tracks.x[best], seen) if best >= 0 else 0.0
        due = known.progress + progress >= 1.0 or seen.stamp + interval - known.whole >= EVERY_NS
        predicts = 0 < interval <= LONGEST_NS and moved.unknown <= UNKNOWN_S
        steady = predicts and moved.breaks == 0 and moved.slip == 0
        whole = Request(seen.lidar, seen.stamp, seen.frame)
        if due or not (steady and sure and known.there >= EVEN_POOR):
            return whole
        if not np.isfinite(tracks.nis[best]):  # the list does not have the pose
            return whole
        x, y, theta = tracks.x[best].tolist()
        velocity = scaled(moved.delta, 1e9 / interval)
        return Request(
            seen.lidar,
            seen.stamp,
            seen.frame,
            True,
            (x, y, theta),
            tracks.C[best],
            velocity,
            known.there - FALL,
        )


def follow(tracks: Tracks, seen: Observation, gate: float, precision: float) -> Tracks:
    """Tracks brought to the poses of a local list in their gates, with the masses that they had.

    It was made where a track was predicted. It omits other places, so it is no evidence for this one.
    """
    pairs = associate(tracks.x, tracks.C, seen.poses, seen.covariances, gate)
    order = np.lexsort((pairs.distance2, pairs.track))
    _, first = np.unique(pairs.track[order], return_index=True)
    own = pairs.pick(order[first])
    others = np.setdiff1d(np.arange(len(tracks)), own.track)
    rows = np.concatenate([others, own.track])
    return fused(tracks.pick(rows), len(others), seen, own, precision).pick(np.argsort(rows))
