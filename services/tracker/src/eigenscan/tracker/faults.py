"""Which fault, if any, explains how the scans of a lidar moved: a hidden Markov model of usual faults.

Each state predicts the motion between two scans from odometry's: as odometry says, not at all from a frozen
lidar, sideways from one whose mount is turned, as odometry was some seconds ago from one that is late. Where
scans are early, odometry moves as they did. What the scans show then tells the states apart (forward
algorithm; Rabiner, "A tutorial on hidden Markov models", Proc. IEEE 1989). A motion that two states predict
alike decides nothing between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import degrees, log, radians

import numpy as np
from eigenscan.tracker.calibration import TURNED as TURNED_BY
from eigenscan.tracker.evidence import NEAR_M, NEAR_RAD, SLIP_M, SLIP_RAD, SLIP_SHARE
from eigenscan.tracker.mount import Mount
from eigenscan.tracker.odometry import Motion, OdometryTrail
from eigenscan.tracker.past import PastOdometry, PastScans
from eigenscan.tracker.planar import IDENTITY, Pose, wrap
from eigenscan.tracker.scan_motion import (
    EXACT,
    ODD,
    SHARES,
    SIDEWAYS,
    SIGMA_M,
    SIGMA_RAD,
    SIGMA_SHARE,
    log_gaussian,
    unpredicted,
)
from eigenscan.tracker.set_up import BEGINS, ENDS, SetUp
from eigenscan.tracker.turning import Turning
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

SLIPS, GRIPS = 0.01, 0.4
"""Chances, an interval, that wheels begin to slip and that they cease to."""
ALIKE_BEGINS, ALIKE_ENDS = 0.1, 0.03
"""Chances, an interval, that an unrelated lidar begins to move as odometry by chance, and that it ceases to:
two robots that stand, or drive straight on."""
TURNS_ALIKE = 0.2
"""Of its motions, how many are alike still while odometry turns."""
NO_FIT, NO_FIT_UNRELATED = 0.05, 0.5
"""How often two scans with much in common do not fit each other; and those of unrelated lidars."""
NEWEST = 0.2
"""Share of the newest interval in how often scans did not fit each other lately."""
FAULTY = 0.011
"""Prior of each kind of fault: a hundredth of the robots has it. So no confidence above 0.99 is stated before
the robot's own motion has excluded each.
"""
SET_UP_BEGINS, SET_UP_ENDS = 1e-6, 1e-4
"""The same for a set-up, which hardly ever changes while the robot drives."""
EARLY_PRIOR = 1e-4
"""Prior of scans that come early. With more, a robot whose encoders have no sign is taken for one as it first
backs out: fr079 lost a window of 25 (benchmarks/mechanisms.py)."""
BACKS, BACKS_KNOWN, FORWARDS = 1e-5, 0.01, 0.2
"""Chances, an interval, that a robot begins to drive backwards, its encoders without a sign: before it was
seen to, and after; and that it ceases to."""
LATE_S, LATEST_S, LATE_STEP_S = 0.5, 8.0, 0.25
"""s: scans are tried as so much late, and early, in such steps (less is learned: `lateness`)."""
GOES_ON = 0.9
"""How probably a robot moved before the first odometry, or scan, as it then did."""
TURNED = np.array([radians(angle) for angle in range(30, 345, 15) if abs(angle - 180) > 20])
"""rad, angles by which a mount may be turned."""
HONEST = 0.9
"""Of wheels that seem to slip, how many do: scans that fall behind look the same for seconds. A guess between
both, benchmarks/integrity.py."""
GROWS = 0.02
"""Chance, an interval, that a delay grows by a step, and that it shrinks: a queue fills up."""
QUIET_M, QUIET_RAD = 0.005, 0.005
"""Odometry with less motion in an interval stands."""

UNKNOWN = (
    "odometry and scans show different motions: do wheels slip, is its heading not in radians, "
    "are stamps of two clocks, or are the scans of another robot?"
)
WITHOUT_SIGN = "odometry counts driving backwards as forwards (encoders without a sign); made up for"


@dataclass(frozen=True)
class _Kind:
    """States of one kind: their number, prior of all, chances that they begin and end, and their name."""

    count: int
    prior: float
    begins: float
    ends: float
    name: str


LATE_BY = np.arange(LATE_S, LATEST_S + LATE_STEP_S, LATE_STEP_S)
AGREE, SLIPPING, BACKWARDS = 0, 1, 2
_KINDS = (
    _Kind(1, 0.0, SLIPS, GRIPS, UNKNOWN),
    _Kind(1, 0.0, BACKS, FORWARDS, WITHOUT_SIGN),
    _Kind(
        1, FAULTY, BEGINS, ENDS,
        "scans stay the same while odometry moves: is the lidar frozen or covered, or does odometry drift?",
    ),
    _Kind(2, FAULTY, BEGINS, ENDS, UNKNOWN),
    _Kind(
        1, FAULTY, BEGINS, ENDS,
        "odometry stands still while the scans move: are the encoders read, was it carried?",
    ),
    _Kind(
        1, FAULTY, SET_UP_BEGINS, SET_UP_ENDS,
        "odometry runs opposite to the scans: is the lidar mounted 180° off, or have the encoders no sign?",
    ),
    _Kind(
        1, FAULTY, SET_UP_BEGINS, SET_UP_ENDS,
        "scans turn the other way than odometry: is the lidar mounted upside down, and not stated so?",
    ),
    _Kind(
        len(TURNED), FAULTY, SET_UP_BEGINS, SET_UP_ENDS,
        TURNED_BY,
    ),
    _Kind(
        len(LATE_BY), FAULTY, BEGINS, ENDS,
        "scans come {} s after odometry of the same stamp: are they delayed?",
    ),
    _Kind(
        len(LATE_BY), EARLY_PRIOR, SET_UP_BEGINS, SET_UP_ENDS,
        "scans show each motion {} s before odometry does: are their clocks apart, or is odometry delayed?",
    ),
)  # fmt: skip
_FIRST = np.cumsum([1, *(kind.count for kind in _KINDS)])
FROZEN, UNRELATED, ODOMETRY_STANDS, REVERSED, MIRRORED, MOUNT_TURNED, LATE, EARLY = _FIRST[2:-1].tolist()
ALIKE = UNRELATED + 1
RIGHT = np.array([AGREE, SLIPPING, BACKWARDS])
"""States of a set-up that is right."""
WRONG_SET_UPS = np.array([FROZEN, *range(ODOMETRY_STANDS, int(_FIRST[-1]))])
"""States that are there from the start, if at all: see `set_up`."""
_STATES = int(_FIRST[-1])
INEXACT = np.array([FROZEN, *range(LATE, _STATES)])
"""States in which turns count by their whole sigma: on a straight way, scans turn by less than odometry's
noise. No turn, or one of the many other times', fits them more exactly by chance."""
DISJOINED = (
    "scans do not follow from each other: do two robots or two lidars use this name, "
    "or is the lidar covered in part?"
)


