"""How well a lidar's set-up is proven: by the robot's own motion since the start, against each wrong set-up.

A lidar whose mount is turned, which is mirrored, late or frozen shows a place as right as any until the robot
moves in the way that tells it apart. How often robots are set up wrongly is not known, and each in its own
way, so the worst case counts: that all of those that are set up wrongly, WRONG of all, are so in the way that
motion has excluded least. Then no confidence exceeds 0.9 before each is excluded.
"""

from __future__ import annotations

from math import exp

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Flags = NDArray[np.bool_]

WRONG = 0.1
"""Share of robots in new set-ups that are set up wrongly. In each way at most: a robot that was never seen to
turn may be mirrored.
"""
PROVEN = 0.99
"""Probability from which a set-up counts as proven.

A wrong one gets there with at most a chance of 1 in 11, however long one looks (Ville's inequality).
"""
FARTHEST = 700.0
"""Beyond it, exp has no number."""


class SetUp:
    """Log-likelihoods of wrong set-ups, each there from the start, against that of a right one."""

    def __init__(self, states: Index) -> None:
        self._states = states
        """Those of wrong set-ups."""
        self._ratio = np.zeros(len(states))
        self._wrong = np.ones(len(states), dtype=np.bool_)
        """Which of them would make a pose wrong now."""

    @property
    def proven(self) -> float:
        """Least probability of a right set-up, over all that robots may be set up wrongly.

        Before it is PROVEN no more than at first: what happens to agree by chance is no proof.
        """
        worst = min(float(self._ratio[self._wrong].max()), FARTHEST)
        right = 1.0 / (1.0 + WRONG / (1.0 - WRONG) * exp(worst))
        return right if right >= PROVEN else min(right, 1.0 - WRONG)

    def take(self, log_likelihood: Array, right: float, wrong: Flags) -> None:
        """Takes the log-likelihoods of an interval in each state and in a right set-up.

        `wrong`: in which states a pose after the interval is wrong.
        """
        self._ratio += log_likelihood[self._states] - right
        self._wrong = wrong[self._states]
