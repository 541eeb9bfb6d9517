"""Which move distinguishes places that fit alike: the shortest after which a scan should decide between them.

Follows from a robot's tracks and lidars; nothing is calculated while it knows where it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from heapq import nlargest
from operator import attrgetter

import numpy as np
from eigenscan.geometry.circle import TURN, wrap
from eigenscan.geometry.pose import FARTHEST_M, compose, from_message
from eigenscan.projector.distinction import Lidar, expected_share, fitted_odds, odds, rays_of, walls_of
from eigenscan.projector.ground import Ground, Move
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site
from eigenscan.schemas.advice_pb2 import Advice
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.recently_used import RecentlyUsed
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, Tracks
from numpy.typing import NDArray

Array = NDArray[np.float64]
MoveTo = Callable[[int], Move]
"""Of several moves the one with this number."""

MOST_TRACKS = 256
"""The most probable ones, in which places are looked for; a tracker keeps fewer."""
APART_NS = 900_000_000
"""Between two pieces of advice at least: one a second, and stamps jitter."""
LEAST_SHARE = 0.03
"""Of a place that counts, among those of the tracks."""
MOST_PLACES = 6
"""The most probable ones; with each more the ground that is free from all gets less."""
SAME_M, SAME_RAD = 0.5, np.deg2rad(10.0)
"""Tracks nearer to each other are one place."""
SEEN_NS = 1_000_000_000
"""Age of a lidar's last scan from which it is not reckoned with any more."""
MOST_LIDARS = 4
"""Of a robot that are reckoned with: a sender may invent names."""

NEW_M, NEW_RAD = 0.5, 0.5
"""A shorter way or turn shows what has been seen: scans from one place are no further evidence."""
STRIDE = 2
"""Cells of the ground, from one end of a way that is looked at to the next."""
MOST_ENDS = 240
"""Ends of ways that are looked at."""
BATCH = 24
"""Looked at together: the search ends with the first batch that has what is sought."""
TURNS = 24
"""Headings to which a lidar that does not see all around may turn."""
ENOUGH = 0.05
"""Of the doubt between the places, what a move that distinguishes them leaves."""
SOME = 0.8
"""The same of a move that is worth its way where none distinguishes all."""
WORTH_M = 1.0
"""m that half the gain of a move is worth, next to itself."""
MOST_FITTED = 12
"""Moves whose scans are fitted, before another is looked for no more."""


@dataclass(frozen=True)
class Places:
    """Where a robot may be: base poses (k, 3), map frame, most probable first; shares (k,) and tracks."""

    poses: Array
    shares: Array
    tracks: tuple[int, ...]

    @classmethod
    def of(cls, message: Tracks) -> Places:
        """The places of tracks; those near each other are one."""
        found: list[tuple[Array, float, int]] = []
        likely = [track for track in message.tracks if 0.0 < track.probability <= 1.0]
        for track in nlargest(MOST_TRACKS, likely, key=attrgetter("probability")):
            pose = from_message(track.pose)
            if not (np.abs(pose) < FARTHEST_M).all():
                continue
            for i, (known, share, id_) in enumerate(found):
                x, y, turn = pose - known
                if x * x + y * y < SAME_M**2 and abs(wrap(turn)) < SAME_RAD:
                    found[i] = known, share + track.probability, id_
                    break
            else:
                found.append((pose, track.probability, track.id))
        found.sort(key=lambda place: -place[1])
        whole = sum(share for _, share, _ in found)
        kept = [one for one in found[:MOST_PLACES] if one[1] >= LEAST_SHARE * whole]
        shares = np.array([share for _, share, _ in kept])
        return cls(
            np.array([pose for pose, _, _ in kept]).reshape(-1, 3),
            shares / max(float(shares.sum()), 1e-9),
            tuple(id_ for _, _, id_ in kept),
        )

    @property
    def now(self) -> float:
        """Expected share of the true place before any move."""
        return float((self.shares**2).sum())


@dataclass(frozen=True)
class Found:
    """A move and what is foreseen of it: the expected share of the true place, and the evidence, nats."""

    move: Move
    probability: float
    evidence: float


