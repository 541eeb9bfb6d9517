"""Whether two scans can be neighbours at all.

Wrong hypotheses, too, go on from scan to scan as odometry moves: the building still looks the same. Where
none of a list goes on in the next one, the sensor was covered or uncovered, or the robot was carried away.
But not if the scans themselves show the motion that odometry shows: then the map lacks what they see.
"""

from __future__ import annotations

from math import exp, hypot

import numpy as np
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.planar import IDENTITY, Pose
from eigenscan.tracker.symmetric import ROWS, apart, wrapped
from numba import njit, types
from numpy.typing import NDArray

Array = NDArray[np.float64]

COMPARED = 10
"""Hypotheses of the earlier list, likeliest first."""
ENOUGH = 5
"""Fewer are no evidence."""
NEAR_M, NEAR_RAD = 0.3, 0.1
"""Farther from where it was predicted a hypothesis does not go on an earlier one."""
THICK_M = 0.25
"""m, so much farther between lists that fit the faces of thick walls and their middles: all poses move by
half a wall's thickness, here of half a metre.

A scan of elsewhere fits no better one way than the other, so the scans of a robot that is carried off often
change from one to the other: benchmarks/mechanisms.py --without "kidnaps where lists fit other surfaces".
"""
ODOMETRY_SHARE = 0.5
"""Of the way and the turn between two scans, what odometry may err by here."""
FARTHEST_M, FARTHEST_RAD, LONGEST_S = 1.0, 1.0, 0.25
"""Beyond this way, turn, or time without odometry, two scans are not compared."""
BY_CHANCE = 4.0
"""So many of a list go on about as often where the robot was carried elsewhere as where it was not."""
LEAST = 0.03
"""That ratio at least: a few are carried on along the same hallway."""
PARTS = 30.0
"""How much oftener scans do not follow from each other where the robot was carried elsewhere.

So it is at all kidnaps, and without one between 2.7 % of the lists of fr079, at most 0.07 % of five other
logs: benchmarks/mechanisms.py.
"""
FAR_NONE, FAR_SOME = 10.0, 0.1
"""That ratio between lists farther apart, where none goes on, and where some do: one in ten lists of what
the map lacks has none in common with the one before."""


def goes_on(before: Array, after: Array, moved: Motion, shift: float = 0.0) -> int | None:
    """How many of a list's COMPARED likeliest (n, 3) go on in the next one (k, 3), both likeliest first.

    `shift`, m: so far all poses may have moved besides. Of shorter lists as many as of COMPARED would. None
    where they cannot be compared: too few of them, or too much between them.
    """
    if len(before) < ENOUGH or len(after) < ENOUGH:
        return None
    if moved.way > FARTHEST_M or moved.turn > FARTHEST_RAD or abs(moved.unknown) > LONGEST_S:
        return None
    earlier = before[:COMPARED]
    near, turned = NEAR_M + shift + ODOMETRY_SHARE * moved.way, NEAR_RAD + ODOMETRY_SHARE * moved.turn
    share = going_on(earlier, after, near, turned, moved.delta) / min(len(earlier), len(after))
    return min(round(COMPARED * share), COMPARED)


def are_neighbours(moved: Motion) -> bool:
    """Whether two lists are so near to each other that hardly anything of the one is missing in the other."""
    return moved.way <= NEAR_M and moved.turn <= NEAR_RAD


def is_broken(count: int | None, moved: Motion, parts: bool | None) -> bool:
    """Whether the robot was carried off between two lists of which `count` of COMPARED go on.

    `parts`: whether its scans do not follow from each other; else the map lacks what they show. None: nobody
    watches, so that only lists near to each other show it.
    """
    return count == 0 and (are_neighbours(moved) if parts is None else parts)


def carried_ratio(count: int | None, moved: Motion, parts: bool | None) -> float:
    """How much oftener `count` of a list go on where the robot was carried elsewhere than where it was not.

    And how much oftener its scans do not follow from each other, if `parts`. Where it was not, eight or nine
    of ten go on. A line through the logarithms of what ten logs have in common (benchmarks/evidence.py).
    """
    apart = PARTS if parts else 1.0
    if count is None:
        return apart
    if are_neighbours(moved):
        return apart * max(exp(BY_CHANCE - count), LEAST)
    return apart * (FAR_SOME if count else FAR_NONE)


def going_on(before: Array, found: Array, near: float, turned: float, delta: Pose = IDENTITY) -> int:
    """How many of `before` (n, 3), moved by `delta`, have one of `found` (k, 3) near.

    Within `near` m and `turned` rad.
    """
    return int(_count_near(before, found, near, turned, *delta))


_NUMBER = types.float64


@njit(  # pragma: no cover - compiled
    types.int64(ROWS, ROWS, _NUMBER, _NUMBER, _NUMBER, _NUMBER, _NUMBER), cache=True, nogil=True
)
def _count_near(
    before: Array, found: Array, near: float, turned: float, ahead: float, left: float, turn: float
) -> int:
    count, expected = 0, np.empty(3)
    for i in range(len(before)):
        cos, sin = np.cos(before[i, 2]), np.sin(before[i, 2])
        expected[0] = before[i, 0] + cos * ahead - sin * left
        expected[1] = before[i, 1] + sin * ahead + cos * left
        expected[2] = wrapped(before[i, 2] + turn)
        for k in range(len(found)):
            if abs(found[k, 0] - expected[0]) > near:
                continue  # most are far away
            x, y, off = apart(found[k], expected)
            if hypot(x, y) <= near and abs(off) <= turned:
                count += 1
                break
    return count
