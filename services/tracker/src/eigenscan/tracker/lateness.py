"""How late a robot's scans are stamped against its odometry: the delay that explains their turns best.

Drivers stamp scans when they arrive, some tens of milliseconds after the beams were sent. While the robot
turns, a delay of a tenth of a second is several degrees between two lookups of odometry.
"""

from __future__ import annotations

import numpy as np
from eigenscan.tracker.odometry import OdometryTrail, motion
from eigenscan.tracker.planar import Pose, wrap
from eigenscan.tracker.scan_motion import SIGMA_M, SIGMA_RAD
from numpy.typing import NDArray

STEP_NS, STEPS = 50_000_000, 7
"""ns, and how many delays are tried from 0 on: beyond 0.3 s is a fault."""
INTERVALS = 100
"""Over which the delay is learned."""
FAR2 = 9.0
"""A squared distance beyond this counts no more: wheels slip, fits err."""
BETTER = 30.0
"""By how much less, in squared distances, another delay must leave before it is taken."""


class Lateness:
    """Delay of scans' stamps against odometry's, learned from intervals of scan motion."""

    def __init__(self) -> None:
        self._left: NDArray[np.float64] = np.zeros(STEPS)
        self._taken = 0

    @property
    def delay(self) -> int:
        """How late scans are stamped, ns."""
        return self._taken * STEP_NS

    def take(self, since: int, stamp: int, scans: Pose, trail: OdometryTrail) -> None:
        """Takes the scans' motion between two stamps, ns; straight on, any delay would do."""
        if abs(scans[2]) < SIGMA_RAD:
            return
        left = np.empty(STEPS)
        for step in range(STEPS):
            start, end = (trail.as_stamped(at - step * STEP_NS) for at in (since, stamp))
            if start is None or end is None:
                return
            x, y, turn = motion(start, end).delta
            turned = wrap(scans[2] - turn)
            way2 = (scans[0] - x) ** 2 + (scans[1] - y) ** 2
            left[step] = min(turned**2 / SIGMA_RAD**2 + way2 / SIGMA_M**2, FAR2)
        self._left += left - self._left / INTERVALS
        best = int(np.argmin(self._left))
        if self._left[self._taken] - self._left[best] > BETTER:
            self._taken = best
