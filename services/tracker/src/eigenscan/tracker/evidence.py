"""The evidence of a scan for a track that was there before it.

A track is a prediction, and a place that is wrong but looks like the right one goes on looking like it. So a
hypothesis that lies where a track was predicted is no news as such: it is evidence by how much oftener a
right track gets one of its likelihood than a wrong track does. A right track in turn may be hidden: where the
map shows little of the room, the projector misses it for metres, and then for each scan alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from eigenscan.geometry.inner import inner
from eigenscan.geometry.symmetric import determinant, inverse, plus, square, triangle
from eigenscan.tracker.association import Pairs
from eigenscan.tracker.observation import Observation, poorness_each
from eigenscan.tracker.symmetric import ROWS, WEIGHTS, apart
from eigenscan.tracker.tracks import Columns
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

LEAD, BEHIND, MOST = 0.8, 0.4, 5.0
"""ln of that ratio is LEAD for each nat that a hypothesis is ahead of the next place, BEHIND for each that it
is behind the best.

So it is on exact, thick and smeared maps alike: what makes one place likely makes others likely, too. Of many
rooms alike the right one is behind by a nat or two in most scans: LEAD for these as well lost the robot, and
so did a share of the likelihood itself. At most MOST either way. Rounded from what five buildings have in
common, and two of rooms alike: benchmarks/evidence.py --way, --buildings.
"""

TOGETHER = 0.4
"""The same for each nat that several places of a list are ahead of its next, less ln of how many they are.

One of them is likely right, but not which: that the best two are equal speaks for neither against the other,
yet for both against a track that the list does not show. With as much as LEAD, an invented room is claimed
(benchmarks/mechanisms.py --fault "an invented room").
"""


NEAR_M, NEAR_RAD = 0.5, float(np.radians(10.0))
"""Poses this near to each other are of one place."""
ALIKE_M = 3.0
"""m, within which hypotheses of one heading may be one place along a hallway (benchmarks/mechanisms.py)."""
SHOWN_YET_MISSED = -6.0
"""The same for a track without a hypothesis, were it shown: next to impossible."""
HIDES, SHOWS = 0.05, 0.07
"""Of shown tracks that hide, and of hidden ones that show, over the way that makes a scan new evidence.

The rates that make what right tracks met on 17 maps most likely, exact and worse: benchmarks/evidence.py.
"""
EMERGES = 0.2
"""Of the poses on the map that a list left out and no track holds, how many the next has, over that way.

A track may be listed and yet have little for it; these were not listed at all. On intel and fr079 with 30 %
of the walls missing, 17 to 19 % of them are not for eight times that way: benchmarks/evidence.py.
"""


ALIASES, ENDS = 0.02, 0.25
"""Of the wrong tracks those that the building shows as it would show right ones; over the way that makes a
scan new evidence, how many of these it ceases to.

More than most buildings have, 0.1 to 1.3 %, and fewer end, of 35 %: benchmarks/evidence.py. Else one that
lasts takes the claim from a robot that is hidden (benchmarks/evaluate.py --only intel).
"""


SLIPS = 0.02
"""Of the tracks, how many odometry misleads by more than its noise, over the way that makes a scan new
evidence. As many over less: lists that follow each other closely are not told apart."""
SLIP_M, SLIP_RAD, SLIP_SHARE = 0.1, 0.1, 1.0
"""Sigma of what it is then off by: this much, and this share of the way and of the turn."""
LEAST_MASS = float(np.log(1e-4))
"""Of tracks, below which their slipping is not looked at."""


class Constants(NamedTuple):
    """What compiled code is given of the constants, so that a benchmark can leave a mechanism out."""

    lead: float
    behind: float
    most: float
    shown_yet_missed: float
    hides: float
    shows: float
    emerges: float
    aliases: float
    ends: float
    slips: float
    poorer: float
    least_new: float
    kept: float
    misses: float
    off_map_share: float
    carried_share: float
    alike_m: float
    together: float


class Scan(NamedTuple):
    """What compiled code is given of a scan's `Share`, by the same names; its `source` and `stamp`."""

    weight: float
    progress: float
    precision: float
    carried: float
    broken: bool
    in_part: bool
    first: bool
    source: int
    stamp: int


class Listed(NamedTuple):
    """Hypotheses (k,) of a list that are likelier than a pose outside it, and what each is worth in nats.

    `widened` (k, 3, 3): covariances with what the list cannot tell from them nearby, see `widened_each`.
    `alone`: ln p(list | the robot is there) / p(list | it is off the map), for a pose that nothing predicted.
    `predicted`: ln p(hypothesis | its track is right) / p(hypothesis | it is wrong), where a track was just
    there. `alias` (k,): of the wrong tracks that it begins, how many are aliases.
    """

    poses: Array
    covariances: Array
    widened: Array
    alone: Array
    predicted: Array
    alias: Array


