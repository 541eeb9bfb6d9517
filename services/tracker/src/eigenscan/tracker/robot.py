"""One robot's tracker: odometry and observations in, an estimate for each observation out."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import exp

import numpy as np
from eigenscan.geometry.circle import TURN
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, STATE_LOST, State, Track
from eigenscan.tracker.agreement import UNSEEN, Agreement, ScanInterval
from eigenscan.tracker.belief import Belief, happened
from eigenscan.tracker.branching import follow
from eigenscan.tracker.claim import Claim
from eigenscan.tracker.confidence import (
    Protection,
    Verdict,
    judge,
    mass_of_place,
    next_state,
    protect,
    share_within,
)
from eigenscan.tracker.continuity import THICK_M, carried_ratio, goes_on, is_broken
from eigenscan.tracker.floors import Building, Rivals
from eigenscan.tracker.gyroscope import Gyroscope
from eigenscan.tracker.observation import Observation, limit_sigma
from eigenscan.tracker.odometry import Motion, OdometryTrail, Sample
from eigenscan.tracker.planar import Pose, compose, inverse
from eigenscan.tracker.prediction import predict
from eigenscan.tracker.range_errors import RangeErrors
from eigenscan.tracker.reckoning import leg
from eigenscan.tracker.relocation import SAME_TIME_NS, Hint, heed
from eigenscan.tracker.search import SURE, Request, Searches
from eigenscan.tracker.sequences import Sequences
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.share import Share
from eigenscan.tracker.silence import Silence
from eigenscan.tracker.timeline import Outcome, Timeline
from eigenscan.tracker.tracks import Tracks
from eigenscan.tracker.unification import settle
from eigenscan.tracker.velocity_gate import VelocityGate
from numpy.typing import NDArray

Array = NDArray[np.float64]

STANDING_RATE = 0.02
"""1/s, how fast scans from one place count again: people pass, noise changes."""
BLIND_RATE = 0.5
"""1/s, the same where nobody knows whether the robot moves."""
BLIND_NS = 1_000_000_000
"""Without an estimate for longer, a claim holds as long as odometry alone carries it."""
UNCONFIRMED = 2.0
"""New scans without the claimed place, after which a claim ends where other places are at all likely.

What is hidden for so long is more often wrong (benchmarks/mechanisms.py).
"""
SKEWED = 0.025
"""Of a scan's angle, a turn since the scan before from which beams may seem 5 % too far apart, or too near:
half of it. A lidar sweeps while the robot turns, and nobody states for how long.
"""
CLOCK_SET_BACK = "odometry's stamps went back by {:.1f} s: was the robot's clock set?"
HISTORY_STEP = (0.1, 0.1, 0.17)
"""m, m, rad between two kept poses of a trajectory."""


@dataclass(frozen=True)
class Estimate:
    """What one observation led to."""

    stamp: int
    frame: str
    tracks: Tracks
    histories: Mapping[int, Track]
    """By id: a track with nothing but its history, which goes on with the next step."""
    verdict: Verdict
    state: State
    none_probability: float
    map_to_odom: Pose | None
    model_version: str
    protection: Protection | None
    extrapolated: bool = False
    """By odometry that was carried on by its last velocity."""
    request: Request | None = None
    """For the lidar's next scan."""


@dataclass
class _Source:
    """How far one source's evidence has come: to the stamp of its `last` list of the whole map."""

    last: int
    shows: tuple[str, str]
    """Lidar and map frame: sources of the same speak of the same, and share its evidence."""
    fixed: int = 0
    """Stamp of its last list, also a local one."""
    scans: int = 0
    poses: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """Its last list, likeliest first."""
    surfaces: int = 0
    """Of thick walls, those that this list fits."""
    turned: float = 0.0
    """rad turned at the present place, up to what its scans had not shown."""

    def new_turn(self, moved: Motion, place: float, unseen: float) -> float:
        """Turn of a motion, rad, that shows what the present place, of some metres, has not shown yet.

        `unseen`: of the place's surroundings, rad, what one scan does not show.
        """
        self.turned *= exp(-moved.way / place)
        new = min(moved.turn, max(0.0, unseen - self.turned))
        self.turned += new
        return new