def _start() -> tuple[Array, Array]:
    """Prior (n,), and chances (n, n) from a state to another; faults come after agreement and end in it."""
    prior, change = np.zeros(_STATES), np.eye(_STATES)
    for first, kind in zip(_FIRST, _KINDS, strict=False):
        these = slice(first, first + kind.count)
        prior[these] = kind.prior / kind.count
        change[AGREE, these] = change[SLIPPING, these] = kind.begins / kind.count
        change[these, AGREE] = kind.ends
        change[range(first, first + kind.count), range(first, first + kind.count)] = 1.0 - kind.ends
    prior[AGREE] = 1.0 - prior.sum()
    change[AGREE, AGREE] = 2.0 - change[AGREE].sum()
    # a fault that seems to end is as soon another one, that agrees for a while
    change[FROZEN:, ALIKE] += change[FROZEN:, AGREE]
    change[range(FROZEN, _STATES), range(FROZEN, _STATES)] -= change[FROZEN:, AGREE]
    for one, other, chance in ((UNRELATED, ALIKE, ALIKE_BEGINS), (ALIKE, UNRELATED, ALIKE_ENDS)):
        change[one, other] += chance
        change[one, one] -= chance
    for first in (LATE, EARLY):
        for at in range(first, first + len(LATE_BY) - 1):
            change[[at, at + 1], [at + 1, at]] += GROWS
            change[[at, at + 1], [at, at + 1]] -= GROWS
    change[SLIPPING, [AGREE, SLIPPING]] = GRIPS, 0.0
    change[SLIPPING, SLIPPING] = 1.0 - change[SLIPPING].sum()
    return prior, change