def likelihood_at(pose: Array, seen: Observation) -> float:
    """Log-likelihood of the likeliest hypothesis at a pose (3,); 0 without one."""
    return float(_likelihood_at(pose, seen.poses, seen.log_likelihoods))


@inner()  # pragma: no cover - compiled
def is_near(y: Array, x: Array) -> bool:
    """Whether two poses (3,) are of one place."""
    if abs(y[0] - x[0]) > NEAR_M:
        return False  # most are far away
    ahead, left, turn = apart(y, x)
    return bool(np.hypot(ahead, left) <= NEAR_M and abs(turn) <= NEAR_RAD)


@njit((WEIGHTS, ROWS, WEIGHTS), cache=True)  # pragma: no cover - compiled
def _likelihood_at(pose: Array, poses: Array, log_likelihoods: Array) -> float:
    most = 0.0
    for k in range(len(poses)):
        if log_likelihoods[k] > most and is_near(poses[k], pose):
            most = log_likelihoods[k]
    return most


@inner()  # pragma: no cover - compiled
def listed(poses: Array, covariances: Array, log_likelihoods: Array, unlisted: float, c: Constants) -> Listed:
    """What hypotheses are worth; those that are no likelier than an unlisted pose are left out.

    alone = L + lead, where ahead, - ln(how much larger a poor fit's volume is): that it may be of more poses
    makes the place no likelier. predicted = LEAD or BEHIND times lead. Aliases follow from their share by
    Bayes' rule.
    """
    kept = np.flatnonzero(log_likelihoods > unlisted + 1e-9)
    y, R, L = poses[kept], covariances[kept], log_likelihoods[kept]
    place, best = places(y, L)
    lead = leads(place, L, best, unlisted)
    alone = L + np.minimum(np.maximum(lead, 0.0), c.most) - 1.5 * poorness_each(L, c.poorer)
    predicted = np.where(lead > 0.0, c.lead, c.behind) * lead + together(best, c)[place]
    predicted = np.minimum(np.maximum(predicted, -c.most), c.most)
    alias = 1.0 / (1.0 + np.exp(-(np.log(c.aliases / (1.0 - c.aliases)) + predicted)))
    return Listed(y, R, widened_each(y, R, L, c.alike_m), alone, predicted, alias)


@inner()  # pragma: no cover - compiled
def widened_each(poses: Array, covariances: Array, log_likelihoods: Array, reach: float) -> Array:
    """Covariances (k, 3, 3) with the spread of hypotheses within `reach`, m, of one heading.

    Along a hallway a scan fits in many places, each as sharp as if it were the only one. What the scan shows
    of the way along is their mixture: its second moment around each, weighed by likelihood.
    """
    out = covariances.copy()
    moment = np.empty((3, 3))
    for k in range(len(poses)):
        total, moment[:] = 0.0, 0.0
        for i in range(len(poses)):
            if abs(poses[i, 0] - poses[k, 0]) > reach or abs(poses[i, 1] - poses[k, 1]) > reach:
                continue  # most are far away
            off = apart(poses[i], poses[k])
            if np.hypot(off[0], off[1]) <= reach and abs(off[2]) <= NEAR_RAD:
                weight = np.exp(log_likelihoods[i] - log_likelihoods[k])
                total += weight
                for row in range(3):
                    for column in range(3):
                        moment[row, column] += weight * off[row] * off[column]
        for row in range(3):
            for column in range(3):
                out[k, row, column] += moment[row, column] / total
    return out


@inner()  # pragma: no cover - compiled
def places(poses: Array, log_likelihoods: Array) -> tuple[Index, Array]:
    """Which place each hypothesis (k,) is of, the likeliest first, and the likelihood of each place (m,)."""
    place, first = np.empty(len(poses), dtype=np.intp), np.empty(len(poses), dtype=np.intp)
    count = 0
    for k in np.argsort(-log_likelihoods, kind="mergesort"):
        place[k] = count
        for own in range(count):
            if is_near(poses[k], poses[first[own]]):
                place[k] = own
                break
        if place[k] == count:
            first[count], count = k, count + 1
    return place, log_likelihoods[first[:count]]


@inner()  # pragma: no cover - compiled
def leads(place: Index, log_likelihoods: Array, best: Array, unlisted: float) -> Array:
    """By how many nats (k,) hypotheses are ahead of the next place; those of other places behind the best."""
    if not len(best):
        return np.zeros(0)
    next_place = max(unlisted, best[1]) if len(best) > 1 else unlisted
    lead: Array = log_likelihoods - np.where(place == 0, next_place, best[0])
    return lead


