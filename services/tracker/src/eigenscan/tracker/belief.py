"""The belief: tracks (paper, section 7) beside an explicit mass for "none of these".

A belief is a mixture: Gaussian tracks, a uniform part over each map frame for poses that no track
holds, and one part for places that no map shows. All masses sum to 1.

Scans from one place err alike, so their evidence is averaged there instead of multiplied: each track
remembers, per source, the evidence of the scans of its present place (`evidence`). As the robot moves on,
this is banked, and the evidence of the next place is added to it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import exp, expm1, log, log1p

import numpy as np
from eigenscan.tracker.association import associate, gate
from eigenscan.tracker.branching import at_least, births, branch
from eigenscan.tracker.covariance import log_volume
from eigenscan.tracker.evidence import (
    SHOWN_YET_MISSED,
    SHOWS,
    Merit,
    aliases_of,
    share_aliases,
    slipped,
)
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.prediction import predict
from eigenscan.tracker.reckoning import Leg, Motions, correct
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.share import Share
from eigenscan.tracker.tracks import Tracks, begin, join, no_tracks, replace
from numpy.typing import NDArray

Array = NDArray[np.float64]

OFF_MAP_SHARE = 0.02
"""Of the robots that no track holds, how many are where no map shows the place."""
RETURN_RATE = 0.001
"""1/s, how soon a robot off the map comes back to it."""
MOST_DECAY = 5.0
"""However long the silence, a little of the mass stays where it was."""
BREAK_SHARE = 0.5
"""Mass that leaves the tracks where odometry or the scans jump: a reset, a cover, or carried away."""
MISSES = 0.01
"""Of the poses that the map shows, how many one list leaves out and the next one from there may have.

Rounded from 0 to 1.3 in a hundred of eleven logs: benchmarks/evidence.py.
"""


@dataclass
class Elsewhere:
    """Mass that no track holds: uniform over a frame's free area, or off every map (`area` 0)."""

    log_weight: float
    area: float = 0.0
    searched: dict[int, float] = field(default_factory=dict)
    """Share of the mass that a list of each source has left out: it is hidden, or not there."""

    def log_density(self, source: int, share: Share) -> float:
        """Ln of the mass density that a list may find: what was not searched yet, or comes out of hiding."""
        findable = 1.0 - self.searched.get(source, 0.0) + self._emerging(source, share)
        return self.log_weight + float(np.log(findable / (self.area * 2.0 * np.pi)))

    def search(self, source: int, share: Share) -> None:
        """A list was of it: what is not in the list is hidden, and what came out of hiding is not there."""
        if share.in_part:
            return
        self.log_weight += log1p(expm1(SHOWN_YET_MISSED) * self._emerging(source, share))
        left = (1.0 - self.searched.get(source, 0.0)) * (1.0 - (1.0 - MISSES) * share.weight)
        self.searched[source] = 1.0 - left

    def take(self, mass: float) -> None:
        """Adds mass that no list was of yet."""
        if mass <= 0.0:
            return
        stayed = exp(self.log_weight)
        self.log_weight = log(stayed + mass)
        stayed /= stayed + mass
        self.searched = {source: searched * stayed for source, searched in self.searched.items()}

    def _emerging(self, source: int, share: Share) -> float:
        return self.searched.get(source, 0.0) * -expm1(-SHOWS * share.progress)


