"""The belief: tracks (paper, section 7) beside an explicit mass for "none of these".

A belief is a mixture: Gaussian tracks, a uniform part over each map frame for poses that no track
holds, and one part for places that no map shows. All masses sum to 1.

Scans from one place err alike, so their evidence is averaged there instead of multiplied: each part
remembers, per source, the mean log-likelihood of the recent scans (`evidence`). A new scan moves that
mean by a share `novelty`, and only motion makes it count once more (`progress`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from eigenscan.tracker.association import associate, crowding
from eigenscan.tracker.covariance import determinant, fuse
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.prediction import predict
from eigenscan.tracker.settings import TrackerSettings
from numpy.typing import NDArray
from scipy.stats import chi2

Array = NDArray[np.float64]
Index = NDArray[np.intp]

OFF_MAP_SHARE = 0.02
"""Of the robots that no track holds, how many are where no map shows the place."""
RETURN_RATE = 0.1
"""1/s, how soon a robot off the map comes back to it."""
LOG_COINCIDENCE = float(np.log(0.2))
"""How often a wrong hypothesis lies in the gate of a right track whose own pose the list lacks."""
MOST_DECAY = 5.0
"""However long the silence, a little of the mass stays where it was."""
BREAK_SHARE = 0.5
"""Mass that leaves the tracks at a jump of odometry: a reset of the wheels, or carried away."""


@dataclass(frozen=True)
class Share:
    """How far one scan counts, each 0..1.

    `novelty`: its share in its source's mean evidence. `progress`: how much it counts anew because the
    robot moved on. `precision`: how much of its covariance's information is independent of earlier scans.
    """

    novelty: float
    progress: float
    precision: float

    @property
    def weight(self) -> float:
        """Exponent of the likelihood."""
        return self.novelty + self.progress


@dataclass(frozen=True)
class Tracks:
    """n Gaussian tracks. `evidence` (n, sources): mean log-likelihood of each source's recent scans."""

    x: Array
    C: Array
    log_weight: Array
    evidence: Array
    frame: Index
    id: Index
    parent: Index
    born: Index
    observations: Index

    def __len__(self) -> int:
        return len(self.x)

    def pick(self, index: Index | NDArray[np.bool_]) -> Tracks:
        """The tracks at `index`."""
        return Tracks(**{name: getattr(self, name)[index] for name in self.__dataclass_fields__})


def join(parts: list[Tracks]) -> Tracks:
    """All tracks of several sets, in order."""
    return Tracks(
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in Tracks.__dataclass_fields__
        }
    )


def no_tracks(sources: int) -> Tracks:
    """An empty set."""
    none = np.zeros(0, dtype=np.intp)
    return Tracks(
        np.zeros((0, 3)),
        np.zeros((0, 3, 3)),
        np.zeros(0),
        np.zeros((0, sources)),
        none,
        none,
        none,
        none,
        none,
    )


@dataclass
class Elsewhere:
    """Mass that no track holds: uniform over a frame's free area, or off every map (`area` 0)."""

    log_weight: float
    evidence: Array
    area: float = 0.0


