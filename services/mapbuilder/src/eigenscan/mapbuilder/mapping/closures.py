"""Loop closures: places where the robot returns to an earlier stretch of its way.

Each new submap is correlated with earlier ones near it. The drift since the last closure bounds the search. A
match counts if the walls of both agree, neither shows a wall in the other's free space, and no other pose
fits nearly as well. The pose graph rejects the remaining wrong ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from eigenscan.geometry.pose import Array, between, compose, transform
from eigenscan.mapbuilder.mapping.alignment import align
from eigenscan.mapbuilder.mapping.chain import Keyframe
from eigenscan.mapbuilder.mapping.correlation import apart, correlate
from eigenscan.mapbuilder.mapping.pose_graph import Edge, optimise
from eigenscan.mapbuilder.mapping.submap import Submap, compare

RIGID = np.diag([0.1, 0.1, np.deg2rad(1.0)]) ** 2
"""Covariance of a closure: a submap is not quite rigid."""

_AGAIN = 2.0, 0.2
"""m and rad that submaps may still be off when closures are looked for again."""


@dataclass(frozen=True)
class Closing:
    """When two submaps are one place. Lengths in m, angles in rad."""

    reach: float = 8.0
    """Submaps with middles farther apart than this, m, and the drift, are not compared."""
    drift: float = 0.05
    """Error of the estimate as a share of the way since the last closure."""
    turn_drift: float = float(np.deg2rad(1.0))
    """The same of the heading, for each m of way."""
    visits: int = 4
    """Earlier passes that a submap is compared with."""
    adjacent: int = 3
    """Submaps this close in order are held by the chain itself."""
    overlap: float = 0.3
    """Share of the smaller submap's points that must agree."""
    score: float = 0.7
    """Least score of `compare`."""
    ambiguous: float = 0.85
    """Share of the best match's score from which another match makes it ambiguous."""


@dataclass(frozen=True)
class Match:
    """`pose` (3,) of one submap seen from another; `net`: points that agree less twice those against it."""

    pose: Array
    net: float


@dataclass
class Closer:
    """Places submaps, one after another, in a frame for each part."""

    keyframes: Sequence[Keyframe]
    rules: Closing = field(default_factory=Closing)
    submaps: list[Submap] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)
    poses: Array = field(default_factory=lambda: np.zeros((0, 3)))
    part: list[int] = field(default_factory=list)
    """Part of each submap."""
    _since: float = 0.0

    def add(self, submap: Submap) -> None:
        """Places the next submap and looks for closures with the earlier ones."""
        number = len(self.submaps)
        self.submaps.append(submap)
        before = self.keyframes[self.submaps[-2].anchor] if number else None
        here = self.keyframes[submap.anchor]
        if before is not None and before.part == here.part:
            step = between(before.pose, here.pose)
            way = self._way(self.submaps[-2].anchor, submap.anchor)
            self.edges.append(Edge(number - 1, number, step, _drift(way), trusted=True))
            self.poses = np.vstack([self.poses, compose(self.poses[-1], step)])
            self.part.append(self.part[-1])
            self._since += way
        else:
            self.poses = np.vstack([self.poses, np.zeros((1, 3))])
            self.part.append(here.part)
            self._since = 0.0
        self._close(number)

    def _way(self, first: int, last: int) -> float:
        places = np.array([self.keyframes[k].pose[:2] for k in range(first, last + 1)])
        return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())

    def _close(self, number: int) -> None:
        rules, found = self.rules, False
        window = (min(1.0 + rules.drift * self._since, 10.0), min(0.2 + rules.turn_drift * self._since, 1.2))
        for other in self._candidates(number, window[0]):
            found = self._join(other, number, np.asarray(window)) or found
        if found:
            self.solve()
            self._since = 0.0

    def _join(self, other: int, number: int, window: Array) -> bool:
        """Adds the edge between two submaps if they match within `window` of their estimated poses."""
        expected = between(self.poses[other], self.poses[number])
        match = self.match(other, number, expected, window)
        if match is not None:
            self.edges.append(Edge(other, number, match.pose, RIGID))
        return match is not None

    def solve(self) -> None:
        """Optimises the poses of all submaps."""
        self.poses, _ = optimise(self.poses, self.edges)

    def _candidates(self, number: int, slack: float) -> list[int]:
        """The nearest submap of each earlier pass of the same part, nearest first."""
        last = number - self.rules.adjacent
        middles = self._middles()
        away = np.hypot(*(middles - middles[number]).T)[: max(last + 1, 0)]
        same = np.array(self.part[: len(away)]) == self.part[number]
        near = np.where(same, away, np.inf)
        padded = np.pad(near, 1, constant_values=np.inf)
        nearest = (near <= padded[:-2]) & (near < padded[2:]) & (near < self.rules.reach + slack)
        where = np.nonzero(nearest)[0]
        return [int(k) for k in where[np.argsort(near[where], kind="stable")[: self.rules.visits]]]

    def _middles(self) -> Array:
        return np.array([transform(p, s.middle) for p, s in zip(self.poses, self.submaps, strict=True)])

    def match(
        self, one: int, other: int, expected: Array, window: Array, strict: float = 1.0
    ) -> Match | None:
        """Pose of submap `other` seen from `one`, if it is sure, within `window` of `expected`.

        `window` (2,), m and rad; `strict`: factor on the required overlap.
        """
        first, second = self.submaps[one], self.submaps[other]
        poses = correlate(first.ground, second.cloud, expected, window, 0.2 * strict)[0][:5]
        if not len(poses):
            return None
        aligned = [align(first.cloud, second.cloud, pose).pose for pose in poses]
        fits = [compare(first, second, pose) for pose in aligned]
        nets = np.array([fit.agree - 2 * fit.contradict for fit in fits], dtype=np.float64)
        best = int(np.argmax(nets))
        fit, pose = fits[best], aligned[best]
        elsewhere = nets[apart(np.array(aligned), pose)]
        if fit.overlap < self.rules.overlap * strict or fit.score < self.rules.score:
            return None
        if elsewhere.max(initial=0.0) > self.rules.ambiguous * nets[best]:
            return None
        return Match(pose, float(nets[best]))

    def again(self) -> None:
        """Searches closures again with the optimised poses."""
        known = {(edge.first, edge.second) for edge in self.edges}
        found = False
        for number in range(len(self.submaps)):
            for other in self._candidates(number, _AGAIN[0]):
                if (other, number) not in known:
                    found = self._join(other, number, np.asarray(_AGAIN)) or found
        if found:
            self.solve()


def _drift(way: float) -> Array:
    """Covariance (3, 3) of a step of the chain between two submaps."""
    along = 0.03 + 0.02 * way
    return np.diag([along, along, np.deg2rad(1.0 + 0.3 * way)]) ** 2
