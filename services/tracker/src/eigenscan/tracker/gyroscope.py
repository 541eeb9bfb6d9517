"""The robot's turn by a gyroscope instead of its wheels.

Wheels slip, most of all in turns. A gyroscope does not slip but drifts; how fast shows while the wheels
stand. Until they have stood for a second, the wheels' turn counts.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, deque
from math import cos, hypot, isfinite, sin

from eigenscan.geometry.pose import FARTHEST_M
from eigenscan.tracker.planar import Pose
from eigenscan.tracker.velocity_gate import JUMP_SLACK_RAD

GAP_NS = 100_000_000
"""Longest time between two headings: at 3 rad/s2 the turn between is then known to 0.004 rad."""
KEPT = 256
"""Headings: odometry up to 5 s late at 50 Hz."""
REST_NS = 1_000_000_000
"""Wheels that stand so long show the drift: to 0.0005 rad/s at a noise of 0.005 rad/s and 100 Hz."""
REST_M, REST_RAD = 0.001, 0.001
"""Most motion of wheels that stand for so long."""
MOST_DRIFT = 0.1
"""rad/s, 6 degrees/s: twice what usual chips state; a robot that turns faster does not stand."""
DRIFT_CHANGE = 0.01
"""rad/s; a known drift changes by less between two rests, with the temperature."""
NEW_SHARE = 0.3
"""Weight of the newest rest in the drift."""
FROZEN_RAD = 0.01
"""If the wheels turned by more while the heading stayed the same to the last bit, the gyroscope is dead."""


class Gyroscope:
    """Headings of one robot by stamp, and their drift."""

    def __init__(self, turn_max: float, counts: Counter[str]) -> None:
        """`turn_max`: rad/s, the robot's greatest turn rate."""
        self._turn_max, self._counts = turn_max, counts
        self._since: int | None = None
        self._stamps: deque[int] = deque(maxlen=KEPT)
        self._headings: deque[float] = deque(maxlen=KEPT)
        self._rest: tuple[int, float] | None = None
        """Stamp, ns, and heading from which on the wheels stand."""
        self._crept_m = self._crept_rad = 0.0
        self.drift: float | None = None
        """rad/s; None: not known yet."""

    def receive(self, since: int, stamp: int, heading: float) -> None:
        """Takes a heading, rad, of `stamp`; `since`: when its sum began; both ns."""
        if not (isfinite(heading) and abs(heading) < FARTHEST_M):
            self._counts["heading_not_finite"] += 1
            return
        self._counts["heading_received"] += 1
        newest = self._stamps[-1] if self._stamps else stamp - 1
        if stamp == newest and since == self._since:
            return
        if since != self._since or not 0 < stamp - newest <= GAP_NS:
            self._counts["heading_interrupted"] += bool(self._stamps)
            self._since = since
            self._stamps.clear()
            self._headings.clear()
        self._stamps.append(stamp)
        self._headings.append(heading)

    def reaches(self, stamp: int, now: int) -> bool:
        """Whether no heading of before `stamp`, ns, is to be waited for; `now`: the newest odometry's stamp.

        So odometry waits for one heading, and does not wait for a gyroscope that is silent.
        """
        return not self._stamps or self._stamps[-1] >= stamp or now - self._stamps[-1] > GAP_NS

    def steer(self, start: int, end: int, step: Pose) -> Pose:
        """The wheels' `step` from stamp `start` to `end`, ns, with the gyroscope's turn if it is known."""
        if self._since is None:
            return step
        before, after = self._at(start), self._at(end)
        if before is None or after is None:
            self._counts["odometry_without_heading"] += 1
            self._rest = None
            return step
        if before == after and abs(step[2]) > FROZEN_RAD:
            self._counts["heading_frozen"] += 1
            return step
        self._learn(end, step, after)
        if self.drift is None:
            self._counts["heading_before_a_rest"] += 1
            return step
        seconds = (end - start) * 1e-9
        turn = after - before - self.drift * seconds
        if abs(turn) > 2.0 * self._turn_max * seconds + JUMP_SLACK_RAD:
            self._counts["heading_jumped"] += 1
            return step
        # wheels measure the way along the arc: half of what they turned too much turns its chord
        half = 0.5 * (turn - step[2])
        c, s = cos(half), sin(half)
        return c * step[0] - s * step[1], s * step[0] + c * step[1], turn

    def _at(self, stamp: int) -> float | None:
        """Heading at `stamp`, ns; None where there is none."""
        index = bisect_left(self._stamps, stamp)
        if index == len(self._stamps):
            return None
        if self._stamps[index] == stamp:
            return self._headings[index]
        if index == 0:
            return None
        a, b = self._stamps[index - 1], self._stamps[index]
        before, after = self._headings[index - 1], self._headings[index]
        return before + (after - before) * (stamp - a) / (b - a)

    def _learn(self, end: int, step: Pose, after: float) -> None:
        """Drift is what turns while the wheels stand."""
        self._crept_m += hypot(step[0], step[1])
        self._crept_rad += abs(step[2])
        if self._rest is None or self._crept_m > REST_M or self._crept_rad > REST_RAD:
            self._rest, self._crept_m, self._crept_rad = (end, after), 0.0, 0.0
            return
        since, then = self._rest
        if end - since < REST_NS:
            return
        self._rest, self._crept_m, self._crept_rad = (end, after), 0.0, 0.0
        rate = (after - then) / ((end - since) * 1e-9)
        if self.drift is None and abs(rate) <= MOST_DRIFT:
            self.drift = rate
        elif self.drift is not None and abs(rate - self.drift) <= DRIFT_CHANGE:
            self.drift += NEW_SHARE * (rate - self.drift)
        else:
            self._counts["heading_turns_at_rest"] += 1
