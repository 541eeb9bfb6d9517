"""A failure, reported with the fewest faults that still cause it."""

from __future__ import annotations

from collections.abc import Iterator

from eigenscan.workbench.simtest.faults import Fault
from eigenscan.workbench.simtest.site import Site
from eigenscan.workbench.simtest.trial import Outcome, run


def shrunk(outcome: Outcome) -> Outcome:
    """The same rule broken with the fewest faults, and then the fewest robots, that leaving out can find."""
    size = max(1, len(outcome.faults) // 2)
    while True:
        begin, faults = 0, outcome.faults
        while begin < len(faults):
            less = _again(outcome, outcome.plan.robots, faults[:begin] + faults[begin + size :])
            if less is None:
                begin += size
            else:
                outcome, faults = less, less.faults
        if size == 1:
            break
        size //= 2
    for robots in range(1, outcome.plan.robots):
        fewer = _again(outcome, robots, outcome.faults)
        if fewer is not None:
            return fewer
    return outcome


def _again(outcome: Outcome, robots: int, faults: tuple[Fault, ...]) -> Outcome | None:
    """The outcome with other faults, where it breaks the same rule."""
    places = {"site", *(f"r{number + 1}" for number in range(robots))}
    if any(fault.place not in places for fault in faults):
        return None
    found = run(outcome.seed, robots, faults, real=outcome.plan.real)
    return found if found.broken and found.broken[0].rule == outcome.broken[0].rule else None


def story(outcome: Outcome) -> Iterator[str]:
    """The story, a line each: what was done to the site, what its services did, what broke."""
    site = Site(outcome.seed, outcome.plan)
    first = min((fault.at for fault in outcome.faults), default=0.0)
    end = outcome.broken[0].at if outcome.broken else outcome.site_s
    lines = [(fault.at, f"fault: {fault.words(site)}") for fault in outcome.faults]
    lines += [(at, text) for at, text in outcome.notes if first <= at <= end]
    lines += [(broken.at, f"broken: {broken.rule}: {broken.detail}") for broken in outcome.broken[:1]]
    plan = outcome.plan
    rates = f"{plan.scan_hz:g} scans and {plan.odometry_hz:g} odometry messages a second"
    yield f"seed {outcome.seed}: {plan.robots} robots, {rates}"
    for at, text in sorted(lines, key=lambda line: line[0]):
        yield f"{at:8.2f} s  {text}"
