"""Repair of logged stamps that do not increase.

Some logs were written with stamps that jump to and fro, while the order of their lines is right.
Where the stamps of each kind of line increase, they are trusted, and the kinds are merged by them.
Otherwise, or where the kinds disagree by seconds, the order of the lines is trusted: the longest
increasing subsequence of stamps is kept as logged, so that true gaps stay, and every other line is put
between its neighbours by its number. A clock that was set back goes on at the log's usual pace.

A reference trajectory that was made line by line from such a log has the same stamps; repaired by the
same function it fits the repaired log again.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

KINDS_APART_S = 2.0
LONE_STEP_S = 0.1
SQUEEZED_LINES = 10
"""So many lines in a row whose stamps would be squeezed mean that the clock was set back."""


def repair_stamps(stamps: NDArray[np.float64], kinds: Sequence[str]) -> tuple[NDArray[np.float64], int]:
    """Stamps (L,), s, that increase within each kind of line, and how many were changed.

    Unchanged where they do so as logged; else by the order of the lines (see the module).
    """
    names = np.array(kinds)
    increasing = all(np.all(np.diff(stamps[names == kind]) > 0.0) for kind in set(kinds))
    if increasing and np.max(np.maximum.accumulate(stamps) - stamps) < KINDS_APART_S:
        return stamps, 0
    kept = _longest_increasing(stamps)
    steps = np.diff(stamps[kept])
    lines = np.diff(kept)
    usual = float(np.median(steps / lines)) if len(kept) > 1 else LONE_STEP_S
    squeezed = (lines > SQUEEZED_LINES) & (steps < 0.25 * usual * lines)
    shift = np.concatenate([[0.0], np.cumsum(np.where(squeezed, usual * lines - steps, 0.0))])
    repaired = np.interp(np.arange(len(stamps)), kept, stamps[kept] + shift)
    before = np.arange(kept[0]) - kept[0]
    after = np.arange(kept[-1] + 1, len(stamps)) - kept[-1]
    repaired[: kept[0]] = repaired[kept[0]] + before * usual
    repaired[kept[-1] + 1 :] = repaired[kept[-1]] + after * usual
    return repaired - min(repaired[0], 0.0), len(stamps) - len(kept)


def _longest_increasing(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Indices of a longest strictly increasing subsequence."""
    ends: list[float] = []
    holders: list[int] = []
    before = np.full(len(values), -1, dtype=np.int64)
    for index, value in enumerate(values.tolist()):
        place = bisect_left(ends, value)
        if place == len(ends):
            ends.append(value)
            holders.append(index)
        else:
            ends[place] = value
            holders[place] = index
        before[index] = holders[place - 1] if place else -1
    chain = [holders[-1]]
    while before[chain[-1]] >= 0:
        chain.append(int(before[chain[-1]]))
    return np.array(chain[::-1])