def best_move(
    site: Site, lidars: Sequence[Lidar], places: Places, radius: float, reach: float
) -> Found | None:
    """The least move that distinguishes the places; where none does, the one that is most worth its way.

    None where no way up to `reach`, m, for a robot of this `radius`, m, is worth it.
    """
    ground = Ground.around(places.poses, walls_of(site), rays_of(site), radius, reach)
    search = _Search(site, places)
    narrow = [lidar for lidar in lidars if not lidar.sees_around]
    if narrow:
        turns = np.zeros((TURNS - 1, 3))
        steps = np.arange(1, TURNS)
        turns[:, 2] = np.where(steps % 2, 1, -1) * ((steps + 1) // 2) * (TURN / TURNS)  # the least first
        turns = turns[np.abs(turns[:, 2]) >= NEW_RAD]
        stays = np.zeros(len(turns))
        found = search.first(narrow, turns, lambda i: Move(float(wrap(turns[i, 2])), 0.0, 0.0), stays)
        if found is not None:
            return found
    cells, arrivals = ground.ends(NEW_M, STRIDE)
    every = -(-len(cells) // MOST_ENDS) if len(cells) else 1
    cells, arrivals = cells[::every], arrivals[::every]
    ways = ground.length.ravel()[cells]
    found = search.first(lidars, arrivals, lambda i: ground.move(int(cells[i])), ways)
    return found or search.worth()


@dataclass(frozen=True)
class _End:
    """Where a move ends, in the robot's frame, and which lidars show something new there."""

    lidars: Sequence[Lidar]
    arrival: Array
    move: MoveTo
    number: int


class _Search:
    """Looks at moves in order, and remembers the one most worth its way."""

    def __init__(self, site: Site, places: Places) -> None:
        self._site, self._places = site, places
        self._doubt = 1.0 - places.now
        self._fitted = 0
        self._others: list[tuple[float, _End]] = []

    def first(self, lidars: Sequence[Lidar], arrivals: Array, move: MoveTo, ways: Array) -> Found | None:
        """The first of the moves to `arrivals` (m, 3), in the robot's frame, that leaves so little doubt."""
        for begin in range(0, len(arrivals), BATCH):
            part = arrivals[begin : begin + BATCH]
            moved = compose(self._places.poses[None], part[:, None])
            left = 1.0 - expected_share(self._places.shares, odds(self._site, lidars, moved))
            for i, doubt in enumerate(left.tolist()):
                if doubt > SOME * self._doubt:
                    continue
                at = begin + i
                worth = (1.0 - doubt / self._doubt) / (WORTH_M + float(ways[at]))
                end = _End(lidars, part[i], move, at)
                self._others.append((worth, end))
                if doubt <= ENOUGH * self._doubt and self._fitted < MOST_FITTED:
                    found = self._fit(end, ENOUGH)
                    if found is not None:
                        return found
        return None

    def worth(self) -> Found | None:
        """The move most worth its way of those that were looked at."""
        self._others.sort(key=lambda one: -one[0])
        for _, end in self._others[:MOST_FITTED]:
            found = self._fit(end, SOME)
            if found is not None:
                return found
        return None

    def _fit(self, end: _End, most: float) -> Found | None:
        self._fitted += 1
        places = self._places
        ratios = fitted_odds(self._site, end.lidars, compose(places.poses, end.arrival))
        share = float(expected_share(places.shares, ratios[None])[0])
        if 1.0 - share > most * self._doubt:
            return None
        pairs = np.outer(places.shares, places.shares)
        np.fill_diagonal(pairs, 0.0)
        evidence = float((pairs * ratios).sum() / pairs.sum())
        return Found(end.move(end.number), share, evidence)


@dataclass
class _Robot:
    """Its lidars with their last stamps, and when it was advised."""

    lidars: dict[str, tuple[int, Lidar]] = field(default_factory=dict)
    advised: int | None = None


class Advisor:
    """Advises robots whose pose is ambiguous, once a second by their stamps."""

    def __init__(self, settings: ProjectorSettings) -> None:
        # of the parts of a site one is enough: each knows the whole map
        self.advises = settings.advice and settings.share[0] == 1
        self._radius, self._reach = settings.robot_radius, settings.advice_reach
        self._robots: RecentlyUsed[str, _Robot] = RecentlyUsed()

    def see(self, address: Mapping[str, str], stamp: int, lidar: Lidar) -> None:
        """A robot's lidar, by a scan of it."""
        if not self.advises:
            return
        lidars = self._robots.use(address["robot"], _Robot).lidars
        if address["lidar"] not in lidars and len(lidars) >= MOST_LIDARS:  # those that are gone make room
            for name in [one for one, (last, _) in lidars.items() if abs(stamp - last) >= SEEN_NS]:
                del lidars[name]
        if address["lidar"] in lidars or len(lidars) < MOST_LIDARS:
            lidars[address["lidar"]] = stamp, lidar

    def receive(self, name: str, tracks: Tracks, site: Site | None) -> Advice | None:
        """The advice that follows from a robot's tracks."""
        if not self.advises or site is None:
            return None
        if tracks.state != STATE_AMBIGUOUS or tracks.frame_id != site.frame_id:
            return None
        robot, at = self._robots.use(name, _Robot), nanoseconds(tracks.timestamp)
        if robot.advised is not None and 0 <= at - robot.advised < APART_NS:
            return None
        lidars = [lidar for last, lidar in robot.lidars.values() if abs(at - last) < SEEN_NS]
        places = Places.of(tracks)
        if len(places.tracks) < 2 or not lidars:
            return None
        robot.advised = at
        found = best_move(site, lidars, places, self._radius, self._reach)
        message = Advice(
            timestamp=tracks.timestamp,
            frame_id=site.frame_id,
            kind=Advice.KIND_NOTHING,
            track_ids=places.tracks,
            probability=places.now,
            probability_now=places.now,
            reach=self._reach,
        )
        if found is not None:
            message.kind = Advice.KIND_MOVE
            message.heading, message.distance = found.move.heading, found.move.distance
            message.way, message.probability = found.move.way, found.probability
            message.evidence = found.evidence
        return message