@dataclass
class Belief:
    """Where one robot may be. Frame 0 is "off every map"; others count from 1 in order of arrival."""

    settings: TrackerSettings
    tracks: Tracks = field(default_factory=lambda: no_tracks(0))
    elsewhere: list[Elsewhere] = field(default_factory=lambda: [Elsewhere(0.0)])
    frames: list[str] = field(default_factory=lambda: [""])
    sources: list[str] = field(default_factory=list)
    next_id: int = 1
    stamp: int | None = None

    def __post_init__(self) -> None:
        self.gate = gate(self.settings.gate_probability)

    @property
    def none_probability(self) -> float:
        """Mass for "none of the tracks"."""
        return float(np.exp([part.log_weight for part in self.elsewhere]).sum())

    def frame_index(self, frame: str, area: float) -> int:
        """Index of a map frame; a new one takes its share of the mass that no track holds."""
        if frame in self.frames:
            index = self.frames.index(frame)
            # a list may be of a part of the site
            self.elsewhere[index].area = max(area, self.elsewhere[index].area)
            return index
        known = sum(part.area for part in self.elsewhere)
        share = area / (known + area)
        # no list of this frame has come yet: against "off every map" it stands as at the start
        taken = self.elsewhere[0].log_weight + np.log((1.0 - OFF_MAP_SHARE) / OFF_MAP_SHARE * share)
        for part in self.elsewhere[1:]:
            part.log_weight += np.log1p(-share)
        if len(self.elsewhere) > 1:
            self.tracks = replace(self.tracks, log_weight=self.tracks.log_weight + np.log1p(-share))
        self.frames.append(frame)
        self.elsewhere.append(Elsewhere(float(taken), area))
        self.normalise()
        return len(self.frames) - 1

    def source_index(self, source: str) -> int:
        """Column of a source's evidence."""
        if source not in self.sources:
            self.sources.append(source)
            widened = np.column_stack([self.tracks.evidence, np.zeros(len(self.tracks))])
            self.tracks = replace(self.tracks, evidence=widened)
        return self.sources.index(source)

    def forget_innovations(self) -> None:
        """A scan begins: none of the tracks has a hypothesis of it yet."""
        self.tracks = replace(self.tracks, nis=np.full(len(self.tracks), np.nan))

    def predict(self, moved: Motion) -> None:
        """Moves the tracks; a jump of odometry takes mass from them."""
        if len(self.tracks):
            x, C = predict(self.tracks.x, self.tracks.C, moved, self.settings)
            unchecked = self.tracks.unchecked + np.array([moved.way, moved.turn])
            self.tracks = replace(self.tracks, x=x, C=C, unchecked=unchecked)
        if moved.breaks > 0:
            self._release(np.full(len(self.tracks), 1.0 - (1.0 - BREAK_SHARE) ** min(moved.breaks, 5.0)))
        self._return(happened(RETURN_RATE * abs(moved.seconds)))

    def correct(self, way: Leg, now: int, motions: Motions) -> None:
        """Corrects the tracks by the scan motion since they were last fixed."""
        self.tracks = correct(self.tracks, way, now, motions, self.settings)

    def _release(self, share: Array) -> None:
        """Moves `share` (n,) of the tracks' mass to "none"."""
        if not len(self.tracks) or not share.any() or len(self.elsewhere) < 2:
            return
        freed = float(share @ np.exp(self.tracks.log_weight))
        area = sum(part.area for part in self.elsewhere)
        self.elsewhere[0].take(freed * OFF_MAP_SHARE)
        for part in self.elsewhere[1:]:
            part.take(freed * (1.0 - OFF_MAP_SHARE) * part.area / area)
        self.tracks = replace(self.tracks, log_weight=self.tracks.log_weight + np.log1p(-share))

    def _break_off(self, source: int) -> None:
        """The sensor was covered or uncovered, or the robot carried away: the tracks start a new place."""
        self._release(np.full(len(self.tracks), BREAK_SHARE))
        for part in self.elsewhere:
            part.searched.pop(source, None)
        evidence = self.tracks.evidence.copy()
        evidence[:, source] = 0.0
        count = len(self.tracks)
        self.tracks = replace(
            self.tracks, evidence=evidence, hidden=np.full(count, 0.5), alias=np.zeros(count)
        )

    def _return(self, share: float) -> None:
        """Moves `share` of the mass off the map back onto it."""
        off, inside = self.elsewhere[0], self.elsewhere[1:]
        if not inside or share <= 0.0:
            return
        back = share * exp(off.log_weight)
        total = sum(part.area for part in inside)
        for part in inside:
            part.take(back * part.area / total)
        off.log_weight += log1p(-share)

    def observe(self, seen: Observation, share: Share) -> None:
        """Weighs every part by what was seen, fuses tracks with hypotheses, and starts new tracks.

        Hypotheses that are no likelier than an unlisted pose add nothing and are left out.
        """
        seen = seen.likelier_than_unlisted()
        frame = self.frame_index(seen.frame, seen.area)
        source = self.source_index(seen.source)
        self._bank(source, share.progress)
        self._release(np.full(len(self.tracks), share.carried))
        if share.broken:
            self._break_off(source)
        old, others = self._by_frame(frame)
        merit = Merit.of(seen, share.even)
        pairs = associate(old.x, old.C, seen.poses, seen.covariances, self.gate)
        part = self.elsewhere[frame]
        carried = merit.alone + log_volume(seen.covariances) + part.log_density(source, share)
        alone = np.logaddexp(carried, slipped(old, seen, merit, pairs))
        first = merit.at_first(pairs, old.observations)
        grown = branch(old, seen, pairs, merit.of_pairs(pairs), first, source, share)
        evidence = np.zeros((len(alone), len(self.sources)))
        evidence[:, source] = merit.predicted
        alias = aliases_of(merit.predicted)
        grown = at_least(grown, len(old), pairs, alone, evidence, alias)
        k, log_weight = births(grown, seen, pairs, alone)
        new = begin(seen.poses[k], seen.covariances[k], log_weight, alias[k], evidence[k], frame, seen.stamp)
        self.tracks = share_aliases(join([*others, grown, new]))
        part.search(source, share)
        self.normalise()

    def _bank(self, source: int, progress: float) -> None:
        """As the robot moves on, what was seen at the last place speaks for a track for good."""
        evidence = self.tracks.evidence.copy()
        evidence[:, source] *= np.exp(-progress)
        self.tracks = replace(self.tracks, evidence=evidence)

    def _by_frame(self, frame: int) -> tuple[Tracks, list[Tracks]]:
        """The tracks of a frame, and those of others, mostly none."""
        mine = self.tracks.frame == frame
        return (self.tracks, []) if mine.all() else (self.tracks.pick(mine), [self.tracks.pick(~mine)])

    def name_new(self) -> None:
        """Gives numbers to the tracks that forks and births left without one."""
        unnamed = self.tracks.id == 0
        count = int(unnamed.sum())
        id_ = self.tracks.id.copy()
        id_[unnamed] = np.arange(self.next_id, self.next_id + count)
        self.next_id += count
        self.tracks = replace(self.tracks, id=id_)

    def normalise(self) -> None:
        """Makes all masses sum to 1."""
        rest = np.array([part.log_weight for part in self.elsewhere])
        total = np.logaddexp.reduce(np.concatenate([self.tracks.log_weight, rest]))
        if total == -np.inf:
            # the last track ended: nothing is left but that nothing is known
            self.elsewhere[-1].log_weight = 0.0
            return
        self.tracks = replace(self.tracks, log_weight=self.tracks.log_weight - total)
        for part in self.elsewhere:
            part.log_weight -= float(total)


def happened(expected: float) -> float:
    """Probability that what is expected so often has happened at least once; never quite sure."""
    return -expm1(-min(expected, MOST_DECAY))
