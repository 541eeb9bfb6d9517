"""One check of a run, with the clause of docs/contract.md that it rests on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

PASSED, FAILED, SKIPPED = "ok", "FAILED", "-"


@dataclass(frozen=True)
class Check:
    """One line of the report."""

    name: str
    clause: str
    result: str
    words: str


def check(name: str, clause: str, problems: Sequence[str], words: str) -> Check:
    """Passed with `words`, or failed with the first of the problems."""
    if not problems:
        return Check(name, clause, PASSED, words)
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return Check(name, clause, FAILED, problems[0] + more)


def skipped(name: str, clause: str, why: str) -> Check:
    """A check that shows nothing of this service."""
    return Check(name, clause, SKIPPED, why)
