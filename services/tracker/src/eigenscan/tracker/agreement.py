"""Whether odometry and scans show the same motion: each interval of scan motion is compared with odometry.

Scan-ingest publishes how the robot moved between two scans, by these alone. What explains the difference to
odometry best is found by `faults`, for each lidar. While that is rather a fault, no pose is claimed: a
similar place goes on as well as the right place does.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from math import hypot

import numpy as np
from eigenscan.schemas.channels import FOLLOWS
from eigenscan.tracker.faults import LATE_S, WITHOUT_SIGN, Faults
from eigenscan.tracker.lateness import Lateness
from eigenscan.tracker.lidars import Lidars
from eigenscan.tracker.odometry import Motion, OdometryTrail
from eigenscan.tracker.planar import IDENTITY, Pose

FARTHEST_M, FARTHEST_RAD = 1.2, 0.8
"""Between two scans farther apart by odometry than this the motion may be found wrongly: left out.

From a guess of no motion, of 1,326 found over 0.35 m to 1.2 m on intel and guardian 2, 3 were off by over 4
sigma. Of 237 found over turns of 0.4 to 0.8 on intel, fr079 and guardian 2 (every fourth scan), 1 was off by
over 0.1.
"""
FITTING_M, FITTING_RAD = 0.3, 0.4
"""The same for two scans that do not fit each other: farther apart, they need not."""
UNKNOWN_S = 0.05
"""Of an interval that odometry does not cover, above which it is not compared, and gives no velocity."""
COARSE_NS = 700_000_000
"""Between messages of odometry farther apart than this a robot may stop or start unseen, by a(t/2)^2 = 12 cm
at 1 m/s^2: far more than right motions differ by. Then nothing is compared.
"""
JUMPS, JUMPS_NS = 3, 15_000_000_000
"""So many jumps of odometry in so long are no reset but two robots. As long is one jump reported."""
REPORTED_NS = 75_000_000
"""From such a delay of the scans' stamps on it is reported."""
UNSEEN = Faults()
"""Of a lidar that has shown no motion yet."""

Spread = tuple[float, float, float]
"""Covariance of a way: xx, xy, yy [m^2]."""


@dataclass(frozen=True)
class ScanInterval:
    """Motion between two scans of a lidar, stamps in ns; None where they do not fit each other."""

    lidar: str
    since: int
    stamp: int
    moved: Pose | None
    spread: Spread = (0.0, 0.0, 0.0)
    turn_variance: float = 0.0
    repeats: int = 0
    longest_step: float = 0.0
    """s, longest between two scans on the way."""
    watched: bool = False
    """Whether a scan on the way that differs would have been published at once."""
    explained: float = 1.0
    """Share of the later scan's beams that the earlier one has too."""

    @property
    def follows(self) -> bool:
        """Whether the later scan follows from the earlier one, and those between from each other."""
        return self.watched and self.explained >= FOLLOWS


@dataclass
class _Lidar:
    """What one lidar's scan motion has shown."""

    faults: Faults = field(default_factory=Faults)
    differed: int | None = None
    """If its scans are watched, stamp of the newest that did not agree, ns; 0: all did."""
    taken: int | None = None
    """Stamp of the newest scan whose motion was held against odometry's, ns."""