@dataclass
class Belief:
    """Where one robot may be. Frame 0 is "off every map"; others count from 1 in order of hearing."""

    settings: TrackerSettings
    tracks: Tracks = field(default_factory=lambda: no_tracks(0))
    elsewhere: list[Elsewhere] = field(default_factory=lambda: [Elsewhere(0.0, np.zeros(0))])
    frames: list[str] = field(default_factory=lambda: [""])
    sources: list[str] = field(default_factory=list)
    next_id: int = 1
    stamp: int | None = None

    def __post_init__(self) -> None:
        self.gate = float(chi2.ppf(self.settings.gate_probability, 3))

    @property
    def none_probability(self) -> float:
        """Mass for "none of the tracks"."""
        return float(np.exp([part.log_weight for part in self.elsewhere]).sum())

    def frame_index(self, frame: str, area: float) -> int:
        """Index of a map frame; a new one takes its share of the mass that no track holds."""
        if frame in self.frames:
            index = self.frames.index(frame)
            self.elsewhere[index].area = area
            return index
        known = sum(part.area for part in self.elsewhere)
        share = area / (known + area)
        # nothing was heard of this frame yet: to "off every map" it is as it was at the start
        taken = self.elsewhere[0].log_weight + np.log((1.0 - OFF_MAP_SHARE) / OFF_MAP_SHARE * share)
        for part in self.elsewhere[1:]:
            part.log_weight += np.log1p(-share)
        if len(self.elsewhere) > 1:
            self.tracks = replace(self.tracks, log_weight=self.tracks.log_weight + np.log1p(-share))
        self.frames.append(frame)
        self.elsewhere.append(Elsewhere(float(taken), self.elsewhere[0].evidence.copy(), area))
        self.normalise()
        return len(self.frames) - 1

    def source_index(self, source: str) -> int:
        """Column of a source's evidence."""
        if source not in self.sources:
            self.sources.append(source)
            for part in self.elsewhere:
                part.evidence = np.append(part.evidence, 0.0)
            widened = np.column_stack([self.tracks.evidence, np.zeros(len(self.tracks))])
            self.tracks = replace(self.tracks, evidence=widened)
        return self.sources.index(source)

    def predict(self, moved: Motion) -> None:
        """Moves the tracks, and a little of their mass to "none of these"."""
        if len(self.tracks):
            x, C = predict(self.tracks.x, self.tracks.C, moved, self.settings)
            self.tracks = replace(self.tracks, x=x, C=C)
        lost = -np.expm1(-min(self.settings.kidnap_rate * abs(moved.seconds), MOST_DECAY))
        if moved.breaks > 0:
            lost = max(lost, 1.0 - (1.0 - BREAK_SHARE) ** min(moved.breaks, 5.0))
        self._release(float(lost))
        self._return(float(-np.expm1(-min(RETURN_RATE * abs(moved.seconds), MOST_DECAY))))

    def _release(self, share: float) -> None:
        """Moves `share` of each track's mass to "none", with the evidence that it had until now."""
        if not len(self.tracks) or share <= 0.0 or len(self.elsewhere) < 2:
            return
        weight = np.exp(self.tracks.log_weight)
        freed = share * weight
        areas = np.array([part.area for part in self.elsewhere[1:]])
        shares = np.append(OFF_MAP_SHARE, (1.0 - OFF_MAP_SHARE) * areas / areas.sum())
        evidence = freed @ self.tracks.evidence / freed.sum()
        for part, part_share in zip(self.elsewhere, shares, strict=True):
            _pour(part, float(freed.sum() * part_share), evidence)
        self.tracks = replace(self.tracks, log_weight=self.tracks.log_weight + np.log1p(-share))

    def _return(self, share: float) -> None:
        """Moves `share` of the mass off the map back onto it."""
        off, inside = self.elsewhere[0], self.elsewhere[1:]
        if not inside or share <= 0.0:
            return
        back = share * np.exp(off.log_weight)
        total = sum(part.area for part in inside)
        for part in inside:
            _pour(part, float(back * part.area / total), off.evidence)
        off.log_weight += float(np.log1p(-share))

    def observe(self, seen: Observation, share: Share) -> None:
        """Weighs every part by what was seen, fuses tracks with hypotheses, and starts new tracks.

        Hypotheses that are no likelier than an unlisted pose add nothing and are left out.
        """
        seen = seen.likelier_than_unlisted()
        frame = self.frame_index(seen.frame, seen.area)
        source = self.source_index(seen.source)
        mine = self.tracks.frame == frame
        grown = self._branches(self.tracks.pick(mine), seen, source, share)
        new = self._births(frame, seen, source, share, grown.log_weight.max(initial=-np.inf))
        self._weigh_elsewhere(frame, seen, source, share)
        self.tracks = join([self.tracks.pick(~mine), grown, new])
        self.normalise()

    def _branches(self, old: Tracks, seen: Observation, source: int, share: Share) -> Tracks:
        """Each track once as predicted, and once for each hypothesis in its gate (fork)."""
        pairs = associate(old.x, old.C, seen.poses, seen.covariances, self.gate)
        alone = np.arange(len(old))
        origin = np.concatenate([alone, pairs.track])
        missed = _missed(seen, old.C)
        missed[pairs.track] += LOG_COINCIDENCE
        fit = np.concatenate(
            [
                np.logaddexp(seen.unlisted, missed),
                _above(seen.log_likelihoods, seen.unlisted)[pairs.hypothesis] + pairs.log_overlap,
            ]
        )
        total = np.full(len(old), -np.inf)
        np.logaddexp.at(total, origin, fit)
        before = old.evidence[origin, source]
        branches = old.pick(origin)
        log_weight = (
            branches.log_weight
            + share.weight * total[origin]
            - share.novelty * before
            + _branch_shares(fit, origin, len(old), share.weight)
        )
        evidence = branches.evidence.copy()
        evidence[:, source] += share.novelty * (fit - before)
        x, C = branches.x.copy(), branches.C.copy()
        joined = slice(len(old), None)
        R = seen.covariances[pairs.hypothesis]
        precision = independent_share(C[joined], R, share.precision)
        x[joined], C[joined] = fuse(
            x[joined], C[joined], seen.poses[pairs.hypothesis], R / precision[:, None, None]
        )
        observations = branches.observations.copy()
        observations[joined] += 1
        id_, parent = _forks(branches, log_weight, origin)
        return replace(
            branches,
            x=x,
            C=C,
            log_weight=log_weight,
            evidence=evidence,
            observations=observations,
            id=id_,
            parent=parent,
        )

    def name_new(self) -> None:
        """Gives numbers to the tracks that forks and births left without one."""
        unnamed = self.tracks.id == 0
        count = int(unnamed.sum())
        id_ = self.tracks.id.copy()
        id_[unnamed] = np.arange(self.next_id, self.next_id + count)
        self.next_id += count
        self.tracks = replace(self.tracks, id=id_)

    def _births(self, frame: int, seen: Observation, source: int, share: Share, heaviest: float) -> Tracks:
        """A track for each hypothesis, with the mass that no track holds in the hypothesis' volume."""
        part = self.elsewhere[frame]
        before = part.evidence[source]
        excess = _above(seen.log_likelihoods, seen.unlisted)
        log_weight = (
            part.log_weight
            + _log_volume(seen.covariances)
            - np.log(part.area * 2.0 * np.pi)
            + share.weight * excess
            - share.novelty * before
        )
        least = np.log(self.settings.prune_below) + max(heaviest, log_weight.max(initial=-np.inf))
        born = np.flatnonzero(log_weight > least)
        x, C = seen.poses[born], seen.covariances[born]
        evidence = np.tile(part.evidence, (len(born), 1))
        evidence[:, source] += share.novelty * (excess[born] - before)
        none = np.zeros(len(born), dtype=np.intp)
        return Tracks(
            x,
            C,
            log_weight[born] - np.log(crowding(x, C)),
            evidence,
            none + frame,
            none,
            none,
            none + seen.stamp,
            none + 1,
        )

    def _weigh_elsewhere(self, frame: int, seen: Observation, source: int, share: Share) -> None:
        """Unlisted poses of this frame, and places off every map: the reference, log-likelihood 0."""
        for index, fit in ((frame, float(np.logaddexp(seen.unlisted, 0.0))), (0, 0.0)):
            part = self.elsewhere[index]
            part.log_weight += share.weight * fit - share.novelty * part.evidence[source]
            part.evidence[source] += share.novelty * (fit - part.evidence[source])

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