def _bound(change: Array) -> Array:
    """The same chances (n, n) while scans follow from each other: what needs a jump of theirs does not begin.

    They do not become another lidar's, and a delay begins with the least.
    """
    bound = change.copy()
    for first, count, there in (
        (UNRELATED, 2, AGREE),
        (LATE, len(LATE_BY), LATE),
        (EARLY, len(LATE_BY), EARLY),
    ):
        these = np.ix_(RIGHT, np.arange(first, first + count))
        bound[these] = 0.0
        bound[RIGHT, there] += change[these].sum(axis=1)
    return bound


class Faults:
    """How probable each state of one lidar is, and of the odometry that it is held against."""

    def __init__(self) -> None:
        self.probability, self._change = _start()
        self._bound = _bound(self._change)
        self._set_up = SetUp(len(WRONG_SET_UPS), len(EXACT))
        self._mount, self._turning = Mount(), Turning()
        self.without_sign = False
        """Whether the robot was seen to drive backwards while odometry counted on."""
        self._past, self._seen = PastOdometry(LATEST_S, LATE_STEP_S), PastScans(LATEST_S, LATE_STEP_S)
        self._no_fit = 0.0
        """How often scans did not fit each other lately."""
        self._ways = [0.0, 0.0]
        """m driven forwards and backwards."""

    @property
    def trust(self) -> float:
        """Probability that the scans show the robot's motion, of a lidar that is mounted as stated."""
        # of wheels that slip, or that count backwards as forwards, the scans know better
        right = float(self.probability[AGREE] + HONEST * self.probability[SLIPPING])
        right += float(self._goes_forwards * self.probability[BACKWARDS])
        return right * (self._mount.within if self._mount.fault else 1.0)

    @property
    def agrees(self) -> float:
        """Probability that odometry and scans show the same motion."""
        known = self.without_sign and self._goes_forwards
        return float(self.probability[AGREE] + known * self.probability[BACKWARDS])

    @property
    def _goes_forwards(self) -> bool:
        """Whether the robot mostly drove as odometry counts; else the mount is rather turned."""
        forwards, backwards = self._ways
        return backwards < forwards

    @property
    def proven(self) -> float:
        """Probability that the set-up is right, of the least that motion leaves of it: see `set_up`."""
        return min(self._set_up.proven, self._mount.proven)

    @property
    def right(self) -> float:
        """The same where a mount is as seldom loose as motion shows: what a protection level rests on."""
        return min(self._set_up.proven, self._mount.right)

    @property
    def fault(self) -> str:
        """What is rather wrong, in words for the person who can mend it; empty: nothing that shows."""
        return self.cause if self.agrees < 0.5 else self._mount.fault

    @property
    def note(self) -> str:
        """What is wrong with the mount or odometry's turns, and poses bear; empty: nothing that shows."""
        return self._mount.note or self._turning.note

    @property
    def backwards(self) -> bool:
        """Whether the robot rather drives backwards while odometry counts on."""
        return bool(self.probability[BACKWARDS] > 0.5)

    @property
    def changes(self) -> float:
        """Probability that scans change as the robot moves."""
        return float(1.0 - self.probability[FROZEN])

    @property
    def cause(self) -> str:
        """The likeliest kind of fault, in such words."""
        if self._no_fit > 0.5:
            return DISJOINED
        sums = [float(self.probability[a:b].sum()) for a, b in pairwise(_FIRST)]
        kind = int(np.argmax(sums))
        at = int(np.argmax(self.probability[_FIRST[kind] : _FIRST[kind + 1]]))
        if _FIRST[kind] == MOUNT_TURNED:
            return _KINDS[kind].name.format(round(degrees(wrap(float(TURNED[at])))))
        return _KINDS[kind].name.format(float(LATE_BY[at]) if _FIRST[kind] >= LATE else 0.0)

    def restart(self) -> None:
        """Odometry's stamps begin again."""
        self._past, self._seen = PastOdometry(LATEST_S, LATE_STEP_S), PastScans(LATEST_S, LATE_STEP_S)

    def take_apart(self) -> None:
        """Two scans that must have much in common do not fit each other."""
        likelihood = np.full(_STATES, NO_FIT)
        likelihood[UNRELATED] = NO_FIT_UNRELATED
        self._weigh(np.log(likelihood))
        self._no_fit += NEWEST * (1.0 - self._no_fit)
        self._mount.suspect_any()

    def take_far(self, scans: Pose, driven: Motion) -> None:
        """The motion between two scans is too large to be found surely."""
        self._mount.suspect_turn(scans[2], driven.delta[2])

    def take(
        self, scans: Pose, spread: tuple[float, float, float], turn_variance: float, driven: Motion,
        since: int, trail: OdometryTrail, follows: bool = False,
    ) -> bool:  # fmt: skip
        """Takes the motion over an interval from `since`, ns, by scans and odometry; gives if they agree.

        `spread` is the covariance xx, xy, yy [m^2] of the scans' way. Where the scans have followed from each
        other since the interval before, they `follow`: then they did not become another lidar's.
        """
        self._no_fit *= 1.0 - NEWEST
        self._past.take(since, driven.seconds, trail)
        if scans != IDENTITY:  # a repeated scan shows no motion of the lidar
            self._seen.take(since, driven.seconds, scans)
        begun = since * 1e-9
        stretch = begun, begun + driven.seconds
        predicted = _predicted(driven.delta, self._past.poses, scans, self._seen.poses, *stretch)
        by_exactness = _log_likelihoods(scans, spread, turn_variance, predicted, follows)
        # wheels slip as often where something else is wrong, too: else what agrees alike would gain
        by_exactness[:, FROZEN:] += log(1.0 - SLIPS)
        anyhow = by_exactness[:, [UNRELATED]] + log(1.0 - GOES_ON)
        for first, past in self._off_time:
            guessed = first + np.flatnonzero(begun - LATE_BY < past.known_since)
            by_exactness[:, guessed] = np.logaddexp(by_exactness[:, guessed] + log(GOES_ON), anyhow)
        # an interval may turn as exactly as any: one that is less exact is no fault. The way counts by its
        # whole sigma, for in a bare hallway a fit may find that the robot stood
        turns = by_exactness[: len(SHARES)].copy()
        turns[:, INEXACT] = turns[0, INEXACT]
        chances = self._weigh(np.logaddexp.reduce(turns, axis=0), follows=follows)[RIGHT]
        if _stands(predicted[AGREE]):  # how exact a motion is that there is shows none of another
            by_exactness[:] = by_exactness[0]
        right = np.logaddexp.reduce(by_exactness[:, RIGHT] + np.log(chances / chances.sum()), axis=1)
        self._set_up.take(by_exactness[:, WRONG_SET_UPS], right, self._is_wrong()[WRONG_SET_UPS])
        for way, state in enumerate((AGREE, BACKWARDS)):
            self._ways[way] += driven.way * float(self.probability[state])
        if scans != IDENTITY:
            self._mount.suspect_turn(scans[2], driven.delta[2])
            # wheels that slip, or a lidar that is late, show nothing of the mount
            if self.agrees >= 0.5 and not _stands(predicted[AGREE]):
                self._mount.take(scans, spread, driven.delta, driven.way)
                self._turning.take(scans[2], turn_variance, driven.delta[2], driven.seconds)
        if self.backwards and not self.without_sign:
            self.without_sign = True
            self._change[AGREE, AGREE] += BACKS - BACKS_KNOWN
            self._change[AGREE, BACKWARDS] = BACKS_KNOWN
            self._bound = _bound(self._change)
        return bool(by_exactness[0, AGREE] >= by_exactness[0, SLIPPING])

    @property
    def _off_time(self) -> tuple[tuple[int, PastOdometry | PastScans], ...]:
        """First state of late scans, and of early ones, with the past that they are held against."""
        return (LATE, self._past), (EARLY, self._seen)

    def _is_wrong(self) -> Flags:
        """In which states (n,) a pose of now is wrong: wrong stamps do no harm where a robot hardly moved."""
        wrong = np.ones(_STATES, dtype=np.bool_)
        for first, past in self._off_time:
            way, turn = past.moved(LATE_BY)
            wrong[first : first + len(LATE_BY)] = (way > NEAR_M / 2.0) | (turn > NEAR_RAD / 2.0)
        return wrong

    def _weigh(self, log_likelihood: Array, *, follows: bool = False) -> Array:
        """Weighs the states by what was seen (n,); gives how probable each was before that."""
        changed: Array = self.probability @ (self._bound if follows else self._change)
        weighed = changed * np.exp(log_likelihood - log_likelihood.max())
        self.probability = weighed / weighed.sum()
        return changed


