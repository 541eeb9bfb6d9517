"""A few scans at unknown poses, in no order, become one frame and one map (paper, section 3, figure 2)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.geometry.pose import Array, between, compose, inverse, transform
from eigenscan.mapbuilder.mapping.alignment import FINE, align
from eigenscan.mapbuilder.mapping.bridges import ANYWHERE, OUTVOTE, STRICT
from eigenscan.mapbuilder.mapping.chain import Keyframe, Sweep
from eigenscan.mapbuilder.mapping.closures import Closer, Closing, Match
from eigenscan.mapbuilder.mapping.cloud import Cloud
from eigenscan.mapbuilder.mapping.correlation import apart
from eigenscan.mapbuilder.mapping.submap import Agreement, Submap, compare
from eigenscan.mapbuilder.mapping.survey import Mapped, MappingError, Progress, check_extent
from skimage.draw import polygon

_LONGEST_GAP = np.deg2rad(3.0)
"""Between two beams of which something is known of the space between them."""
_LEAST_POINTS = 20
"""A scan with fewer joins none."""
_SURE = 200.0
"""Net of a match that needs no second one: some 10 m of walls that both scans saw."""


_SOUND = 0.8
"""Least score of `compare` over all scans, if one match is to join two parts."""


@dataclass
class _Parts:
    """Scans joined so far: number of each one's part, and its pose (3,) in it. Surest matches first."""

    submaps: Sequence[Submap]
    matches: Sequence[tuple[int, int, Match]]
    poses: Array = field(init=False)
    part: list[int] = field(init=False)
    _refused: set[tuple[int, int]] = field(init=False)
    """Parts, as they are now, that do not join."""

    def join(self) -> list[int]:
        """Joins parts, those of the surest matches first; returns the scans of the largest.

        Where all matches agree, and more of them than needed, one joins two parts. One corner looks like
        another: where some disagree, two scans of each part must vote for the pose, if there are two.
        """
        for confirmed in (False, True):
            self.poses, self.part = np.zeros((len(self.submaps), 3)), list(range(len(self.submaps)))
            self._refused = set()
            while any(self._joined(one, other, confirmed) for one, other, _ in self.matches):
                pass
            if len(self.matches) >= len(self.submaps) and self._agrees():
                break
        return self._scans(max(self.part, key=self.part.count))

    def _scans(self, part: int) -> list[int]:
        return [k for k, its in enumerate(self.part) if its == part]

    def _agrees(self) -> bool:
        """Whether each match is as the scans lie, and no wall stands where another scan saw through."""
        joined = self._scans(max(self.part, key=self.part.count))
        return not self.opposed() and self._score(combinations(joined, 2), self.poses) >= _SOUND

    def opposed(self) -> int:
        """How many matches are not as the scans lie, or of scans of two parts."""
        return sum(
            self.part[one] != self.part[other]
            or bool(apart(between(self.poses[one], self.poses[other])[None], match.pose)[0])
            for one, other, match in self.matches
        )

    def _joined(self, one: int, other: int, confirmed: bool) -> bool:
        """Whether the parts of two scans could be joined, and now are: matches vote, as for a bridge."""
        here, there = self.part[one], self.part[other]
        if here == there or (here, there) in self._refused:
            return False
        self._refused.add((here, there))
        votes = [
            (a, b, match.pose, match.net) if self.part[a] == here else (b, a, inverse(match.pose), match.net)
            for a, b, match in self.matches
            if {self.part[a], self.part[b]} == {here, there}
        ]
        moves = np.array([compose(compose(self.poses[a], m), inverse(self.poses[b])) for a, b, m, _ in votes])
        nets = np.array([net for *_, net in votes])
        same = np.array([~apart(moves, move) for move in moves])
        chosen = same[int(np.argmax(same @ nets))]
        if nets[chosen].sum() < OUTVOTE * nets[~chosen].sum():
            return False
        if confirmed and nets[chosen].max() < _SURE:
            for part, side in ((here, 0), (there, 1)):
                voters = {vote[side] for vote, mine in zip(votes, chosen, strict=True) if mine}
                if len(voters) < min(2, self.part.count(part)):
                    return False
        moved = self._scans(there)
        poses = self.poses.copy()
        poses[moved] = compose(moves[chosen][0], self.poses[moved])
        if self._score(product(self._scans(here), moved), poses) < Closing.score:
            return False
        self.poses = poses
        self.part = [here if its == there else its for its in self.part]
        self._refused = {pair for pair in self._refused if not {here, there} & set(pair)}
        return True

    def _score(self, pairs: Iterable[tuple[int, int]], poses: Array) -> float:
        """Score of `compare` over these pairs of scans, all at `poses` (N, 3)."""
        fits = [compare(self.submaps[k], self.submaps[n], between(poses[k], poses[n])) for k, n in pairs]
        return Agreement(sum(fit.agree for fit in fits), sum(fit.contradict for fit in fits), 0).score


