"""Which floor a pose is on, and the evidence of several map frames for one scan."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from eigenscan.eigenspace.floors import Floor, floor_of, usable_floors
from eigenscan.geometry.pose import to_message
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.tracker.belief import OFF_MAP_SHARE, Belief
from eigenscan.tracker.tracks import Tracks
from numpy.typing import NDArray

Array = NDArray[np.float64]

MISSED = 20
"""A map frame counts until so many lists of others came since its last one: 2 s of a lidar of 10 Hz."""
RIVAL = 0.2
"""Share of the belief from which a second map frame is a reason for having no claim."""
RIVALS_NS = 2_000_000_000
"""After so long health reports it, as it does a pose that does not come."""
MOST_OFF_MAP = 0.5
"""Of the robots, however open the map is: otherwise none could be on it."""
LIFT_RATE = 0.05
"""1/s, how often a robot that no lidar shows changes floors, where there are several: a ride takes 20 s."""


@dataclass(frozen=True)
class Building:
    """The floors of the model set in use, in its map frame, and how many robots are off the map.

    Beams that meet no wall leave the map where a robot may leave it, too. The square of their share is 1 % of
    ordinary maps and 10 to 20 % of half maps (chosen on aces, intel and fr079: benchmarks/maps.py).
    """

    frame: str = ""
    floors: tuple[Floor, ...] = ()
    off_map_share: float = OFF_MAP_SHARE

    @classmethod
    def of(cls, message: ModelSet, counts: Counter[str]) -> Building:
        """The building of a set; what is no floor is left out and counted."""
        floors = usable_floors(message)
        if unusable := len(message.floors) - len(floors):
            counts["floor_not_usable"] += unusable
        return cls(message.frame_id, floors, _off_map_share(message))

    def lift_rate(self, tracks: Tracks) -> float:
        """1/s, how often a robot goes to another floor: by the tracks' mass that no source shows."""
        if len(self.floors) < 2 or not tracks.hidden.size:
            return 0.0
        masses = np.exp(tracks.log_weight)
        unseen = float(masses @ tracks.hidden.min(axis=1))
        return LIFT_RATE * unseen / max(float(masses.sum()), 1e-300)

    def locate(self, message: PoseEstimate) -> None:
        """Adds the floor to a pose in the set's map frame, and the pose in that floor's own frame."""
        if not self.floors or not message.track_id or message.frame_id != self.frame:
            return
        pose = np.array([message.pose.x, message.pose.y, message.pose.theta])
        floor = floor_of(self.floors, pose)
        if floor is not None:
            message.floor = floor.name
            message.floor_pose.CopyFrom(to_message(floor.own(pose)))


def _off_map_share(message: ModelSet) -> float:
    stated = [entry for entry in message.entries if 0.0 < entry.walls_in_sight <= 1.0]
    of_all = sum(entry.size for entry in stated)
    if not of_all:
        return OFF_MAP_SHARE
    beyond = sum(entry.size * (1.0 - entry.walls_in_sight) for entry in stated) / of_all
    return min(max(beyond**2, OFF_MAP_SHARE), MOST_OFF_MAP)


@dataclass
class Rivals:
    """Map frames whose lists speak of the same robot, such as two projectors with a floor each.

    A list weighs the places of its own frame only, so whichever frame spoke last would be believed. A claim
    needs more: that its frame holds the belief after the last list of every other frame, too.
    """

    shares: dict[int, dict[int, float]] = field(default_factory=dict)
    """After the last list of each frame: what share of the frames' mass each of them had."""
    since: int | None = None
    """From when on no frame holds the belief after every list, ns."""
    _missed: Counter[int] = field(default_factory=Counter)
    _pair: tuple[str, str] = ("", "")

    def receive(self, belief: Belief, frame: int, stamp: int) -> None:
        """Takes the belief after a list of `frame`."""
        if len(belief.frames) == 2:  # there is no other
            self.shares[frame], self._missed[frame] = {frame: 1.0}, 0
            return
        masses = _frame_masses(belief)
        self.shares[frame] = dict(enumerate((masses / max(masses.sum(), 1e-300)).tolist()))
        self._missed.update(self.shares.keys())
        self._missed[frame] = 0
        for gone in [one for one, missed in self._missed.items() if missed >= MISSED]:
            del self.shares[gone], self._missed[gone]
        self._watch(belief, int(np.argmax(masses)), stamp)

    def share(self, frame: int) -> float:
        """Share of the belief that `frame` holds after every frame's last list, 0..1."""
        return min((shares.get(frame, 0.0) for shares in self.shares.values()), default=1.0)

    def reason(self, stamp: int | None) -> str:
        """Why two map frames keep a pose from being claimed; empty while they do not."""
        if self.since is None or stamp is None or stamp - self.since < RIVALS_NS:
            return ""
        one, other = self._pair
        return (
            f"map frames {one!r} and {other!r} both fit the scans: two projectors publish one place in two "
            "frames, or two floors look alike"
        )

    def _watch(self, belief: Belief, best: int, stamp: int) -> None:
        if self.share(best) >= 1.0 - RIVAL:
            self.since = None
            return
        if self.since is None or stamp < self.since:
            self.since = stamp
        most = Counter[int]()
        for shares in self.shares.values():
            most |= Counter({frame: round(1e6 * share) for frame, share in shares.items() if frame})
        names = [belief.frames[frame] for frame, _ in most.most_common(2)]
        if len(names) == 2:
            self._pair = min(names), max(names)


def _frame_masses(belief: Belief) -> Array:
    """Mass of each map frame, tracks and what no track holds, (frames,); off every map is no frame's."""
    masses = np.exp(belief.elsewhere.log_weight)
    masses[0] = 0.0
    np.add.at(masses, belief.tracks.frame, np.exp(belief.tracks.log_weight))
    return masses
