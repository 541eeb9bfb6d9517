"""Repair of logged stamps that do not increase.

Some logs were written with stamps that jump to and fro, while the order of their lines is right.
Where the stamps of each kind of line increase, they are trusted, and the kinds are merged by them.
Otherwise, or where the kinds disagree by seconds, the order of the lines is trusted: the longest
increasing subsequence of stamps is kept as logged, so that true gaps stay, and every other line is put
between its neighbours by its number. A clock that was set back goes on at the log's usual pace.

A reference trajectory that was made from such a log may have the stamps as logged: a log tells which ones
were changed (`Log.logged`).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

KINDS_APART_NS = 2_000_000_000
LONE_STEP_NS = 100_000_000
SQUEEZED_LINES = 10
"""So many lines in a row whose stamps would be squeezed mean that the clock was set back."""


def repair_stamps(stamps: NDArray[np.int64], kinds: Sequence[str]) -> NDArray[np.int64]:
    """Stamps (L,), ns, that increase within each kind of line.

    Unchanged where they do so as logged; else by the order of the lines (see the module).
    """
    names = np.array(kinds)
    increasing = all(np.all(np.diff(stamps[names == kind]) > 0) for kind in set(kinds))
    if increasing and np.max(np.maximum.accumulate(stamps) - stamps) < KINDS_APART_NS:
        return stamps
    kept = _longest_increasing(stamps)
    steps, lines = np.diff(stamps[kept]), np.diff(kept)
    usual = float(np.median(steps / lines)) if len(kept) > 1 else LONE_STEP_NS
    squeezed = (lines > SQUEEZED_LINES) & (steps < 0.25 * usual * lines)
    waits = np.where(squeezed, np.round(usual * lines).astype(np.int64) - steps, 0)
    known = stamps[kept] + np.concatenate([[0], np.cumsum(waits)])
    # one usual step a line before the first and after the last one kept
    places = np.concatenate([[-1], kept, [len(stamps)]])
    ends = (known[0] - (kept[0] + 1) * usual, known[-1] + (len(stamps) - kept[-1]) * usual)
    offsets = np.concatenate([[ends[0]], known, [ends[1]]]) - known[0]
    repaired = known[0] + np.round(np.interp(np.arange(len(stamps)), places, offsets)).astype(np.int64)
    repaired[kept] = known
    shifted: NDArray[np.int64] = repaired - min(int(repaired[0]), 0)
    return shifted


def _longest_increasing(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices of a longest strictly increasing subsequence."""
    ends: list[int] = []
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
