"""One run: a site, its faults, and what broke."""

from __future__ import annotations

import gc
import logging
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from eigenscan.runtime.logs import NAME
from eigenscan.workbench.simtest.checks import Broken, Judge
from eigenscan.workbench.simtest.faults import Fault, draw
from eigenscan.workbench.simtest.site import Plan, Site

RUNS_KEPT = 100
"""Runs whose remains are collected together: each leaves a MB, and it takes as long as three runs."""
_runs = count(1)
WELL_S = 3.0
"""For which all works before a short story ends: by then each service has published its health again."""


@dataclass(frozen=True)
class Outcome:
    """What came of it."""

    seed: int
    plan: Plan
    faults: tuple[Fault, ...]
    broken: tuple[Broken, ...]
    trace: str
    """Hash of all that was published, when and by whom: equal for two runs of one seed."""
    site_s: float
    took_s: float
    """By the processor."""
    counts: dict[str, int]
    notes: tuple[tuple[float, str], ...]
    """When, and what services did: starts, ends, changes of health."""


def run(
    seed: int, robots: int | None = None, faults: Sequence[Fault] | None = None, *, real: bool = False
) -> Outcome:
    """Runs a seed, with its own faults or those that are given; `real`: with the real projector."""
    began = time.process_time()
    plan = Plan.of(seed, robots, real=real)
    chosen = tuple(draw(seed, plan) if faults is None else faults)
    site = Site(seed, plan)
    judge = Judge(site)
    log = logging.getLogger(NAME)
    level, propagates = log.level, log.propagate
    log.propagate = False
    log.setLevel(logging.CRITICAL)
    try:
        site.begin()
        for fault in chosen:
            site.agenda.after(fault.at, lambda fault=fault: fault.begin(site))  # type: ignore[misc]
        last = max([plan.first_s, *(fault.end for fault in chosen)])
        end = last + judge.settle_s
        well_since = last
        while site.agenda.now_ns < round(end * 1e9) and not judge.broken:  # now is a sum, rounded otherwise
            site.agenda.run(min(end, site.agenda.now + 1.0))
            if plan.is_short and site.agenda.now >= last:
                if not judge.all_is_well(last):
                    well_since = site.agenda.now
                elif site.agenda.now - well_since >= WELL_S:
                    break
        if not judge.broken:
            judge.finish()
        for process in site.processes:
            process.is_wanted = False
            process.stop()
        if not judge.broken:
            judge.recordings()
    except Exception as error:
        own = [frame for frame in traceback.extract_tb(error.__traceback__) if "eigenscan" in frame.filename]
        where = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "elsewhere"
        judge.fail("crash", f"{type(error).__name__} in {where}: {error}")
    finally:
        log.setLevel(level)
        log.propagate = propagates
        for process in site.processes:
            process.disk.close()
        if next(_runs) % RUNS_KEPT == 0:
            gc.unfreeze()
            gc.collect()  # a process freezes what an earlier run left, so no later collection would find it
    return Outcome(
        seed,
        plan,
        chosen,
        tuple(judge.broken),
        site.network.trace.hexdigest(),
        site.agenda.now,
        time.process_time() - began,
        dict(judge.counts),
        tuple(site.notes),
    )