def composite(
    sweeps: Sequence[Sweep],
    resolution: float = 0.05,
    progress: Progress = lambda _step, _share: None,
) -> Mapped:
    """Map of scans without poses, `resolution` in m per cell, in the frame of the first one in it.

    Every pair is matched without a prior, like submaps of two parts. Of more than two scans, a third has to
    confirm how two fit. Raises MappingError if too few join.
    """
    numbers = [k for k, sweep in enumerate(sweeps) if len(sweep.outline.ranges) >= _LEAST_POINTS]
    frames = [
        Keyframe(k, k, np.zeros(3), Cloud.of(sweeps[k].outline, sweeps[k].mount), None) for k in numbers
    ]
    closer = Closer(frames)
    closer.submaps = [Submap.of(frames, sweeps, range(n, n + 1), range(n, n + 1)) for n in range(len(frames))]
    pairs: list[tuple[int, int, Match]] = []
    for one in range(len(frames)):
        for other in range(one + 1, len(frames)):
            match = closer.match(one, other, np.zeros(3), ANYWHERE, STRICT)
            if match is not None:
                pose = align(frames[one].cloud, frames[other].cloud, match.pose, reaches=FINE).pose
                pairs.append((one, other, Match(pose, match.net)))
        progress("joining scans", (one + 1) / len(frames))
    pairs.sort(key=lambda pair: -pair[2].net)
    parts = _Parts(closer.submaps, pairs)
    joined = parts.join() if frames else []
    if len(joined) < max(1, min(len(sweeps), 3)):
        few = "three" if len(sweeps) > 2 else "two"
        raise MappingError(
            f"no {few} of {len(sweeps)} scans fit in one way only: they need to overlap, and more of them may"
        )
    poses = between(parts.poses[joined[0]], parts.poses[joined])
    opposed = parts.opposed()
    placed = np.array([numbers[k] for k in joined], dtype=np.int64)
    return Mapped(
        _drawn([sweeps[k] for k in placed], poses, resolution),
        placed,
        poses,
        unjoined=tuple((k, k) for k in numbers if k not in placed),
        left_out=len(sweeps) - len(numbers),
        jumps=0,
        keyframes=len(joined),
        closures=len(pairs) - opposed,
        rejected=opposed,
    )


def _drawn(sweeps: Sequence[Sweep], poses: Array, resolution: float) -> GridMap:
    """Free cells between and along beams; occupied cells at their ends."""
    sensors = [compose(pose, sweep.mount) for sweep, pose in zip(sweeps, poses, strict=True)]
    points = [transform(at, sweep.outline.points) for sweep, at in zip(sweeps, sensors, strict=True)]
    reach = np.vstack([*points, *(at[None, :2] for at in sensors)])
    check_extent(reach, resolution)
    low = np.floor(reach.min(axis=0) / resolution) - 2
    shape = (np.ceil(reach.max(axis=0) / resolution) - low + 3).astype(np.int64)[::-1]
    cells = np.full(shape, UNKNOWN, dtype=np.uint8)
    for sweep, at, ends in zip(sweeps, sensors, points, strict=True):
        breaks = np.nonzero(np.diff(sweep.outline.bearings) > _LONGEST_GAP)[0] + 1
        for part in np.split(ends, breaks):
            corners = np.vstack([at[None, :2], part]) / resolution - low
            rows, columns = polygon(corners[:, 1], corners[:, 0], cells.shape)
            cells[rows, columns] = FREE
    column, row = (np.floor(np.vstack(points) / resolution) - low).astype(np.int64).T
    cells[row, column] = OCCUPIED
    return GridMap(cells, resolution, np.array([*(low * resolution), 0.0]))
