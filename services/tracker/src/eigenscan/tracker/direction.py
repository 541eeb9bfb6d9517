"""Whether odometry tells which way the robot drives: encoders without a sign count backwards as forwards.

Right or wrong, hypotheses go on as the robot truly moved. Where those of a list go on in a later one as if
the way had been driven backwards, and none as odometry says, it was driven backwards.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from eigenscan.geometry.pose import compose
from eigenscan.tracker.continuity import going_on
from eigenscan.tracker.odometry import Motion
from numpy.typing import NDArray

Array = NDArray[np.float64]

COMPARED = 30
"""Hypotheses of a list, likeliest first."""
REACH_M = 0.15
"""Way ahead or back between two lists that are compared: three times what a hypothesis jitters by."""
STEP_M = 0.05
"""Way between two comparisons."""
LONGEST_NS = 1_500_000_000
"""Beyond this a list shows another place."""
NEAR_M, NEAR_RAD = 0.1, 0.06
"""Farther from where it was expected a hypothesis does not go on an earlier one."""
MATCH, MATCHES = 2.0, 2
"""Nats by which a hypothesis that goes on speaks for a direction, and how many count at most."""
REVERSED = float(np.log(0.02 / 0.98))
"""Log odds, before any comparison, that the way is counted with the wrong sign."""
SUREST = 4.0
"""Log odds are kept within this: a robot may turn round at any time."""


class Direction:
    """What lists of one robot say of the sign of its odometry."""

    def __init__(self) -> None:
        self._log_odds = REVERSED
        self._lists: dict[str, deque[tuple[int, Array]]] = {}

    @property
    def reversed(self) -> bool:
        """Whether the robot drives the other way than odometry says."""
        return self._log_odds > 0.0

    def hear(
        self, source: str, stamp: int, poses: Array, motion: Callable[[int, int], Motion]
    ) -> Motion | None:
        """Takes the list (n, 3) of a source at `stamp`, ns; `motion` tells odometry's between two stamps.

        Gives the motion up to now that `applied` had wrong, as it was applied, where this showed it.
        """
        lists = self._lists.setdefault(source, deque(maxlen=16))
        while lists and not 0 <= stamp - lists[0][0] <= LONGEST_NS:
            lists.popleft()
        way = motion(lists[-1][0], stamp).way if lists else STEP_M
        if way < STEP_M:
            return None
        mistaken = None
        for before, earlier in reversed(lists):
            moved = motion(before, stamp)
            if abs(moved.delta[0]) >= REACH_M:
                weight = min(way / REACH_M, 1.0)
                mistaken = self._weigh(
                    moved, weight * MATCH * _for_reversed(earlier, poses[:COMPARED], moved)
                )
                break
        lists.append((stamp, poses[:COMPARED]))
        return mistaken

    def _weigh(self, moved: Motion, gained: float) -> Motion | None:
        applied, said = self.applied(moved), self.reversed
        self._log_odds = float(np.clip(self._log_odds + gained, -SUREST, SUREST))
        return applied if self.reversed != said else None

    def applied(self, moved: Motion) -> Motion:
        """The motion with its way reversed where that is the likelier."""
        x, y, turn = moved.delta
        return replace(moved, delta=(-x, -y, turn)) if self.reversed else moved


def _for_reversed(before: Array, after: Array, moved: Motion) -> int:
    """How many hypotheses go on backwards where none does as told; less those that more go on as told."""
    x, y, turn = moved.delta
    told, back = (
        going_on(compose(before, np.array([sign * x, sign * y, turn])), after, NEAR_M, NEAR_RAD)
        for sign in (1.0, -1.0)
    )
    # along a hallway some go on either way
    return min(back, MATCHES) if told == 0 else -min(max(told - back, 0), MATCHES)