MOST_NAMES = 256
"""Sources of hypotheses with their map frames; beyond these tracking begins again, in bounded memory."""


class RobotTracker:
    """Tracks one robot. Needs no clock: all time is in the stamps."""

    def __init__(
        self, settings: TrackerSettings, counts: Counter[str], *, believes_stamps: bool = False
    ) -> None:
        self._settings, self._believes_stamps = settings, believes_stamps
        self._counts = counts
        self.building = Building()
        """Of the site's models; the core keeps it current."""
        self._gyroscope = Gyroscope(settings.turn_max, counts)
        self._trail = OdometryTrail(
            VelocityGate(settings.v_max, settings.turn_max),
            self._gyroscope.steer,
            extrapolates=settings.at_once,
        )
        self._odometry: deque[tuple[int, Pose]] = deque()
        """Waits for the gyroscope's heading of its time."""
        self._agreement = Agreement()
        self._crowded = 0
        """Lists to come before health is silent about too many sources."""
        self._begin()

    def _begin(self) -> None:
        """Knows no source of hypotheses."""
        self._timeline = Timeline(
            self._settings.patience,
            self._settings.late,
            self._counts,
            believes_stamps=self._believes_stamps,
        )
        self._silence, self._ranges = Silence(self._timeline), RangeErrors()
        self._names: set[tuple[str, str]] = set()
        self._reset()

    def _reset(self) -> None:
        kind = Sequences if self._settings.method == "paper" else Belief
        self.belief = kind(self._settings)
        self.state: State = STATE_LOST
        self._histories: dict[int, Track] = {}
        self._ends: dict[int, Pose | None] = {}
        """By id: the last pose of its history."""
        self._sources: dict[str, _Source] = {}
        self._anchor: Pose | None = None
        self._claim = Claim(self._settings)
        self._rivals = Rivals()
        self._hint: Hint | None = None
        self._searches = Searches()
        self._corrected = 0

    def relocate(self, hint: Hint | None) -> None:
        """Forgets where the robot was; starts again, from the next scan on, at the hint if there is one."""
        next_id = self.belief.next_id
        self._reset()
        self.belief.next_id = next_id
        self._hint = hint

    def receive_odometry(self, stamp: int, pose: Pose) -> Iterator[Estimate]:
        """Takes odometry, base in the odom frame; gives the estimates that waited for it."""
        self._odometry.append((stamp, pose))
        return self._take_odometry()

    def receive_heading(self, since: int, stamp: int, heading: float) -> Iterator[Estimate]:
        """Takes a gyroscope's heading; gives the estimates that waited for it."""
        self._gyroscope.receive(since, stamp, heading)
        return self._take_odometry()

    def _take_odometry(self) -> Iterator[Estimate]:
        """Takes what no heading of before is still to come for."""
        while self._odometry and self._gyroscope.reaches(self._odometry[0][0], self._odometry[-1][0]):
            self._steered(*self._odometry.popleft())
        return self._ready()

    def _steered(self, stamp: int, pose: Pose) -> None:
        result = self._trail.take(stamp, pose)
        self._counts[result] += 1
        if result == "odometry_taken_as_jump":
            self._agreement.note_jump(stamp)
        if result == "odometry_restarted":  # how far the robot came between two clocks is not known
            self._reset()
            self._agreement.restart()
        newest = self._trail.newest
        if newest is not None:
            self._timeline.receive_odometry(newest.stamp, result == "odometry_restarted")
            self._silence.receive_odometry(newest.stamp)

    def receive(self, seen: Observation) -> Iterator[Estimate]:
        """Takes an observation; gives the estimates that are ready."""
        self._crowded = max(self._crowded - 1, 0)
        if (seen.source, seen.frame) not in self._names and len(self._names) == MOST_NAMES:
            self._counts["sources_forgotten"] += MOST_NAMES
            self._crowded = MOST_NAMES
            self._begin()
        self._names.add((seen.source, seen.frame))
        outcome = self._timeline.receive(seen)
        self._silence.receive(seen, outcome)
        if outcome is Outcome.RESTARTED:
            self._reset()
        return self._ready()

    def receive_motion(self, interval: ScanInterval) -> None:
        """Takes the motion between two scans."""
        self._agreement.receive(interval)

    def finish(self) -> Iterator[Estimate]:
        """Estimates for all that still waits."""
        while self._odometry:
            self._steered(*self._odometry.popleft())
        return (self._step(seen) for seen in self._timeline.rest())

    def _ready(self) -> Iterator[Estimate]:
        """One step after another: an estimate holds until the next one is asked for."""
        if not self._timeline.waits:
            return iter(())
        return (self._step(seen) for seen in self._timeline.ready(self._trail.reaches))

    @property
    def fault(self) -> str:
        """What is wrong with scans or odometry, or why no pose comes; empty: nothing that shows."""
        if self._crowded:
            return f"more than {MOST_NAMES} sources or map frames of hypotheses: do projectors change names?"
        return (
            self._agreement.fault
            or self._ranges.fault
            or self._silence.reason
            or self._rivals.reason(self.belief.stamp)
            or self._silence.odometry_ends
            or self._silence.no_place
            or (CLOCK_SET_BACK.format(self._trail.behind * 1e-9) if self._is_set_back else "")
        )

    @property
    def _trust(self) -> float:
        """Probability that scans show the robot's motion, and the map."""
        return min(self._agreement.trust, self._ranges.trust)

    @property
    def note(self) -> str:
        """What is wrong and has no effect on poses; empty: nothing."""
        return self._agreement.note or self._silence.note

    @property
    def _is_set_back(self) -> bool:
        """Whether odometry's clock may have been set back: its motion is then of another time than a scan."""
        return self._trail.behind > self._settings.late * 1e9

    def map_to_odom(self) -> Pose | None:
        """Odom frame's origin in the map as of the newest odometry; none while no pose is claimed."""
        newest = self._trail.newest
        if self._anchor is None or newest is None or self.state != STATE_LOCALIZED or self._is_set_back:
            return None
        if newest.stamp - (self.belief.stamp or 0) > BLIND_NS and not self._is_claimed_at(newest.stamp):
            return None
        return compose(self._anchor, compose(newest.chained, inverse(newest.raw)))

    def _is_claimed_at(self, stamp: int) -> bool:
        """Whether odometry alone still carries the claim to a stamp without scans."""
        tracks = self.belief.tracks
        if self.belief.stamp is None or not len(tracks):
            return False
        best = judge(tracks).track
        moved = self._motion(self.belief.stamp, stamp)
        _, C = predict(tracks.x[best][None], tracks.C[best][None], moved, self._settings)
        return float(share_within(np.zeros((1, 3)), C)[0]) >= self._settings.released_below

    def _step(self, seen: Observation) -> Estimate:
        belief = self.belief
        belief.off_map_share = self.building.off_map_share
        if belief.stamp is not None and seen.stamp < belief.stamp:
            self._counts["hypotheses_late"] += 1
            seen = self._brought_forward(seen, belief.stamp)
        elif belief.stamp is not None:
            moved = self._motion(belief.stamp, seen.stamp)
            belief.predict(moved)
            self._claim.predict(moved)
            self._claim.advance(moved.seconds, self._progress(moved))
            self._ranges.move(self._changed(moved))
            self._correct(seen.stamp)
        belief.stamp = seen.stamp
        self._agreement.see(seen.lidar, seen.stamp)
        self._ranges.see(seen.lidar, seen.stamp)
        belief.forget_innovations()
        repeated = self._agreement.is_repeated(seen.lidar, seen.stamp)
        if repeated:
            self._counts["scan_repeated"] += 1
        elif seen.usable and seen.local:
            self._follow(seen)
        elif seen.usable:
            if seen.range_gains is not None and not self._is_skewed(seen):
                self._ranges.take(seen.lidar, seen.range_gains)
            self._heed_hint(seen)
            share = self._share(seen)
            belief.observe(seen, share)
            if share.broken:  # a claim of another place is a new one
                self._claim.forget()
                self.state = STATE_AMBIGUOUS
            self._rivals.receive(belief, belief.frames.index(seen.frame), seen.stamp)
            settle(belief)
        else:
            self._counts["scan_unusable"] += 1
        self._remember()
        estimate = self._conclude(seen)
        self._silence.answer(
            seen,
            repeated=repeated,
            has_pose=estimate.verdict.track >= 0,
            none=estimate.none_probability,
        )
        return estimate

    def _is_skewed(self, seen: Observation) -> bool:
        """Whether the robot may have turned so far as the lidar swept that beams seem too far apart."""
        since = self._source_of(seen).fixed
        return self._motion(since, seen.stamp).turn > SKEWED * (TURN - seen.unseen)

    def _correct(self, now: int) -> None:
        """Corrects tracks where odometry up to `now` differs from scan motion."""
        for interval, driven in self._agreement.compare(self._trail, now):
            if interval.since >= self._corrected:
                self._corrected = interval.stamp
                way = leg(interval, driven, self._settings)
                self.belief.correct(way, now, self._motion)

    def _applied(self, moved: Motion) -> Motion:
        return _backwards(moved) if self._agreement.reversed else moved

    def _heed_hint(self, seen: Observation) -> None:
        """Takes the hint that waits, if there is one, once a scan of its map frame has come."""
        hint = self._hint
        if hint is None or hint.frame not in ("", seen.frame):
            return
        self._hint = None
        same_time = abs(seen.stamp - hint.stamp) <= SAME_TIME_NS
        heed(self.belief, hint, seen, self._motion(hint.stamp if same_time else seen.stamp, seen.stamp))

    def _motion(self, start: int, end: int) -> Motion:
        return self._applied(self._trail.between(start, end))

    def _brought_forward(self, seen: Observation, stamp: int) -> Observation:
        """A late observation as it would look from where the robot is by now."""
        moved = self._motion(seen.stamp, stamp)
        poses, covariances = predict(seen.poses, seen.covariances, moved, self._settings)
        return replace(seen, stamp=stamp, poses=poses, covariances=limit_sigma(covariances))

    def _source_of(self, seen: Observation) -> _Source:
        source = self._sources.get(seen.source)
        if source is None:
            shows = seen.lidar, seen.frame
            source = self._sources[seen.source] = _Source(seen.stamp, shows, seen.stamp)
        return source

    def _follow(self, seen: Observation) -> None:
        """Brings the tracks to the poses of a list that was made around one of them."""
        source = self._source_of(seen)
        progress = self._news(self._motion(source.fixed, seen.stamp), seen)
        source.fixed = max(source.fixed, seen.stamp)
        found = seen.likelier_than_unlisted()
        self.belief.tracks = follow(self.belief.tracks, found, self.belief.gate, min(1.0, progress))

    def _share(self, seen: Observation) -> Share:
        source = self._source_of(seen)
        source.scans += 1
        peers = sum(1 for other in self._sources.values() if other.shows == source.shows)
        before, alike = source.poses, source.surfaces == seen.surfaces
        source.poses, source.surfaces = seen.poses, seen.surfaces
        if source.scans == 1:
            return Share(1.0 / peers, 0.0, 1.0 / peers, in_part=peers > 1, first=peers == 1)
        moved = self._motion(source.last, seen.stamp)
        last, fixed, source.fixed = source.last, source.fixed, max(source.fixed, seen.stamp)
        seconds = max(moved.seconds, 1e-3)
        source.last = max(source.last, seen.stamp)
        # between lists of other surfaces all poses move: that some go on shows little, but that none does
        count = goes_on(before, seen.poses, moved, 0.0 if alike else THICK_M)
        parts = self._agreement.parts(seen.lidar, last)
        broken = is_broken(count, moved, parts)
        if broken:
            self._counts["continuity_broken"] += 1
            source.scans = 1
        turn = source.new_turn(moved, self._settings.independence_m, seen.unseen)
        moved_on = self._news(moved._replace(turn=turn), seen)
        progress = moved_on / seen.alike
        # a new place counts again, more scans from the same one are averaged
        fresh = float(-np.expm1(-seconds / self._settings.memory - progress))
        weight = max(1.0 / source.scans, fresh)
        # after a kidnap hardly any hypothesis goes on
        rate = self._settings.kidnap_rate * carried_ratio(count if alike else None, moved, parts)
        rate += self.building.lift_rate(self.belief.tracks)
        carried = happened(rate / len(self._sources) * seconds)
        # local lists in between have fixed the tracks
        precision = min(1.0, self._news(self._motion(fixed, seen.stamp), seen) if fixed > last else moved_on)
        return Share(weight / peers, progress / peers, precision / peers, carried, broken, peers > 1)

    def _news(self, moved: Motion, seen: Observation) -> float:
        """How far a scan is new evidence after a motion: also where the robot stands, for people pass.

        One that was gathered shows again what those before it did (benchmarks/narrow_scans.py).
        """
        seconds = max(moved.seconds, 1e-3)
        new = self._changed(moved) + STANDING_RATE * seconds + BLIND_RATE * max(moved.unknown, 0.0)
        return new / max(1.0, seen.gathered / self._settings.independence_m)

    def _changed(self, moved: Motion) -> float:
        """How far scans are new evidence by a motion alone: what was driven counts as far as they changed."""
        return self._progress(moved) * self._agreement.change()

    def _progress(self, moved: Motion) -> float:
        """How far the robot has come, 1: a scan is new evidence."""
        return self._new_scans(moved.way, moved.turn)

    def _new_scans(self, way: float, turn: float) -> float:
        """How many scans are new evidence on a way, m, with a turn, rad."""
        return way / self._settings.independence_m + turn / self._settings.independence_rad

    def _remember(self) -> None:
        """Lengthens each living track's trajectory; a fork goes on from its parent's."""
        tracks, kept = self.belief.tracks, self._settings.history
        before, ends, self._histories, self._ends = self._histories, self._ends, {}, {}
        for id_, parent, pose in zip(
            tracks.id.tolist(), tracks.parent.tolist(), tracks.x.tolist(), strict=True
        ):
            past, end = before.get(id_), ends.get(id_)
            if past is None:
                past, end = Track(), ends.get(parent)
                past.CopyFrom(before.get(parent, past))
            if kept and (end is None or _is_a_step(end, pose)):
                if len(past.history) == kept:
                    del past.history[0]
                end = x, y, theta = pose
                past.history.add(x=x, y=y, theta=theta)
            self._histories[id_] = past
            self._ends[id_] = ends[id_] = end  # a fork copies its parent with what this step added

    def _conclude(self, seen: Observation) -> Estimate:
        belief = self.belief
        verdict = self._judge()
        state = next_state(
            self.state,
            belief,
            verdict.confidence,
            self._settings,
            confirmed=self._is_confirmed(verdict.track),
        )
        if self._is_set_back and state == STATE_LOCALIZED:
            state = STATE_AMBIGUOUS
        self.state = self._claim.held_back(state, belief.tracks, verdict.track)
        odometry = self._trail.at(seen.stamp) if self._near_odometry(seen.stamp) else None
        frame = belief.frames[int(belief.tracks.frame[verdict.track])] if verdict.track >= 0 else seen.frame
        return Estimate(
            seen.stamp,
            frame,
            belief.tracks,
            self._histories,
            verdict,
            self.state,
            belief.none_probability,
            self._map_to_odom_of(verdict, odometry),
            seen.model_version,
            self._protection(verdict),
            odometry is not None and odometry.extrapolated,
            self._request(seen, verdict) if self._settings.local_fits else None,
        )

    def _request(self, seen: Observation, verdict: Verdict) -> Request:
        """What the lidar's next scan is to be searched for."""
        answered = [one.shows[0] for one in self._sources.values()]
        sure = (
            self.state == STATE_LOCALIZED
            and self._settings.method == "mixture"
            and verdict.confidence >= max(self._settings.localized_above, SURE)
            and self._hint is None
            and not self._agreement.disagreed
            and len(self.belief.frames) == 2
            and answered.count(seen.lidar) == 1
        )
        searches = self._searches
        step = self._motion(searches.last(seen.lidar, seen.stamp), seen.stamp)
        far = self._motion(searches.whole(seen), seen.stamp)
        return searches.after(
            seen,
            self._motion(searches.since(seen.lidar, seen.stamp), seen.stamp),
            self._progress(step),
            far._replace(way=far.way + step.way, turn=far.turn + step.turn),
            self.belief.tracks,
            self.belief.frames.index(seen.frame) if seen.frame in self.belief.frames else 0,
            verdict.track,
            sure=sure,
        )

    def _is_confirmed(self, best: int) -> bool:
        """Whether a list has shown the best track lately, or no other place is likely in its stead."""
        if best < 0:
            return False
        tracks = self.belief.tracks
        way, turn = tracks.unchecked[best, :2].tolist()
        shown = self._new_scans(way, turn) <= UNCONFIRMED
        # halfway from where a shown claim ends to where one begins
        likely = (self._settings.localized_above + self._settings.released_below) / 2.0
        return shown or mass_of_place(tracks, best) >= likely

    def _judge(self) -> Verdict:
        """The most believed track, as far as odometry is, and its map frame after every frame's lists."""
        tracks = self.belief.tracks
        verdict = judge(tracks)
        if verdict.track < 0:
            return verdict
        share = self._rivals.share(int(tracks.frame[verdict.track]))
        confidence = min(verdict.confidence, share) * self._trust
        proven = UNSEEN.proven if self._settings.odometry_by_scans else self._agreement.proven
        return Verdict(verdict.track, confidence, proven)

    def _protection(self, verdict: Verdict) -> Protection | None:
        if self.state != STATE_LOCALIZED or self._trust < self._settings.localized_above:
            return None
        # mass that another frame may still get is risk
        if self._settings.odometry_by_scans or self._rivals.since is not None:
            return None
        # a set-up that may be wrong is risk as well
        left = self._settings.protection_risk - (1.0 - self._agreement.right)
        return protect(self.belief.tracks, verdict.track, left) if left > 0.0 else None

    def _near_odometry(self, stamp: int) -> bool:
        newest = self._trail.newest
        return newest is not None and stamp <= newest.stamp + int(self._settings.patience * 1e9)

    def _map_to_odom_of(self, verdict: Verdict, odometry: Sample | None) -> Pose | None:
        if odometry is None or verdict.track < 0:
            return None
        x, y, theta = self.belief.tracks.x[verdict.track].tolist()
        pose = (x, y, theta)
        if self.state == STATE_LOCALIZED:
            self._anchor = compose(pose, inverse(odometry.chained))
        return compose(pose, inverse(odometry.raw))


def _backwards(moved: Motion) -> Motion:
    x, y, turn = moved.delta
    return moved._replace(delta=(-x, -y, turn))


def _is_a_step(last: Pose, pose: Pose) -> bool:
    x, y, theta = HISTORY_STEP
    return abs(pose[0] - last[0]) > x or abs(pose[1] - last[1]) > y or abs(pose[2] - last[2]) > theta