@njit("UniTuple(f8, 3)(f8[:,:], f8)", cache=True)  # pragma: no cover - compiled
def _at(passed: Array, stamp: float) -> Pose:
    after = min(max(int(np.searchsorted(passed[:, 0], stamp)), 1), len(passed) - 1)
    a, b = passed[max(after - 1, 0)], passed[after]
    share = min(max((stamp - a[0]) / max(b[0] - a[0], 1e-9), 0.0), 1.0)
    return a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2]), a[3] + share * (b[3] - a[3])


@njit("UniTuple(f8, 3)(f8[:,:], f8, f8)", cache=True)  # pragma: no cover - compiled
def _moved(passed: Array, since: float, until: float) -> Pose:
    """Motion between two stamps, s; NaN before the first."""
    if not len(passed) or since < passed[0, 0]:
        return np.nan, np.nan, np.nan
    start, end = _at(passed, since), _at(passed, until)
    c, s = np.cos(start[2]), np.sin(start[2])
    dx, dy = end[0] - start[0], end[1] - start[1]
    return c * dx + s * dy, c * dy - s * dx, end[2] - start[2]


@njit(  # pragma: no cover - compiled
    "f8[:,::1](UniTuple(f8, 3), f8[:,:], UniTuple(f8, 3), f8[:,:], f8, f8)", cache=True
)
def _predicted(moved: Pose, passed: Array, scans: Pose, seen: Array, since: float, until: float) -> Array:
    """Motion of the scans (n, 3) that each state predicts from odometry's; NaN where one predicts none.

    `passed` and `seen` (m, 4) are where odometry and scans were: s, m, m, rad. Of early scans, what is
    predicted is odometry's motion: it counts by how far it is off.
    """
    x, y, turn = moved
    result = np.empty((_STATES, 3))
    result[:, 0], result[:, 1], result[:, 2] = x, y, turn
    result[FROZEN] = 0.0
    for state in (BACKWARDS, REVERSED):
        result[state, 0], result[state, 1] = -x, -y
    result[MIRRORED, 1], result[MIRRORED, 2] = -y, -turn
    for i in range(len(TURNED)):
        c, s = np.cos(TURNED[i]), np.sin(TURNED[i])
        result[MOUNT_TURNED + i, 0], result[MOUNT_TURNED + i, 1] = c * x - s * y, s * x + c * y
    result[UNRELATED] = result[ODOMETRY_STANDS] = np.nan
    for i in range(len(LATE_BY)):
        result[LATE + i] = _moved(passed, since - LATE_BY[i], until - LATE_BY[i])
        early = _moved(seen, since - LATE_BY[i], until - LATE_BY[i])
        result[EARLY + i] = (
            scans[0] + early[0] - x, scans[1] + early[1] - y, scans[2] + early[2] - turn
        )  # fmt: skip
    return result


