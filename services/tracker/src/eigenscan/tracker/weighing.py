"""The belief's step with a list, compiled, on plain arrays: what Python would spend on small arrays is most.

Masses are logarithms. `Rest` is what no track holds; it is changed in place, and tracks are made anew.
The readable form in numpy is in tests/services/tracker/readable.py.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from eigenscan.geometry.inner import inner
from eigenscan.geometry.symmetric import MATRICES, determinant, triangle
from eigenscan.tracker.association import Pairs, within_gate
from eigenscan.tracker.branching import births, branch, raise_to
from eigenscan.tracker.evidence import Constants, Listed, Scan, at_most_one, listed, log_sum, slipped
from eigenscan.tracker.symmetric import ROWS, WEIGHTS
from eigenscan.tracker.tracks import GIVEN, MADE, Arrays, Columns, joined, taken
from numba import njit, types
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Rest(NamedTuple):
    """The arrays of `Elsewhere` in compiled code, which changes them."""

    log_weight: Array
    area: Array
    searched: Array


_NUMBERS, _TABLE = types.float64[::1], types.float64[:, ::1]
_REST = (_NUMBERS, _NUMBERS, _TABLE)
_NUMBER, _COUNT = types.float64, types.int64


@inner(error_model="numpy")  # pragma: no cover - compiled
def _take(rest: Rest, part: int, mass: float) -> None:
    """Adds mass that no list was of yet."""
    if mass <= 0.0:
        return
    stayed = np.exp(rest.log_weight[part])
    rest.log_weight[part] = np.log(stayed + mass)
    for source in range(rest.searched.shape[1]):
        rest.searched[part, source] *= stayed / (stayed + mass)


@inner(error_model="numpy")  # pragma: no cover - compiled
def _release(log_weight: Array, rest: Rest, share: float, off_map_share: float) -> None:
    """Moves a share of the tracks' mass (n,) to "none", in place."""
    if not len(log_weight) or share == 0.0 or len(rest.area) < 2:
        return
    freed, area = share * np.exp(log_weight).sum(), rest.area.sum()
    _take(rest, 0, freed * off_map_share)
    for part in range(1, len(rest.area)):
        _take(rest, part, freed * (1.0 - off_map_share) * rest.area[part] / area)
    log_weight += np.log1p(-share)


@njit(_NUMBERS(WEIGHTS, *_REST, _NUMBER, _NUMBER), cache=True, error_model="numpy")  # pragma: no cover
def jumped(
    log_weight: Array, rest_log_weight: Array, area: Array, searched: Array, share: float, off_map: float
) -> Array:
    """The tracks' masses (n,) less a share that goes to "none"."""
    left = log_weight.copy()
    _release(left, Rest(rest_log_weight, area, searched), share, off_map)
    return left


@njit(types.void(*_REST, _NUMBER), cache=True, error_model="numpy")  # pragma: no cover - compiled
def returned(log_weight: Array, area: Array, searched: Array, share: float) -> None:
    """Moves a share of the mass off the map back onto it."""
    if len(area) < 2 or share <= 0.0:
        return
    rest = Rest(log_weight, area, searched)
    back, total = share * np.exp(log_weight[0]), area[1:].sum()
    for part in range(1, len(area)):
        _take(rest, part, back * area[part] / total)
    log_weight[0] += np.log1p(-share)


@njit(types.void(_NUMBERS, _NUMBERS), cache=True, error_model="numpy")  # pragma: no cover - compiled
def normalise(tracks: Array, rest: Array) -> None:
    """Makes masses, as logarithms (n,) and (f,), sum to 1, in place."""
    total = -np.inf
    for part in tracks:
        total = log_sum(total, part)
    for part in rest:
        total = log_sum(total, part)
    if total == -np.inf:
        # the last track ended: nothing is left but that nothing is known
        rest[-1] = 0.0
        return
    tracks -= total
    rest -= total


@inner(error_model="numpy")  # pragma: no cover - compiled
def _move_on(tracks: Columns, rest: Rest, scan: Scan, c: Constants) -> None:
    """What becomes of the belief since the source's last list, in place.

    As the robot moves on, what was seen at the last place speaks for a track for good. If the robot was
    carried away, or the sensor covered or uncovered, the tracks start a new place.
    """
    stay = np.exp(-scan.progress)
    for row in range(len(tracks.x)):
        tracks.evidence[row, scan.source] *= stay
    _release(tracks.log_weight, rest, scan.carried, c.off_map_share)
    if scan.broken:
        _release(tracks.log_weight, rest, c.carried_share, c.off_map_share)
        rest.searched[:, scan.source] = 0.0
        for row in range(len(tracks.x)):
            tracks.evidence[row, scan.source], tracks.hidden[row, scan.source] = 0.0, 0.5
            tracks.alias[row] = 0.0


