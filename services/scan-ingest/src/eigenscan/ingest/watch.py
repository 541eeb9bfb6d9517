"""Watches one lidar: whether its scans are live, and how the robot moved between them."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from hashlib import blake2b
from math import hypot

import numpy as np
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.doubtful_ranges import LEAST_BEAMS
from eigenscan.ingest.motion import BEAMS, Motion, Points, Pose, motion_between, moved_in, points_of
from eigenscan.schemas.channels import FOLLOWS
from numba import njit, types
from numpy.typing import NDArray

Ranges = NDArray[np.float32]

MATCH_EVERY_NS, PERIODS = 150_000_000, 20
"""Time between two compared scans, on the mean of PERIODS: a robot moves little meanwhile.

The mean counts, because a driver may publish several scans at once.
"""
ALIKE_M, ALIKE = 0.2, 0.6
"""A scan that has fewer of its ranges so near to those of the scan before it is compared at once.

Of 12,018 pairs of neighbours on six logs 992 are not alike; of 8,559 pairs of other places none is alike and
does not fit (benchmarks/scan_motion.py).
"""
STEP_M, STEP_RAD, STEP_NS = 0.15, 0.12, 600_000_000
"""Motion or time after which it is published: several times the error of a match.

That is 5 cm and 0.06 rad at most in 99 of 100 on jarvis and intel.
"""
RETURNS = 0.15
"""Share of its beams with a range, below which a scan is not compared: in a hall wider than the lidar sees or
on open ground, that it does not fit its neighbour shows nothing.

Of neighbours on intel, jarvis and olin with fewer than 0.1, most do not fit, with more than that all do
(benchmarks/scan_motion.py); in a simulated hall what is found is still wrong up to 0.15, where people pass.
"""
LONGEST_NS = 5_000_000_000
"""Scans farther apart than this may have nothing in common."""
REMEMBERED = 1024
"""Scans that a later one may repeat: 100 s of a lidar of 10 Hz. Noise changes some beam of any other."""
PAUSE_NS = 1_000_000_000
"""Time between two scans from which on the lidar paused, or another drive began."""
FROZEN = 20
"""Repeated scans in a row that are named in health: even a quiet lidar's noise changes some beam."""
LAYOUTS, ALTERNATIONS = 20, 4
"""Number of times among the last scans that the layout returned to the one before: two lidars publish them.
"""
TREMBLES = 1e-3, 1e-3, 1e-3, 0.1
"""m, m, rad of the mount and rad of the first beam, that one lidar's layout may differ by."""


