"""Evidence of the visits for each cell, which distinguishes a lasting change from a passer-by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.gridmap import GridMap
from eigenscan.mapbuilder.keeping.view import Marks
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

VIEWS = 3
"""Views from different places that a visit needs of a cell."""
BESIDE = 0.1
"""m that a beam's end may be off."""
MOST = 255
LONGEST = 100
"""Largest number of visits that counts."""
DAY_NS = 86_400 * 1_000_000_000


@dataclass
class Evidence:
    """Counts (H, W) on a map's cells.

    A visit is a stretch of time of a fixed length: all robots and scans in it count once. So an object that
    stands for less than n - 2 such lengths is never seen by n visits.
    `run` int8: consecutive visits that agree, above 0 occupied, below 0 seen through. `struck` and `crossed`
    uint8: views of the running visit. `visit`: its number, from the epoch; -1: none yet.
    """

    run: NDArray[np.int8]
    struck: NDArray[np.uint8]
    crossed: NDArray[np.uint8]
    length_ns: int
    resolution: float
    visit: int = -1

    @classmethod
    def of(cls, grid: GridMap, length_s: float) -> Evidence:
        """Nothing seen yet of the grid's cells."""
        shape = grid.cells.shape
        return cls(
            np.zeros(shape, np.int8),
            np.zeros(shape, np.uint8),
            np.zeros(shape, np.uint8),
            round(length_s * 1e9),
            grid.resolution,
        )

    def is_days_off(self, stamp: int) -> bool:
        """Whether `stamp`, ns, lies more than a day from the running visit."""
        return self.visit >= 0 and abs(stamp // self.length_ns - self.visit) * self.length_ns > DAY_NS

    def turn_to(self, stamp: int) -> bool:
        """Ends the running visit if `stamp`, ns, lies in a later one; returns whether it did.

        A late stamp counts for the running visit. A jump of more than a day is a clock that was set, or a
        long silence: the running visit is dropped, so that different clocks cannot make visits.
        """
        number = stamp // self.length_ns
        ahead = number - self.visit
        if self.is_days_off(stamp):
            self._forget()
        elif self.visit >= 0 and ahead <= 0:
            return False
        ended = self.visit >= 0
        if ended:
            self._end()
        self.visit = number
        return ended

    def add(self, marks: Marks) -> None:
        """Counts one view for the running visit."""
        struck, crossed = self.struck[marks.part], self.crossed[marks.part]
        struck += marks.struck & (struck < MOST)
        crossed += marks.crossed & (crossed < MOST)

    def _end(self) -> None:
        """Each cell that was looked at enough gets the visit's word."""
        struck, crossed, run = self.struck.astype(np.int16), self.crossed.astype(np.int16), self.run
        # poses err: a wall that was struck beside this cell was not looked through
        beside = maximum_filter(struck, 1 + 2 * max(1, round(BESIDE / self.resolution)))
        occupied = (struck >= VIEWS) & (struck > crossed)
        through = (crossed >= VIEWS) & (4 * beside <= crossed)
        mixed = (np.maximum(struck, crossed) >= VIEWS) & ~occupied & ~through
        run[occupied] = np.minimum(np.maximum(run[occupied], 0) + 1, LONGEST)
        run[through] = np.maximum(np.minimum(run[through], 0) - 1, -LONGEST)
        run[mixed] = 0
        self._forget()

    def _forget(self) -> None:
        self.struck[:] = 0
        self.crossed[:] = 0
