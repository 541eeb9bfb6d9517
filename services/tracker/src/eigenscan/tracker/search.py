"""Which search the next scan of a lidar needs.

A list of the whole map is evidence by how far the robot has moved on since the last one. Between two of them
a sure robot needs no more than to know where it is by now: a fit around its pose.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
from eigenscan.tracker.agreement import UNKNOWN_S
from eigenscan.tracker.continuity import are_neighbours
from eigenscan.tracker.evidence import likelihood_at
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.planar import IDENTITY, Pose, scaled
from eigenscan.tracker.tracks import Tracks
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEW = 0.5
"""Of the way that makes a scan new evidence: so often the whole map is searched while the robot moves.

With 1 a wrong place on intel came to 0.91 that stays at 0.84 with each scan searched, and one kidnap of eight
on fr079 took longer: of the windows and kidnaps of benchmarks/evaluate.py, thinned, on maps of 0.5 m.
"""
SURE = 0.99
"""Confidence from which a robot does without the scans between: its odometry, too, has been confirmed.

With 0.99 of the belief alone, a robot in an invented room on intel kept its claim for 96 scans of 1,825 more,
and fr079 had two false claims more: the same windows, and benchmarks/integrity.py --quick.
"""
EVERY_NS = 1_000_000_000
"""At least so often the whole map is searched: standing still, too, a robot may be carried off."""
SHORTEST_NS, LONGEST_NS = 100_000_000, 1_000_000_000
"""Time over which a velocity is taken: over less the jitter of stamps shows, over more it is out of date."""
KEPT = 16
"""Stamps of lists: as many as may come within SHORTEST_NS."""
PLACES = 16
"""Tracks at most at whose poses a search of the whole map also looks.

Half of the lists without the right place have it if they look there (benchmarks/single_scan.py --stages).
"""
POSSIBLE = 0.05
"""Mass of a track from which a search looks at its pose: a wrong place, too, is found oftener where it looks.

With 1e-4 a half map has more false claims (benchmarks/maps.py --way "every other 30 m missing"), with 0.01 a
kidnap of fr079 takes longer.
"""
NOWHERE = np.zeros((0, 3))
FITS = 13.0
"""Log-likelihood of a place from which its next scans may be fitted alone."""
FALL = 5.0
"""Nats that a fit may lack of the last whole search's likelihood there: 0.15 of its support."""


@dataclass(frozen=True)
class Request:
    """For the scan after `stamp`, ns, of a lidar: to be searched around a pose if it is `local`.

    `places` (n, 3): of tracks, where a search of the whole map also looks. `velocity`: in the base frame,
    m/s, m/s, rad/s. `least`: log-likelihood below which the pose is lost.
    """

    lidar: str
    stamp: int
    frame: str
    places: Array
    local: bool = False
    pose: Pose = IDENTITY
    covariance: Array | None = None
    velocity: Pose = IDENTITY
    least: float = 0.0


@dataclass
class _Lidar:
    """Stamps, ns, of its last lists and of its last whole one; what the robot moved on since then.

    `there`: log-likelihood of the best track's place in the whole one.
    """

    whole: int
    lists: deque[int] = field(default_factory=lambda: deque(maxlen=KEPT))
    progress: float = 0.0
    there: float = 0.0


class Searches:
    """What the lidars of one robot are asked for."""

    def __init__(self) -> None:
        self._lidars: dict[str, _Lidar] = {}

    def last(self, lidar: str, stamp: int) -> int:
        """Stamp of the lidar's last list, ns; `stamp` where this is its first."""
        return self._lidars[lidar].lists[-1] if lidar in self._lidars else stamp

    def whole(self, seen: Observation) -> int:
        """Stamp of the lidar's last list of the whole map, ns, up to the one that was `seen`."""
        known = self._lidars.get(seen.lidar)
        return seen.stamp if known is None or is_whole(seen) else known.whole

    def since(self, lidar: str, stamp: int) -> int:
        """Stamp, ns, of the lidar's list from which the motion up to `stamp` gives a velocity."""
        lists = self._lidars[lidar].lists if lidar in self._lidars else [stamp]
        return next((one for one in reversed(lists) if stamp - one >= SHORTEST_NS), lists[0])

    def after(
        self,
        seen: Observation,
        moved: Motion,
        progress: float,
        since_whole: Motion,
        tracks: Tracks,
        frame: int,
        best: int,
        *,
        sure: bool,
    ) -> Request:
        """The request that follows a list.

        `moved`: since the list of `since`. `progress`: since the last list, 1: a scan is new evidence.
        `since_whole`: from the stamp of `whole` to where the next scan is expected. `frame`: the list's.
        `sure`: whether nothing else speaks for a whole search.
        """
        known = self._lidars.setdefault(seen.lidar, _Lidar(seen.stamp))
        known.progress += progress
        interval = seen.stamp - known.lists[-1] if known.lists else 0
        known.lists.append(seen.stamp)
        if is_whole(seen):
            known.whole, known.progress = seen.stamp, 0.0
            known.there = likelihood_at(tracks.x[best], seen) if best >= 0 else 0.0
        due = known.progress + progress >= NEW or seen.stamp + interval - known.whole >= EVERY_NS
        # a kidnap shows by lists of which none goes on in the next one: these must lie near each other
        due = due or not are_neighbours(since_whole)
        predicts = SHORTEST_NS <= round(moved.seconds * 1e9) <= LONGEST_NS and moved.unknown <= UNKNOWN_S
        predicts = predicts and moved.breaks == 0
        velocity = scaled(moved.delta, 1.0 / moved.seconds) if predicts else IDENTITY
        # without a velocity a track is not where the next scan is
        places = _places(tracks, frame) if predicts else NOWHERE
        whole = Request(seen.lidar, seen.stamp, seen.frame, places, velocity=velocity)
        # on an inexact map, and where it lacks something, a fit alone has too often taken a wrong heading
        fits = known.there >= FITS
        if due or not (predicts and sure and fits):
            return whole
        if not np.isfinite(tracks.nis[best]):  # the list does not have the pose
            return whole
        x, y, theta = tracks.x[best].tolist()
        return replace(
            whole, local=True, pose=(x, y, theta), covariance=tracks.C[best], least=known.there - FALL
        )


def _places(tracks: Tracks, frame: int) -> Array:
    """Poses (n, 3) of the heaviest tracks in a map frame."""
    likely = np.flatnonzero((tracks.frame == frame) & (tracks.log_weight > np.log(POSSIBLE)))
    heaviest: Array = tracks.x[likely[np.argsort(-tracks.log_weight[likely], kind="stable")][:PLACES]]
    return heaviest


def is_whole(seen: Observation) -> bool:
    """Whether a list is one of the whole map."""
    return seen.usable and not seen.local