class Agreement:
    """How far scan motion and odometry of one robot agree."""

    def __init__(self) -> None:
        self._lidars = Lidars(_Lidar)
        self._lateness = Lateness()
        self._waiting: deque[ScanInterval] = deque(maxlen=64)
        self._jumps: deque[int] = deque(maxlen=JUMPS)
        self._repeated: deque[tuple[str, int]] = deque(maxlen=64)
        self._received: deque[tuple[str, int, int]] = deque(maxlen=64)
        self.disagreed = False
        """Whether odometry and scans differed when they were last compared."""

    @property
    def trust(self) -> float:
        """Probability that the scans of each lidar show the robot's motion."""
        if self.two_robots:
            return 0.0
        return min((each.trust for each in self._faults()), default=UNSEEN.trust)

    @property
    def proven(self) -> float:
        """Probability that each lidar is set up right, as far as motion has shown it."""
        return min((each.proven for each in self._faults()), default=UNSEEN.proven)

    @property
    def right(self) -> float:
        """The same by how probably a mount is loose: what a protection level rests on."""
        return min((each.right for each in self._faults()), default=UNSEEN.right)

    @property
    def reversed(self) -> bool:
        """Whether odometry counted backwards as forwards when it was last compared."""
        return any(each.backwards for each in self._faults())

    @property
    def fault(self) -> str:
        """Why odometry and scans rather do not agree, or did not lately; empty while they do."""
        if self.two_robots:
            return "odometry jumps again and again: is it in metres and radians, or of two robots?"
        present = list(self._lidars.present())
        for name, lidar in present:
            if fault := lidar.faults.fault:
                return fault if len(present) == 1 else f"{name}: {fault}"
        if self._jumps and self._was_lately(self._jumps[-1]):
            return "odometry jumped: was it reset, or do two robots use this name?"
        return WITHOUT_SIGN if any(each.without_sign for each in self._faults()) else ""

    @property
    def note(self) -> str:
        """What is wrong and has no effect on poses; empty: nothing."""
        delay = self._lateness.delay
        late = f"scans are stamped {delay * 1e-9:.2f} s late; made up for" if delay >= REPORTED_NS else ""
        return late or next((each.note for each in self._faults() if each.note), "")

    def is_repeated(self, lidar: str, stamp: int) -> bool:
        """Whether a scan repeats the one before: it shows nothing new."""
        return (lidar, stamp) in self._repeated

    def parts(self, lidar: str, since: int) -> bool | None:
        """Whether one of a lidar's scans after `since`, ns, did not follow from the one before.

        Its motion differed from odometry's, or it hardly fitted: of a lidar that is watched such motion is
        published with its scan. None: nobody watches.
        """
        known = self._lidars.get(lidar)
        return None if known is None or known.differed is None else known.differed > since

    def note_jump(self, stamp: int) -> None:
        """Odometry's frame jumped."""
        self._jumps.append(stamp)
        self._lidars.now = stamp

    def restart(self) -> None:
        """Odometry's clock was set back: what waits is of another time."""
        self._waiting.clear()
        for lidar in self._lidars.all():
            lidar.faults.restart()
            lidar.differed = lidar.taken = None

    @property
    def two_robots(self) -> bool:
        """Whether odometry jumps so often that two robots must use one name."""
        return len(self._jumps) == JUMPS and all(map(self._was_lately, self._jumps))

    def _was_lately(self, jump: int) -> bool:
        return abs(self._lidars.now - jump) <= JUMPS_NS

    def see(self, lidar: str, stamp: int) -> None:
        """A scan of this stamp, ns, came from a lidar."""
        self._lidars.see(lidar, stamp)

    def receive(self, interval: ScanInterval) -> None:
        """Keeps an interval until odometry has come as far; once, for it comes alone and with hypotheses."""
        key = interval.lidar, interval.since, interval.stamp
        if key in self._received:
            return
        self._received.append(key)
        if interval.repeats:
            self._repeated.append((interval.lidar, interval.stamp))
            if interval.moved is None:
                interval = ScanInterval(interval.lidar, interval.since, interval.stamp, IDENTITY)
        self._waiting.append(interval)

    def compare(self, trail: OdometryTrail, until: int) -> list[tuple[ScanInterval, Motion]]:
        """Compares the intervals that end by `until`, ns, with odometry, where there is some.

        By stamps, whatever came first: what arrived early counts no sooner. Gives the intervals over which
        the scans show the motion well, in order, each with odometry's. Sets the trail's delay.
        """
        self._lidars.now, found = until, []
        due = [each for each in self._waiting if each.stamp <= until]
        for interval in sorted(due, key=lambda each: (each.stamp, each.lidar)):
            self._waiting.remove(interval)
            if not interval.since < interval.stamp:
                continue
            self._lidars.see(interval.lidar, interval.stamp)
            driven = trail.between(interval.since, interval.stamp)
            if _is_far(driven, interval):
                lidar = self._lidars.of(interval.lidar)
                _note(lidar, interval, agrees=False)
                if interval.moved is not None and driven.breaks <= 0:
                    lidar.faults.take_far(interval.moved, driven)
                continue
            if interval.moved is not None and not interval.repeats:
                found.append((interval, driven))
            ends = interval.since, interval.stamp
            coarse = max(map(trail.spacing, ends)) > COARSE_NS
            known = abs(driven.unknown) <= min(UNKNOWN_S, driven.seconds / 2.0)
            if driven.breaks <= 0 and known and not coarse:
                lidar = self._lidars.of(interval.lidar)
                self._take(lidar, _widened(interval, map(trail.leeway, ends)), driven, trail)
                _note(lidar, interval, agrees=not self.disagreed)
        return found

    def _take(self, lidar: _Lidar, interval: ScanInterval, driven: Motion, trail: OdometryTrail) -> None:
        faults = lidar.faults
        if interval.moved is None:
            faults.take_apart()
            self.disagreed = True
        else:
            follows = interval.follows and interval.longest_step < LATE_S and lidar.taken == interval.since
            self.disagreed = not faults.take(
                interval.moved,
                interval.spread,
                interval.turn_variance,
                driven,
                interval.since,
                trail,
                follows,
            )
            lidar.taken = interval.stamp
            if not interval.repeats and faults.agrees > 0.5:
                self._lateness.take(interval.since, interval.stamp, interval.moved, trail)
                trail.delay(self._lateness.delay)

    def change(self) -> float:
        """How much scans change as odometry predicts, 0..1."""
        return min((each.changes for each in self._faults()), default=1.0)

    def _faults(self) -> Iterator[Faults]:
        """Those of each lidar that still sends scans."""
        return (lidar.faults for _, lidar in self._lidars.present())


def _note(lidar: _Lidar, interval: ScanInterval, *, agrees: bool) -> None:
    if interval.watched:
        lidar.differed = lidar.differed or 0 if agrees and interval.follows else interval.stamp


def _widened(interval: ScanInterval, leeways: Iterable[tuple[float, float]]) -> ScanInterval:
    """The interval, its covariance with what odometry at its ends may be off by, m and rad."""
    way, turn = np.square(list(leeways)).sum(axis=0).tolist()
    xx, xy, yy = interval.spread
    return replace(interval, spread=(xx + way, xy, yy + way), turn_variance=interval.turn_variance + turn)


def _is_far(driven: Motion, interval: ScanInterval) -> bool:
    """Whether two scans on the way lie so far apart that what was found between them means nothing."""
    x, y, turn = interval.moved or IDENTITY
    step = min(interval.longest_step / max(driven.seconds, 1e-9), 1.0)
    way, turned = max(driven.way, hypot(x, y)), max(driven.turn, abs(turn))
    farthest = (FITTING_M, FITTING_RAD) if interval.moved is None else (FARTHEST_M, FARTHEST_RAD)
    return way * step > farthest[0] or turned * step > farthest[1]