@inner()  # pragma: no cover - compiled
def together(best: Array, c: Constants) -> Array:
    """What it is worth, nats (m,), to be one of several places that are ahead of others together.

    `best` (m,): their likelihoods, the best first. Of its groups a place counts the one that is worth most.
    """
    worth, most = np.zeros(len(best)), 0.0
    for j in range(len(best) - 1, 1, -1):
        most = max(most, min(c.together * (best[j - 1] - best[j]), c.most) - np.log(j))
        worth[j - 1] = most
    worth[:1] = most
    return worth


@inner()  # pragma: no cover - compiled
def hide_and_show(hidden: float, progress: float, c: Constants) -> float:
    """A track's hidden share after a robot moved on by `progress`, 1: a scan is new evidence."""
    hides, shows = -np.expm1(-c.hides * progress), -np.expm1(-c.shows * progress)
    return float(hidden * (1.0 - shows) + (1.0 - hidden) * hides)


@inner()  # pragma: no cover - compiled
def aliases_go_on(alias: Array, progress: float, c: Constants) -> Array:
    """Aliases (n,) after a robot moved on by `progress`, 1: a scan is new evidence; see `Tracks`."""
    goes_on = np.exp(-c.ends * progress)
    begins = c.aliases * max(1.0 - alias.sum(), 0.0)
    out: Array = alias * goes_on + begins * (1.0 - goes_on)
    return out


@inner()  # pragma: no cover - compiled
def at_most_one(alias: Array) -> None:
    """Of all tracks at most one is an alias (n,); in place."""
    alias /= max(alias.sum(), 1.0)


@inner(error_model="numpy")  # pragma: no cover - compiled
def explained_by_aliases(alias: Array, gained: Array, elsewhere: Array) -> tuple[float, Array, Array]:
    """How much likelier aliases make a scan, in nats, where no track (n,) is right.

    Then the same (n,) where each track is right, but hidden; and the aliases (n,) after the scan.
    Of an alias it is as likely as of a right track, `gained` (n,): what looked right goes on looking right.
    One that another source shows may be hidden from this one, with the probability `elsewhere` (n,).
    """
    odds = alias * (elsewhere + (1.0 - elsewhere) * np.exp(gained))
    total = max(1.0 - alias.sum(), 1e-12) + odds.sum()
    others = (total - odds) / np.maximum(1.0 - alias, 1e-12)
    return np.log(total), np.log(np.maximum(others, 1e-12)), odds / total


@inner(error_model="numpy")  # pragma: no cover - compiled
def slipped(t: Columns, seen: Listed, pairs: Pairs, progress: float, c: Constants) -> Array:
    """Ln of the mass of tracks whose wheels have slipped, to each of the hypotheses (k,) seen.

    A track has not slipped to those in its gate, `pairs`. As there, a hypothesis nearby is worth no more
    than how much oftener a right track gets one than a wrong track does. If the robot slipped just now, the
    track was shown where it was predicted by chance: then its present place's evidence does not count. The
    farther the robot came since the last list, `progress`, the likelier it slipped: no scan corrected that.
    """
    out = np.full(len(seen.poses), -np.inf)
    pair = 0
    for i in range(len(t.x)):
        log_mass = t.log_weight[i] - np.maximum(t.evidence[i], 0.0).sum()
        way, turn = SLIP_M + SLIP_SHARE * t.unchecked[i, 2], SLIP_RAD + SLIP_SHARE * t.unchecked[i, 3]
        spread = plus(triangle(t.C[i]), (way * way, 0.0, 0.0, way * way, 0.0, turn * turn))
        for k in range(len(out)):
            in_gate = pair < len(pairs.track) and pairs.track[pair] == i and pairs.hypothesis[pair] == k
            if in_gate:
                pair += 1
            if in_gate or log_mass <= LEAST_MASS:
                continue
            own = triangle(seen.covariances[k])
            total = plus(spread, own)
            # the hypothesis' volume by the density that the slipped track has there
            overlap = 0.5 * np.log(determinant(own) / determinant(total))
            overlap -= 0.5 * square(inverse(total), apart(seen.poses[k], t.x[i]))
            out[k] = log_sum(out[k], log_mass + min(seen.predicted[k], seen.alone[k] + overlap))
    result: Array = np.log(-np.expm1(-c.slips * max(progress, 1.0))) + out
    return result


@inner()  # pragma: no cover - compiled
def log_sum(a: float, b: float) -> float:
    """Ln of the sum of two masses that are given as logarithms."""
    most = max(a, b)
    if most == -np.inf:
        return most
    return float(most + np.log1p(np.exp(min(a, b) - most)))
