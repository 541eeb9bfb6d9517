"""Beams of a lidar that end on the robot itself: posts, a cover, what it carries.

They show no place, and hold scan motion back. Whatever else a beam sees, its range changes while the robot
turns; the robot's own body stays as far away.
"""

from __future__ import annotations

from math import degrees, floor, pi

import numpy as np
from eigenscan.geometry.normalize import Ranges, Sweep
from numpy.typing import NDArray

SECTORS, SHOWN = 12, 8
"""Headings of the robot that are told apart, of a whole turn, and in how many a beam has the same range."""
SAME_M = 0.1
"""A range differs by less from its mean: five sigma of a lidar's noise, `laying.NOISE`."""


class RobotBody:
    """Learns from the turns of a robot which beams of one lidar end on it."""

    def __init__(self) -> None:
        self._heading = 0.0
        self._sector: int | None = None
        self._grid = (0, 0.0, 0.0)
        self._ranges: Ranges = np.zeros(0, np.float32)
        """Mean range (B,), m, since it last changed."""
        self._sectors: NDArray[np.uint16] = np.zeros(0, np.uint16)
        """Headings (B,), a bit each, in which it was the same since then."""
        self._own: NDArray[np.bool_] = np.zeros(0, np.bool_)

    def turn(self, angle: float) -> None:
        """The robot has turned, rad."""
        self._heading += angle

    def without(self, sweep: Sweep) -> Sweep:
        """The sweep as the lidar measured it, with the beams that end on the robot missing."""
        count, first, step = self._grid
        trembles = abs(sweep.angle_min - first) + count * abs(sweep.angle_increment - step)
        if len(sweep.ranges) != count or trembles > 0.5 * step:
            self._grid = len(sweep.ranges), sweep.angle_min, sweep.angle_increment
            self._ranges = np.full(len(sweep.ranges), np.nan, np.float32)
            self._sectors, self._sector = np.zeros(len(sweep.ranges), np.uint16), None
            self._own = np.zeros(len(sweep.ranges), np.bool_)
        sector = floor(self._heading / (2.0 * pi) * SECTORS) % SECTORS
        if sector != self._sector:
            self._sector = sector
            self._look(sweep.ranges, sector)
        if not self._own.any():
            return sweep
        ranges = sweep.ranges.copy()
        ranges[self._own] = np.nan
        return Sweep(ranges, sweep.angle_min, sweep.angle_increment)

    def _look(self, ranges: Ranges, sector: int) -> None:
        known = np.isfinite(ranges)  # that a beam is missing once shows nothing
        off = ranges - self._ranges
        changed = known & ~(np.abs(off) <= SAME_M)
        same = known & ~changed
        views = np.bitwise_count(self._sectors)
        self._ranges[same] += off[same] / (views[same] + 1)
        self._ranges[changed] = ranges[changed]
        self._sectors[changed] = 0
        self._sectors[known] |= np.uint16(1 << sector)
        self._own = np.bitwise_count(self._sectors) >= SHOWN

    @property
    def note(self) -> str:
        """How much of its view is the robot itself, as words after the lidar's name; empty: nothing."""
        if not self._own.any():
            return ""
        width = degrees(float(self._own.sum()) * self._grid[2])
        near = float(self._ranges[self._own].min())
        return f"sees the robot itself over {width:.0f}°, from {near:.1f} m away: these beams are left out"