def _forks(branches: Tracks, log_weight: Array, origin: Index) -> tuple[Index, Index]:
    """Ids and parents: the likeliest branch stays the track, the others fork from it, yet unnamed (0)."""
    order = np.lexsort((-log_weight, origin))
    first = np.ones(len(order), dtype=bool)
    first[1:] = origin[order][1:] != origin[order][:-1]
    forked = np.ones(len(order), dtype=bool)
    forked[order[first]] = False
    return np.where(forked, 0, branches.id), np.where(forked, branches.id, branches.parent)


def independent_share(C: Array, R: Array, progress: float) -> Array:
    """Share (p,) of a hypothesis' information that a track does not have yet; for (p, 3, 3) each.

    Scans from one place err alike: a track as sure as one scan learns only what motion makes new. One
    that prediction has made vaguer than a scan takes all of it.
    """
    known = np.cbrt(determinant(R) / determinant(C))
    return np.clip(1.0 - known, max(progress, 1e-3), 1.0)


def _branch_shares(fit: Array, origin: Index, tracks: int, weight: float) -> Array:
    """Logarithm of each branch's share in its track; the first `tracks` are those without a hypothesis.

    Whether the scan shows the track at all is asked of each scan anew. Which of several hypotheses is
    the track's is not: scans from one place repeat each other's preference, so it counts by `weight`.
    """
    total, hits, tempered = (np.full(tracks, -np.inf) for _ in range(3))
    joined, own = fit[tracks:], origin[tracks:]
    np.logaddexp.at(total, origin, fit)
    np.logaddexp.at(hits, own, joined)
    np.logaddexp.at(tempered, own, weight * joined)
    alone = fit[:tracks] - total
    return np.concatenate([alone, weight * joined - tempered[own] + hits[own] - total[own]])


def _missed(seen: Observation, C: Array) -> Array:
    """Log-likelihood (n,) of tracks (n, 3, 3) whose right pose the list lacks.

    A list that lacks the right pose says as much as one of a place off the map: over the whole area it is
    worth 0. Held by one peak as narrow as a listed one, that is the area over the peak's volume; a vague
    track holds the peak less well.
    """
    if not len(seen.covariances):
        return np.zeros(len(C))
    R = seen.covariances[0]
    peak = float(_log_volume(R[None])[0])
    overlap: Array = 0.5 * np.log(determinant(R) / determinant(C + R))
    return float(np.log(seen.area * 2.0 * np.pi)) - peak + overlap


def _log_volume(C: Array) -> Array:
    """Logarithm of the integral of exp(-d^2/2) under covariances (k, 3, 3)."""
    result: Array = 1.5 * np.log(2.0 * np.pi) + 0.5 * np.log(determinant(C))
    return result


def _above(log_likelihoods: Array, unlisted: float) -> Array:
    """ln(exp(L) - exp(unlisted)): what a listed hypothesis adds to the level that all poses have."""
    gap = unlisted - log_likelihoods
    with np.errstate(divide="ignore", invalid="ignore"):
        result: Array = np.where(gap < 0, log_likelihoods + np.log1p(-np.exp(np.minimum(gap, 0.0))), -np.inf)
    return result


def _pour(part: Elsewhere, mass: float, evidence: Array) -> None:
    """Adds mass with its own evidence to a part; the part remembers the mean."""
    if mass <= 0.0:
        return
    before = float(np.exp(part.log_weight))
    total = before + mass
    part.evidence = (before * part.evidence + mass * evidence) / total
    part.log_weight = float(np.log(total))
