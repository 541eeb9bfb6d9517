"""The checks in words, for scripts, and as JUnit XML."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from eigenscan.workbench.conformance.check import FAILED, SKIPPED, Check
from eigenscan.workbench.conformance.trial import Observed
from eigenscan.workbench.replay.suite import DIFFERENT, PASSED, Case
from eigenscan.workbench.replay.suite import junit as suite_junit

PAGE = "docs/contract.md"


def report(seen: Observed, checks: Sequence[Check]) -> str:
    """One line for each check; a failure adds the clause and the program's last lines."""
    width = max(len(check.name) for check in checks)
    lines = []
    for check in checks:
        clause = f"  [{PAGE}, {check.clause}]" if check.result == FAILED else ""
        lines.append(f"{check.result:6}  {check.name:{width}}  {check.words}{clause}")
    if any(check.result == FAILED for check in checks) and seen.last_lines:
        lines += ["the last that the program wrote:", *(f"  {line}" for line in seen.last_lines)]
    return "\n".join(lines)


def figures(seen: Observed, checks: Sequence[Check], command: Sequence[str]) -> dict[str, object]:
    """The same for scripts."""
    return {
        "service": seen.profile.name,
        "command": list(command),
        "conforms": not any(check.result == FAILED for check in checks),
        "checks": [vars(check) for check in checks],
    }


def junit(seen: Observed, checks: Sequence[Check]) -> str:
    """A test case for each check that applies."""
    cases = [
        Case(
            Path(seen.profile.name),
            check.name,
            DIFFERENT if check.result == FAILED else PASSED,
            f"{check.words} [{PAGE}, {check.clause}]",
            check.words,
        )
        for check in checks
        if check.result != SKIPPED
    ]
    return suite_junit(cases, "eigenscan conform")
