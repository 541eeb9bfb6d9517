"""Repairs logged stamps that do not increase.

In some logs the stamps jump to and fro while the lines are in the right order. If the stamps of each kind of
line increase, they are trusted, and the kinds are merged by them. Otherwise, or if the kinds disagree by
seconds, the order of the lines is trusted: the longest increasing subsequence of stamps stays as logged, so
that true gaps remain, and every other line is put between its neighbours by its number. After a clock was set
back, stamps continue at the log's usual pace. If hardly any stamps are in order, they show nothing: each line
is then one step later. A jump of years is no gap: such a line, at 0 or by an unset clock, gets a stamp
between its neighbours'.
A reference trajectory of such a log may have the logged stamps: `Log.logged` lists the changed ones.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

KINDS_APART_NS = 2_000_000_000
LONE_STEP_NS = 100_000_000
LONGEST_GAP_NS = 365 * 86_400 * 1_000_000_000
SQUEEZED_LINES = 10
"""Number of squeezed stamps in a row that shows a clock that was set back."""
IN_ORDER_SHARE, ENOUGH_TO_JUDGE = 0.25, 100
"""Least share of different stamps in order, and the number to judge: a good log has more than half in order,
shuffled stamps a fifth at most."""


def repair_stamps(stamps: NDArray[np.int64], kinds: Sequence[str]) -> NDArray[np.int64]:
    """Stamps (L,), ns, that increase within each kind of line.

    Unchanged if the logged ones do; otherwise by the order of the lines (see the module).
    """
    names = np.array(kinds)
    increasing = all(np.all(np.diff(stamps[names == kind]) > 0) for kind in set(kinds))
    lag = np.max(np.maximum.accumulate(stamps) - stamps)
    if increasing and lag < KINDS_APART_NS and not np.any(np.diff(stamps) > LONGEST_GAP_NS):
        return stamps
    kept = _longest_increasing(stamps)
    different = len(np.unique(stamps))
    if different > ENOUGH_TO_JUDGE and len(kept) < IN_ORDER_SHARE * different:
        kept = kept[:1]
    steps, lines = np.diff(stamps[kept]), np.diff(kept)
    years = steps > LONGEST_GAP_NS
    paces = steps[~years] / lines[~years]
    usual = float(np.median(paces)) if len(paces) else LONE_STEP_NS
    squeezed = (lines > SQUEEZED_LINES) & (steps < 0.25 * usual * lines)
    waits = np.where(years | squeezed, np.round(usual * lines).astype(np.int64) - steps, 0)
    moved = np.concatenate([[0], np.cumsum(waits)])
    # the longest part without a step of years keeps its stamps
    part = np.concatenate([[0], np.cumsum(years)])
    known = stamps[kept] + moved - moved[np.argmax(part == np.argmax(np.bincount(part)))]
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
