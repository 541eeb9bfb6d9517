"""`tools/fuzz`: damaged and forged inputs for every reader, for as long as you like."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from pathlib import Path

from tests.fuzz.harness import Finding, made, run, supervise, work
from tests.fuzz.reader import Place
from tests.fuzz.readers import READERS

SLICE_S = 30.0
"""Of one reader, before the next one's turn; those of little weight get less."""


BEFORE = 10_000
"""More than any reader has attacks and seeds."""


def main() -> int:
    """Runs until the time is over; 1 where something was found."""
    parser = argparse.ArgumentParser(prog="tools/fuzz", description=__doc__)
    parser.add_argument("readers", nargs="*", help=f"there are {', '.join(READERS)}; default: all in turn")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--number", type=int, help="run this one input of one reader, with its trace")
    parser.add_argument("--keep", type=Path, help="with --number: write the input to this file")
    parser.add_argument(
        "--slice", type=float, default=SLICE_S, help="seconds of one reader, before the next one's turn"
    )
    parser.add_argument("--work", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.work:
        work(READERS[given.work[0]], int(given.work[1]))
        return 0
    if unknown := [name for name in given.readers if name not in READERS]:
        parser.error(f"no reader {unknown[0]}: there are {', '.join(READERS)}")
    if given.number is not None:
        return _one(given.readers[0], given.number, given.keep)
    os.nice(19)
    return _all(given.readers or list(READERS), given.first, given.minutes, given.slice)


def _one(name: str, number: int, keep: Path | None) -> int:
    reader = READERS[name]
    with Place(reader) as opened:
        data = made(reader, opened, number)
        if keep:
            keep.write_bytes(data)
        for answer in run(reader, opened, [number]):
            if isinstance(answer, Finding):
                print(f"{answer.kind} {answer.detail}")
        opened.read(data)
    return 0


def _all(names: list[str], first: int, minutes: float, slice_s: float) -> int:
    until = time.monotonic() + 60.0 * minutes
    counts: Counter[str] = Counter()
    kinds: dict[str, Finding] = {}
    at = dict.fromkeys(names, first or -BEFORE)
    while time.monotonic() < until:
        for name in names:
            end = min(until, time.monotonic() + slice_s * min(1.0, READERS[name].weight))
            for answer in supervise(READERS[name], at[name], end):
                if isinstance(answer, int):
                    counts[name] += 1
                    at[name] = answer + 1
                elif answer.kind not in kinds:
                    kinds[answer.kind] = answer
                    print(f"{name} --number {answer.number}: {answer.what}: {answer.detail}", flush=True)
        print(f"{sum(counts.values())} inputs, {len(kinds)} kinds of harm", file=sys.stderr, flush=True)
    print(f"{sum(counts.values())} inputs: " + ", ".join(f"{name} {n}" for name, n in counts.items()))
    print(f"{len(kinds)} kinds of harm")
    return 1 if kinds else 0


if __name__ == "__main__":
    sys.exit(main())
