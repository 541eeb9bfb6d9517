"""Why poses are missing, a place, or odometry, in words; by stamps and counts alone, without a clock."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import Enum

from eigenscan.tracker.lidars import GONE_NS
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.timeline import Outcome, Timeline

SILENT_NS = 2_000_000_000
"""A source's hypotheses without a pose for longer, by their stamps or by odometry's, are a fault; also scans
without odometry."""
SILENT_LISTS = 20
"""The same where stamps do not go on: 2 s of a lidar of 10 Hz."""
NO_PLACE, NO_PLACE_NS = 0.9, 10_000_000_000
"""Probability of no place of the map, from which on for so long it is a fault: a robot that was switched on
finds its place within seconds.
"""
RESTARTS_WITHIN = 30
"""Lists between two set-backs of the clock, up to which they are two clocks."""


class Ending(Enum):
    """How a list of hypotheses ended without a pose."""

    DUPLICATE = "each repeats an earlier stamp: the lidar's driver must set a new one for each scan"
    TOO_LATE = "their stamps are {behind:.1f} s behind the newest one: check the lidars' clocks"
    FUTURE = (
        "each stamp is more than 1 s ahead of all others, and none within 60 s confirms it: check "
        "the lidar's clock"
    )
    UNUSABLE = "scans have too few beams with a return: is the lidar covered, or is all beyond its range?"
    REPEATED = "each scan repeats the one before: is the lidar frozen?"
    NOT_FINITE = "all of them are no numbers"
    EMPTY = "the lists are empty: the projector finds no place for the scans"
    UNLIKELY = "none is likelier than a pose that is not listed"


_REFUSED = {
    Outcome.DUPLICATE: Ending.DUPLICATE,
    Outcome.TOO_LATE: Ending.TOO_LATE,
    Outcome.FUTURE: Ending.FUTURE,
}


@dataclass
class _Run:
    """Lists of one source, one after another, that ended without a pose."""

    first: int
    last: int
    odometry: int | None
    ending: Ending
    behind_s: float = 0.0
    lists: int = 0
    added: int = 0
    """Stamp of odometry or of another source when the last list came."""


class Silence:
    """Follows, for each source of hypotheses, how long they have ended without a pose."""

    def __init__(self, timeline: Timeline) -> None:
        self._timeline = timeline
        self._runs: dict[str, _Run] = {}
        self._odometry: int | None = None
        self._advanced: int | None = None
        """Stamp of the newest list when odometry's stamps last increased."""
        self._since_restart = RESTARTS_WITHIN
        self._two_clocks = False
        self._newest: int | None = None
        self._first: int | None = None
        """Stamp of the first list since the clock was set back."""
        self._placed: int | None = None
        """Stamp of the last list by which the robot may have been in the map, or of the first one."""
        self._unplaced = Counter[bool]()
        """Lists after it, by whether their scans were usable."""

    def receive_odometry(self, stamp: int) -> None:
        """Odometry has come as far as `stamp`, ns."""
        if self._odometry is None or stamp > self._odometry:
            self._advanced = self._timeline.newest
        self._odometry = stamp

    def receive(self, seen: Observation, outcome: Outcome) -> None:
        """A list came, and the timeline took it or did not."""
        behind_s = 0.0 if self._newest is None else (self._newest - seen.stamp) * 1e-9
        self._newest = self._timeline.newest
        self._since_restart += 1
        if outcome is Outcome.RESTARTED or self._first is None:
            self._first = seen.stamp
            self._place(seen.stamp)
        if outcome is Outcome.RESTARTED:
            self._two_clocks = self._since_restart <= RESTARTS_WITHIN
            self._since_restart = 0
        elif self._since_restart > RESTARTS_WITHIN:
            self._two_clocks = False
        if outcome in _REFUSED:
            self._add(seen, _REFUSED[outcome], behind_s)

    def answer(self, seen: Observation, *, repeated: bool, has_pose: bool, none: float) -> None:
        """A list that was taken became an estimate; `repeated`: its scan showed nothing new.

        `none`: probability that no place of the map is right.
        """
        # once stated it ends where a place is as probable: in a wrong map single scans look as if they fit
        if none < (1.0 - NO_PLACE if self.no_place else NO_PLACE):
            self._place(seen.stamp)
        self._unplaced[seen.usable] += 1
        if has_pose:
            self._runs.pop(seen.source, None)
        elif not seen.usable:
            self._add(seen, Ending.UNUSABLE)
        elif repeated:
            self._add(seen, Ending.REPEATED)
        elif not seen.listed:
            self._add(seen, Ending.EMPTY)
        else:
            self._add(seen, Ending.UNLIKELY if len(seen.poses) else Ending.NOT_FINITE)

    def _place(self, stamp: int) -> None:
        self._placed = stamp
        self._unplaced.clear()

    def _add(self, seen: Observation, ending: Ending, behind_s: float = 0.0) -> None:
        run = self._runs.setdefault(seen.source, _Run(seen.stamp, seen.stamp, self._odometry, ending))
        run.first, run.last = min(run.first, seen.stamp), max(run.last, seen.stamp)
        run.ending, run.behind_s, run.lists, run.added = ending, behind_s, run.lists + 1, self._now

    @property
    def _now(self) -> int:
        return max(self._odometry or 0, self._timeline.newest or 0)

    @property
    def reason(self) -> str:
        """Why poses are missing; empty: they are not."""
        if self._two_clocks:
            return (
                "stamps of scans jump back repeatedly, and tracking restarts "
                "each time: two robots, or two drivers, use one name, and their clocks differ"
            )
        for source, run in sorted(self._runs.items()):
            if not 0 <= self._now - run.added <= GONE_NS:  # below 0: the clock was set back since
                continue
            apart = run.last - run.first
            if self._odometry is not None and run.odometry is not None:
                apart = max(apart, self._odometry - run.odometry)
            if apart > SILENT_NS or run.lists >= SILENT_LISTS:
                return f"hypotheses of {source} arrive, no pose: " + run.ending.value.format(
                    behind=run.behind_s
                )
        return self._waiting()

    @property
    def odometry_ends(self) -> str:
        """Since when odometry is missing, though poses come; empty: it is not, or none has ever come."""
        missing = self._gone_on_since(self._odometry)
        if missing <= SILENT_NS:
            return ""
        if self._advanced is not None and self._gone_on_since(self._advanced) <= SILENT_NS:
            return f"odometry stamps are {missing * 1e-9:.1f} s behind the scans: do their clocks differ?"
        return f"no odometry of the last {missing * 1e-9:.1f} s: does its driver still run?"

    @property
    def no_place(self) -> str:
        """That scans fit nowhere in the map; empty: they fit somewhere, or did lately."""
        if self._gone_on_since(self._placed) <= NO_PLACE_NS:
            return ""
        if self._unplaced[False] > self._unplaced[True]:
            return f"most {Ending.UNUSABLE.value}"
        return (
            "scans fit no place of the map, or many alike: is it the map of this floor, has it this part, "
            "is it up to date?"
        )

    @property
    def note(self) -> str:
        """That the robot has no odometry at all: it may be a lidar that somebody carries."""
        if self._odometry is not None or self._gone_on_since(self._first) <= SILENT_NS:
            return ""
        return "no odometry has come: nothing shows whether poses follow from each other"

    def _gone_on_since(self, stamp: int | None) -> int:
        """How far lists have come after a stamp, ns; 0 without one."""
        newest = self._timeline.newest
        return 0 if stamp is None or newest is None else newest - stamp

    def _waiting(self) -> str:
        oldest, newest = self._timeline.longest_waiting, self._timeline.newest
        if oldest is None or newest is None or newest - oldest[1] <= SILENT_NS:
            return ""
        odometry = "none has come"
        if self._odometry is not None:
            odometry = f"odometry stamps are {(newest - self._odometry) * 1e-9:.1f} s behind the scans"
        return f"hypotheses of {oldest[0]} wait for odometry, no pose: {odometry}"
