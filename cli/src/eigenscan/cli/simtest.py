"""`eigenscan simtest`: a simulated site under simulated faults, by seeds."""

from __future__ import annotations

import re
import time
from collections import Counter
from typing import Annotated, Literal

import typer
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.runtime.errors import FailedError, StoppedError, UsageError

MOST_ROBOTS = 100
"""A simulated site with more takes minutes a second."""


def simtest(
    seed: Annotated[int | None, typer.Option(min=0, help="run this seed")] = None,
    seeds: Annotated[str, typer.Option(metavar="A..B", help="run the seeds from A up to B")] = "0..99",
    robots: Annotated[
        int | None,
        typer.Option(min=1, max=MOST_ROBOTS, help="robots of each site; default: 1 to 5, by the seed"),
    ] = None,
    projector: Annotated[
        Literal["lists", "real"],
        typer.Option(help="lists: with a known truth; real: the services' own, in a simulated hall, slower"),
    ] = "lists",
    explain: Annotated[
        bool, typer.Option("--explain", help="show a failure with the fewest faults that cause it")
    ] = False,
    json_file: JsonFile = None,
) -> None:
    """Run the services of a site on simulated time, network and disks, with faults that a seed draws.

    Faults: messages lost, late, twice, out of order, links cut, services killed, stopped, slow or deaf.
    Power lost, full disks, clocks set, floods of nonsense, services of an old release, wheels that slip.
    Rules: probabilities sum to 1. No claim is farther off than its protection level, unless wheels slip.
    Recordings are readable and complete. Health is true. Queues end. All works again after the last fault.
    The same seed always does the same.
    Exit code 0: all held, 1: something broke.

    \b
    Examples:
      eigenscan simtest --seeds 0..999
      eigenscan simtest --seed 4711 --explain
      eigenscan simtest --seeds 0..99 --projector real
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.workbench.one_thread import one_thread

    one_thread()
    from eigenscan.workbench.simtest.story import shrunk, story
    from eigenscan.workbench.simtest.trial import run

    span = re.fullmatch(r"(\d+)\.\.(\d+)", seeds)
    if span is None or int(span[1]) > int(span[2]):
        raise UsageError(f"--seeds {seeds}: give two numbers, such as 0..99")
    chosen = range(int(span[1]), int(span[2]) + 1) if seed is None else [seed]
    prepare(json_file)
    rules: Counter[str] = Counter()
    site_s = took_s = 0.0
    began = time.monotonic()
    found: list[dict[str, object]] = []
    for number in chosen:
        try:
            outcome = run(number, robots, real=projector == "real")
        except KeyboardInterrupt:
            done = f"{len(found)} of {len(chosen)} seeds, {rules.total()} broke a rule"
            raise StoppedError(f"{done}; {_speed(site_s, took_s, time.monotonic() - began)}") from None
        site_s, took_s = site_s + outcome.site_s, took_s + outcome.took_s
        figures = {"seed": number, "trace": outcome.trace, "broken": [vars(one) for one in outcome.broken]}
        found.append(figures)
        if outcome.broken:
            first = outcome.broken[0]
            rules[first.rule] += 1
            if wants_words(json_file):
                typer.echo(f"seed {number}: {first.rule}: {first.detail}")
                if explain:
                    typer.echo("".join(f"  {line}\n" for line in story(shrunk(outcome))), nl=False)
        elif explain and seed is not None and wants_words(json_file):
            typer.echo("".join(f"  {line}\n" for line in story(outcome)), nl=False)
    write_figures(found, json_file)
    speed = _speed(site_s, took_s, time.monotonic() - began)
    if rules:
        kinds = ", ".join(f"{rule} {count}" for rule, count in sorted(rules.items()))
        raise FailedError(f"{rules.total()} of {len(chosen)} seeds broke a rule ({kinds}); {speed}")
    if wants_words(json_file):
        typer.echo(f"{len(chosen)} seeds, nothing broke; {speed}")


def _speed(site_s: float, processor_s: float, clock_s: float) -> str:
    """How many times as much of a site's time as of the processor's and of the clock's."""
    times = [f"{site_s / max(seconds, 1e-9):.0f} times" for seconds in (processor_s, clock_s)]
    return f"{site_s / 3600:.2f} h of a site, {times[0]} the processor's time, {times[1]} the clock's"
