"""The belief: tracks (paper, section 7) beside an explicit mass for "none of these".

A belief is a mixture: Gaussian tracks, a uniform part over each map frame for poses that no track
holds, and one part for places that no map shows. All masses sum to 1.

Scans from one place err alike, so their evidence is averaged there instead of multiplied: each track
remembers, per source, the evidence of the scans of its present place (`evidence`). As the robot moves on,
this is banked, and the evidence of the next place is added to it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import expm1

import numpy as np
from eigenscan.tracker import branching, evidence, observation
from eigenscan.tracker.association import gate
from eigenscan.tracker.evidence import Constants
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.prediction import predict
from eigenscan.tracker.reckoning import Leg, Motions, correct
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.share import Share
from eigenscan.tracker.tracks import Tracks, arrays_of, no_tracks, replace, tracks_of
from eigenscan.tracker.weighing import jumped, normalise, observed, returned
from numpy.typing import NDArray

Array = NDArray[np.float64]

OFF_MAP_SHARE = 0.02
"""Of the robots that no track holds, how many are off every map at least; of an open map more: `Building`."""
RETURN_RATE = 0.01
"""1/s, how soon a robot off the map comes back to it. Of 20 stories of benchmarks/mechanisms.py, with 0.001
three of places alike and of a half map have fewer right claims."""
MOST_DECAY = 5.0
"""However long the silence, a little of the mass stays where it was."""
BREAK_SHARE = 0.5
"""Mass that leaves the tracks where odometry jumps: it was reset, or the robot was carried away."""
CARRIED_SHARE = 0.9
"""The same where the scans jump: no list has anything of the one before, and no scan follows from another.

At 79 of 94 kidnaps, and at none of 87,000 lists without one: else a cover, after which the place shows again
(benchmarks/mechanisms.py --without "kidnaps by broken lists").
"""
MISSES = 0.01
"""Of the poses that the map shows, how many one list leaves out and the next one from there may have.

