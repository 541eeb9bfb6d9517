"""`tools/fuzz`: damaged and forged inputs for every reader, for as long as you like."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

from tests.fuzz.harness import Finding, judged, made, supervise
from tests.fuzz.reader import Place
from tests.fuzz.readers import READERS

SLICE_S = 10.0
"""Processor time of one reader, before the next one's turn."""
BEFORE = 10_000
"""More than any reader has attacks and seeds."""


def main() -> int:
    """Runs until the time is over; 1 where something was found."""
    parser = argparse.ArgumentParser(prog="tools/fuzz", description=__doc__)
    parser.add_argument("readers", nargs="*", help=f"there are {', '.join(READERS)}; default: all in turn")
    parser.add_argument("--minutes", type=float, default=10.0, help="end after the round they end in")
    parser.add_argument("--inputs", type=float, default=math.inf, help="end after the round with so many")
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--number", type=int, help="run this one input of one reader, with its trace")
    parser.add_argument("--keep", type=Path, help="with --number: write the input to this file")
    parser.add_argument(
        "--slice", type=float, default=SLICE_S, help="processor time of one reader in a round, s"
    )
    given = parser.parse_args()
    if unknown := [name for name in given.readers if name not in READERS]:
        parser.error(f"no reader {unknown[0]}: there are {', '.join(READERS)}")
    if given.number is not None:
        return _one(given.readers[0], given.number, given.keep)
    return _all(given)


def _one(name: str, number: int, keep: Path | None) -> int:
    reader = READERS[name]
    with Place(reader) as opened:
        data = made(reader, opened, number)
        if keep:
            keep.write_bytes(data)
        if finding := judged(reader, opened, number, data):
            print(f"{finding.kind} {finding.detail}")
        opened.read(data)
    return 0


def _all(given: argparse.Namespace) -> int:
    names = given.readers or list(READERS)
    until = time.monotonic() + 60.0 * given.minutes
    counts: Counter[str] = Counter()
    kinds: dict[str, Finding] = {}
    at = dict.fromkeys(names, given.first or -BEFORE)
    with suppress(KeyboardInterrupt):
        while time.monotonic() < until and counts.total() < given.inputs:
            for name in names:
                for answer in supervise(READERS[name], at[name], given.slice):
                    if isinstance(answer, tuple):
                        at[name] = answer[0]
                        counts[name] += answer[1]
                    elif answer.kind not in kinds:
                        kinds[answer.kind] = answer
                        print(f"{name} --number {answer.number}: {answer.what}: {answer.detail}", flush=True)
            print(f"{counts.total()} inputs, {len(kinds)} kinds of harm", file=sys.stderr, flush=True)
    print(f"{counts.total()} inputs: " + ", ".join(f"{name} {n}" for name, n in counts.items()))
    print(f"{len(kinds)} kinds of harm")
    return 1 if kinds else 0


if __name__ == "__main__":
    sys.exit(main())