class Watch:
    """Compares the scans of one lidar with each other."""

    def __init__(self) -> None:
        self.repeats = 0
        """Of the newest scans, how many repeat earlier ones to the last bit, in a row."""
        self._digests: dict[bytes, None] = {}
        """Of the last different scans, the oldest first."""
        self._digest = b""
        self._last: Ranges | None = None
        self._reference: Points | None = None
        self._newest = 0
        self._stamps: deque[int] = deque(maxlen=PERIODS + 1)
        self._skipped = 0
        self._compared = 0
        self.longest_step = 0.0
        """Longest time between two compared scans of the last published motion, s."""
        self._velocity: Pose = (0.0, 0.0, 0.0)
        self._layouts: deque[tuple[float, ...]] = deque(maxlen=LAYOUTS)

    @property
    def two_lidars(self) -> bool:
        """Whether scans of two layouts alternate."""
        seen = list(self._layouts)
        if not seen or seen.count(seen[-1]) == len(seen):
            return False
        back = sum(a == c != b for a, b, c in zip(seen, seen[1:], seen[2:], strict=False))
        return back >= ALTERNATIONS

    def receive_layout(self, mount: Pose, angle_min: float) -> None:
        """Records the layout of a raw scan's beams; one that trembles a little stays the same."""
        own = (*mount, angle_min)
        self._layouts.append(next((each for each in self._layouts if _is_one(own, each)), own))

    def receive(
        self, stamp: int, ranges: Ranges, angle_min: float, step: float, mount: Pose
    ) -> tuple[int, Motion | None] | None:
        """Handles a canonical scan; returns the start of an interval, ns, and the motion since then.

        None if it is too early; no motion if the scan repeats one of before.
        """
        last, self._last = self._last, ranges
        if not 0 < stamp - self._newest <= PAUSE_NS:  # a recording may be played again
            self._digests.clear()
        if self._is_known(ranges):
            self.repeats += 1
            since, self._newest = self._newest, stamp
            return since, None
        self.repeats = 0
        reference, before, self._newest = self._reference, self._newest, stamp
        if reference is not None and self._is_early(stamp):
            turned = round(self._velocity[2] * (stamp - before) * 1e-9 / step)
            if last is not None and alike(last, ranges, turned) >= ALIKE:
                return None
        points = points_of(ranges.astype(np.float64), angle_min, step, mount, stamp)
        if points.ranged.mean() < RETURNS:
            self._reference = None
            return None
        if reference is None or not 0 < stamp - reference.stamp <= LONGEST_NS:
            self._begin(points)
            return None
        if self._compared == reference.stamp:
            self.longest_step = 0.0
        self.longest_step = max(self.longest_step, (stamp - self._compared) * 1e-9)
        self._compared = stamp
        seconds = max(stamp - reference.stamp, MATCH_EVERY_NS) * 1e-9
        moved = motion_between(reference, points, moved_in(self._velocity, seconds))
        x, y, turn = moved.delta
        if moved.fits and moved.explained < FOLLOWS and last is not None and reference.stamp != before:
            # what passes between them is no sign that the scan does not follow from the one before
            neighbour = points_of(last.astype(np.float64), angle_min, step, mount, before)
            alone = motion_between(neighbour, points, moved_in(self._velocity, (stamp - before) * 1e-9))
            moved = replace(moved, explained=max(moved.explained, alone.explained))
        self._velocity = (x / seconds, y / seconds, turn / seconds) if moved.fits else (0.0, 0.0, 0.0)
        far = hypot(x, y) >= STEP_M or abs(turn) >= STEP_RAD or stamp - reference.stamp >= STEP_NS
        if not far and moved.explained >= FOLLOWS:
            return None
        self._reference = points
        return reference.stamp, moved

    def _is_known(self, ranges: Ranges) -> bool:
        """Whether a scan repeats the one before, or one of the last REMEMBERED: drivers replay buffers."""
        before, self._digest = self._digest, blake2b(ranges.tobytes(), digest_size=8).digest()
        if self._digest == before:
            return True
        if self._digest in self._digests:  # few returns are alike by chance
            return bool(np.isfinite(ranges).sum() >= LEAST_BEAMS)
        self._digests[self._digest] = None
        if len(self._digests) > REMEMBERED:
            del self._digests[next(iter(self._digests))]
        return False

    def _is_early(self, stamp: int) -> bool:
        """Whether a later scan will do: of a fast lidar not every scan is laid on the reference."""
        self._stamps.append(stamp)
        passed = (len(self._stamps) - 1) * MATCH_EVERY_NS
        self._skipped += 1
        early = self._skipped * (stamp - self._stamps[0]) < passed
        if not early:
            self._skipped = 0
        return early

    def _begin(self, points: Points) -> None:
        self._reference, self._compared = points, points.stamp
        self._velocity = (0.0, 0.0, 0.0)


def _is_one(own: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """Whether two layouts are of one lidar."""
    x, y, heading, first = (a - b for a, b in zip(own, other, strict=True))
    heading, first = ((turn + np.pi) % TURN - np.pi for turn in (heading, first))
    return all(abs(off) <= most for off, most in zip((x, y, heading, first), TREMBLES, strict=True))


def alike(before: Ranges, after: Ranges, turned: int) -> float:
    """The share of a later scan's ranges that are those of the earlier one, `turned` beams further.

    A much cheaper look than a match, for a lidar that hardly moves in between.
    """
    return float(_alike(before, after, turned)) if before.shape == after.shape else 0.0


_RANGES = types.Array(types.float32, 1, "A", readonly=True)


@njit(types.float64(_RANGES, _RANGES, types.int64), cache=True)  # pragma: no cover - compiled
def _alike(before: Ranges, after: Ranges, turned: int) -> float:
    seen, near = 0, 0
    for beam in range(max(-turned, 0), len(after) - max(turned, 0), max(len(after) // BEAMS, 1)):
        earlier, later = before[beam + turned], after[beam]
        seen += np.isfinite(earlier) or np.isfinite(later)
        near += abs(later - earlier) <= np.float32(ALIKE_M)
    return near / max(seen, 1)
