"""How well a lidar's set-up is proven: by the robot's own motion since the start, against each wrong set-up.

A lidar whose mount is turned, which is mirrored, late or frozen shows a place as right as any until the robot
moves in the way that tells it apart. How often robots are set up wrongly is not known, and each in its own
way, so the worst case counts: that all of those that are set up wrongly, WRONG of all, are so in the way that
motion has excluded least. Then no confidence exceeds 0.9 before each is excluded.
"""

from __future__ import annotations

from math import exp, log

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

WRONG = 0.1
"""Share of robots in new set-ups that are set up wrongly. In each way at most: a robot that was never seen to
turn may be mirrored.
"""
BEGINS, ENDS = 5e-4, 0.002
"""Chances, an interval, that each kind of sensor fault begins, and that it ends."""
PROVEN = 0.99
"""Probability from which a set-up counts as proven.

A wrong one gets there with at most a chance of 1 in 11, however long one looks (Ville's inequality).
"""
FARTHEST = 700.0
"""Beyond it, exp has no number."""


class SetUp:
    """Log-likelihoods of wrong set-ups, each there from the start, against that of a right one.

    How exact a robot's odometry and scans are is not known, either. A right set-up counts as the mean over
    how exact they may be, a wrong one as the likeliest. So the chance above holds however exact they are
    (Wasserman, Ramdas and Balakrishnan, "Universal inference", PNAS 2020).
    """

    def __init__(self, states: int, exactness: int) -> None:
        self._wrong, self._right = np.zeros((exactness, states)), np.zeros(exactness)
        self.proven = 1.0 - WRONG
        """Probability of a right set-up."""

    def take(self, wrong: Array, right: Array, matters: Flags) -> None:
        """Takes an interval's log-likelihoods by exactness, the least first: (e, n), of a right set-up (e,).

        `matters` (n,): which of the wrong ones make a pose after the interval wrong.
        """
        self._wrong += wrong
        self._right += right
        self.proven = self._proven(matters)

    def _proven(self, matters: Flags) -> float:
        """Probability of a right set-up: what the worst wrong one leaves of it, once it is excluded.

        Before it is no more than at first: what happens to agree by chance is no proof. It is less where the
        wrong ones, any as probable, explain the motion of a least exact robot better than a right one does.
        """
        wrong = self._wrong[:, matters]
        worst = float(wrong.max()) - float(np.logaddexp.reduce(self._right)) + log(len(self._right))
        right = right_share(worst)
        if right >= PROVEN:
            return right
        usual = float(np.logaddexp.reduce(wrong[0])) - log(len(wrong[0])) - float(self._right[0])
        return min(right_share(usual), 1.0 - WRONG)


def right_share(against: float) -> float:
    """Probability of a right set-up of which wrong ones have such a log-likelihood ratio."""
    return 1.0 / (1.0 + WRONG / (1.0 - WRONG) * exp(min(against, FARTHEST)))