@njit("b1(f8[:])", cache=True)  # pragma: no cover - compiled
def _stands(moved: Array) -> bool:
    """Whether odometry hardly shows a motion (3,)."""
    return bool(abs(moved[0]) + abs(moved[1]) < QUIET_M and abs(moved[2]) < QUIET_RAD)


@njit(  # pragma: no cover - compiled
    "f8[:,::1](UniTuple(f8, 3), UniTuple(f8, 3), f8, f8[:,::1], b1)", cache=True
)
def _log_likelihoods(
    scans: Pose, spread: tuple[float, float, float], turn_variance: float, predicted: Array, follows: bool
) -> Array:
    """Ln of the density (e, n) of the scans' motion by exactness in each state, `predicted` (n, 3).

    Faults with the covariance of agreement: one that predicts less motion does not predict it more exactly. A
    frozen lidar is excluded by its own, smaller one, too.
    """
    x, y, turn = predicted[AGREE]
    way, turned = max(np.hypot(scans[0], scans[1]), np.hypot(x, y)), max(abs(scans[2]), abs(turn))
    anyhow = unpredicted(scans, spread, turn_variance)
    # p(scans) p(odometry | scans before) / p(odometry): where odometry pauses, any pause of scans fits.
    # That odometry is noisier than scans makes it no likelier
    early = min(0.0, anyhow - unpredicted((x, y, turn), spread, turn_variance))
    along, aside = SLIP_M + SLIP_SHARE * way, SIDEWAYS + SIGMA_SHARE * way
    slid = spread[0] + along**2, spread[1], spread[2] + aside**2
    slipped = log_gaussian(
        scans[0] - x, scans[1] - y, scans[2] - turn,
        slid, turn_variance, 0.0, SLIP_RAD + SLIP_SHARE * turned,
    )  # fmt: skip
    if follows:  # any other motion of theirs is the robot's; that of none rather is a frozen lidar's
        standing = log_gaussian(
            scans[0], scans[1], scans[2], spread, turn_variance, SIGMA_M, SIGMA_RAD
        )  # fmt: skip
        moving = 2.0 * anyhow - np.logaddexp(anyhow, standing)
        slipped = np.logaddexp(slipped, moving) - log(2.0)
    result = np.empty((len(EXACT), len(predicted)))
    for i in range(len(EXACT)):
        row, (of_way, of_turn) = result[i], EXACT[i]
        sigma = of_way * (SIGMA_M + SIGMA_SHARE * way)
        turn_sigma = of_turn * (SIGMA_RAD + SIGMA_SHARE * turned)
        for state in range(len(predicted)):
            if np.isnan(predicted[state, 0]):
                row[state] = anyhow
                continue
            near = log_gaussian(
                scans[0] - predicted[state, 0], scans[1] - predicted[state, 1],
                scans[2] - predicted[state, 2], spread, turn_variance, sigma, turn_sigma,
            )  # fmt: skip
            if state == FROZEN:  # how far the robot drives excuses no motion of its scans
                near = min(near, log_gaussian(
                    scans[0], scans[1], scans[2], spread, turn_variance, of_way * SIGMA_M, of_turn * SIGMA_RAD
                ))  # fmt: skip
            elif state >= EARLY:
                near += early
            row[state] = np.logaddexp(near + log(1.0 - ODD), anyhow + log(ODD))
        row[SLIPPING] = slipped
        if abs(turn) > 2.0 * SIGMA_RAD:
            row[ALIKE] = np.logaddexp(row[AGREE] + log(TURNS_ALIKE), anyhow + log(1.0 - TURNS_ALIKE))
        if not _stands(predicted[AGREE]):
            row[ODOMETRY_STANDS] += log(ODD)
    return result