@inner()  # pragma: no cover - compiled
def _emerging(rest: Rest, frame: int, scan: Scan, c: Constants) -> float:
    return float(rest.searched[frame, scan.source] * -np.expm1(-c.emerges * scan.progress))


@inner(error_model="numpy")  # pragma: no cover - compiled
def _mass_alone(
    old: Columns, seen: Listed, pairs: Pairs, rest: Rest, frame: int, scan: Scan, c: Constants
) -> Array:
    """Ln of the mass (k,) of each hypothesis by itself: of robots that no track holds, or that slipped there.

    Its volume by the density of the mass that a list may find: what was not searched yet, or comes out of
    hiding.
    """
    findable = 1.0 - rest.searched[frame, scan.source] + _emerging(rest, frame, scan, c)
    density = rest.log_weight[frame] + np.log(findable / (rest.area[frame] * 2.0 * np.pi))
    alone = slipped(old, seen, pairs, scan.progress, c)
    for k in range(len(alone)):
        volume = 1.5 * np.log(2.0 * np.pi) + 0.5 * np.log(determinant(triangle(seen.covariances[k])))
        alone[k] = log_sum(alone[k], seen.alone[k] + volume + density)
    return alone


@inner(error_model="numpy")  # pragma: no cover - compiled
def _search(rest: Rest, frame: int, scan: Scan, c: Constants) -> None:
    """A list was of a frame: what is not in it is hidden, and what came out of hiding is not there."""
    if scan.in_part:
        return
    rest.log_weight[frame] += np.log1p(np.expm1(c.shown_yet_missed) * _emerging(rest, frame, scan, c))
    left = (1.0 - rest.searched[frame, scan.source]) * (1.0 - (1.0 - c.misses) * scan.weight)
    rest.searched[frame, scan.source] = 1.0 - left


@njit(  # pragma: no cover - compiled
    MADE(
        GIVEN, *_REST, ROWS, MATRICES, WEIGHTS, _NUMBER, _COUNT, _COUNT, _COUNT, _NUMBER, _NUMBER, _NUMBER,
        _NUMBER, _NUMBER, types.boolean, types.boolean, types.boolean,
        types.NamedUniTuple(_NUMBER, len(Constants._fields), Constants),
    ),
    cache=True,
    error_model="numpy",
)  # fmt: skip
def observed(
    arrays: Arrays, rest_log_weight: Array, rest_area: Array, rest_searched: Array, poses: Array,
    covariances: Array, log_likelihoods: Array, unlisted: float, frame: int, source: int, stamp: int,
    gate: float, weight: float, progress: float, precision: float, carried: float,
    broken: bool, in_part: bool, first: bool, c: Constants,
) -> Columns:  # fmt: skip
    """The tracks after a list, and what no track holds in place; `Belief.observe` in one call."""
    rest = Rest(rest_log_weight, rest_area, rest_searched)
    scan = Scan(weight, progress, precision, carried, broken, in_part, first, source, stamp)
    tracks = taken(Columns(*arrays), np.arange(len(arrays[0])))
    _move_on(tracks, rest, scan, c)
    old = taken(tracks, np.flatnonzero(tracks.frame == frame))
    others = taken(tracks, np.flatnonzero(tracks.frame != frame))
    seen = listed(poses, covariances, log_likelihoods, unlisted, c)
    track, hypothesis, distance2, log_overlap = within_gate(old.x, old.C, seen.poses, seen.covariances, gate)
    pairs = Pairs(track, hypothesis, distance2, log_overlap)
    alone = _mass_alone(old, seen, pairs, rest, frame, scan, c)
    grown = branch(old, seen, pairs, scan, c)
    raise_to(grown, len(old.x), seen, pairs, alone, scan, c)
    born = births(grown, seen, pairs, alone, frame, scan)
    result = joined(others, grown, born)
    at_most_one(result.alias)
    _search(rest, frame, scan, c)
    normalise(result.log_weight, rest.log_weight)
    return result