Rounded from 0 to 1.3 in a hundred of eleven logs: benchmarks/evidence.py.
"""


@dataclass
class Elsewhere:
    """Mass that no track holds, as logarithms (f,), by map frame: uniform over its free `area` (f,), m^2.

    Frame 0 is off every map, its area 0. `searched` (f, sources): share of the mass that a list of each
    source has left out: it is hidden, or not there.
    """

    log_weight: Array
    area: Array
    searched: Array

    def parts(self) -> tuple[Array, Array, Array]:
        """The arrays, which compiled code changes in place."""
        return self.log_weight, self.area, self.searched

    def append(self, log_weight: float, area: float) -> None:
        """Adds a frame."""
        self.log_weight, self.area = np.append(self.log_weight, log_weight), np.append(self.area, area)
        self.searched = np.vstack([self.searched, np.zeros((1, self.searched.shape[1]))])


@dataclass
class Belief:
    """Where one robot may be. Frame 0 is "off every map"; others count from 1 in order of arrival."""

    settings: TrackerSettings
    tracks: Tracks = field(default_factory=lambda: no_tracks(0))
    elsewhere: Elsewhere = field(
        default_factory=lambda: Elsewhere(np.zeros(1), np.zeros(1), np.zeros((1, 0)))
    )
    frames: list[str] = field(default_factory=lambda: [""])
    sources: list[str] = field(default_factory=list)
    next_id: int = 1
    stamp: int | None = None
    off_map_share: float = OFF_MAP_SHARE
    """Of the robots that no track holds, how many are where no map shows the place."""

    def __post_init__(self) -> None:
        self.gate = gate(self.settings.gate_probability)

    @property
    def none_probability(self) -> float:
        """Mass for "none of the tracks"."""
        return float(np.exp(self.elsewhere.log_weight).sum())

    def frame_index(self, frame: str, area: float) -> int:
        """Index of a map frame; a new one takes its share of the mass that no track holds."""
        rest = self.elsewhere
        if frame in self.frames:
            index = self.frames.index(frame)
            # a list may be of a part of the site
            rest.area[index] = max(area, rest.area[index])
            return index
        share = area / (float(rest.area.sum()) + area)
        # no list of this frame has come yet: against "off every map" it stands as at the start
        own = rest.log_weight[0] + np.log((1.0 - self.off_map_share) / self.off_map_share * share)
        if len(self.frames) > 1:
            rest.log_weight[1:] += np.log1p(-share)
            self.tracks = replace(self.tracks, log_weight=self.tracks.log_weight + np.log1p(-share))
        self.frames.append(frame)
        rest.append(float(own), area)
        self.normalise()
        return len(self.frames) - 1

    def source_index(self, source: str, *, first: bool = False) -> int:
        """Column of a source's evidence. From another lidar's `first` list a right track may be hidden."""
        if source not in self.sources:
            none = np.zeros(len(self.tracks))
            hidden = evidence.HIDES / (evidence.HIDES + evidence.SHOWS) if first and self.sources else 0.0
            self.sources.append(source)
            self.tracks = replace(
                self.tracks,
                evidence=np.column_stack([self.tracks.evidence, none]),
                hidden=np.column_stack([self.tracks.hidden, none + hidden]),
            )
            searched = self.elsewhere.searched
            self.elsewhere.searched = np.column_stack([searched, np.zeros(len(searched))])
        return self.sources.index(source)

    def forget_innovations(self) -> None:
        """A scan begins: none of the tracks has a hypothesis of it yet."""
        self.tracks = replace(self.tracks, nis=np.full(len(self.tracks), np.nan))

    def predict(self, moved: Motion) -> None:
        """Moves the tracks; a jump of odometry takes mass from them."""
        if len(self.tracks):
            x, C = predict(self.tracks.x, self.tracks.C, moved, self.settings)
            unchecked = self.tracks.unchecked + np.array(2 * [moved.way, moved.turn])
            self.tracks = replace(self.tracks, x=x, C=C, unchecked=unchecked)
        if moved.breaks > 0:
            share = 1.0 - (1.0 - BREAK_SHARE) ** min(moved.breaks, 5.0)
            log_weight = jumped(self.tracks.log_weight, *self.elsewhere.parts(), share, self.off_map_share)
            self.tracks = replace(self.tracks, log_weight=log_weight)
        returned(*self.elsewhere.parts(), happened(RETURN_RATE * abs(moved.seconds)))

    def correct(self, way: Leg, now: int, motions: Motions) -> None:
        """Corrects the tracks by the scan motion since they were last fixed."""
        self.tracks = correct(self.tracks, way, now, motions, self.settings)

    def observe(self, seen: Observation, share: Share) -> None:
        """Weighs every part by what was seen, fuses tracks with hypotheses, and starts new tracks.

        Hypotheses that are no likelier than an unlisted pose add nothing and are left out.
        """
        frame = self.frame_index(seen.frame, seen.area)
        source = self.source_index(seen.source, first=share.first)
        made = observed(
            arrays_of(self.tracks), *self.elsewhere.parts(), seen.poses, seen.covariances,
            seen.log_likelihoods, seen.unlisted, frame, source, seen.stamp, self.gate, share.weight,
            share.progress, share.precision, share.carried, share.broken, share.in_part, share.first,
            _constants(self.off_map_share, missed(seen)),
        )  # fmt: skip
        self.tracks = tracks_of(made)

    def normalise(self) -> None:
        """Makes all masses sum to 1."""
        log_weight = self.tracks.log_weight.copy()
        normalise(log_weight, self.elsewhere.log_weight)
        self.tracks = replace(self.tracks, log_weight=log_weight)


def happened(expected: float) -> float:
    """Probability that what is expected so often has happened at least once; never quite sure."""
    return -expm1(-min(expected, MOST_DECAY))


def emerges(off_map_share: float) -> float:
    """Of the poses that a list left out, how many the next one has: on an open map hardly more than SHOWS.

    Where the map lacks much of the building, no list has the robot for long: 0.06 on the half map of aces
    with 30 % of its walls missing (benchmarks/evidence.py). How it falls from one to the other is a guess.
    """
    mapped = min(OFF_MAP_SHARE / off_map_share, 1.0)
    return evidence.SHOWS + (evidence.EMERGES - evidence.SHOWS) * mapped


def missed(seen: Observation) -> float:
    """What a list without a hypothesis for it speaks for a track, were it shown; nats, below 0.

    Of a list that is cut a place may be missing that is as likely as the last one there. Of many rooms alike
    30 leave the right one out in one scan of four, 100 in one of ten.
    """
    found = seen.likelier_than_unlisted().log_likelihoods if seen.cut else np.empty(0)
    if not len(found):
        return evidence.SHOWN_YET_MISSED
    return max(evidence.SHOWN_YET_MISSED, evidence.BEHIND * float(found.min() - found.max()))


def _constants(off_map_share: float, missed: float) -> Constants:
    """As they are now: a benchmark may have changed one."""
    return Constants(
        evidence.LEAD,
        evidence.BEHIND,
        evidence.MOST,
        missed,
        evidence.HIDES,
        evidence.SHOWS,
        emerges(off_map_share),
        evidence.ALIASES,
        evidence.ENDS,
        evidence.SLIPS,
        observation.POORER,
        branching.LEAST_NEW,
        branching.KEPT,
        MISSES,
        off_map_share,
        CARRIED_SHARE,
        evidence.ALIKE_M,
        evidence.TOGETHER,
    )
