"""The demo's last screen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from eigenscan.cli.demonstration.verdict import Stretch
from eigenscan.cli.launch.screen import error_text


def summarize(before: Stretch, after: Stretch, kidnap: float, files: Sequence[Path]) -> str:
    """Text over the stretches before and after the kidnap at `kidnap` s, and the files written."""
    rows = [
        ("first pose", _found(before)),
        ("error", _accuracy(before)),
        (f"kidnap at {kidnap:.0f} s", _noticed(after)),
        ("found again", _found(after)),
        ("error", _accuracy(after)),
        (
            "claims",
            f"{before.claims} before the kidnap, {before.wrong_claims} of them wrong; "
            f"{after.claims} after it, {after.wrong_claims} wrong",
        ),
    ]
    rows += [("files" if not number else "", _file(path)) for number, path in enumerate(files)]
    lines = [f"  {name:<16}{text}" for name, text in rows]
    return "\n".join(["", _headline(before, after), *lines])


def _headline(before: Stretch, after: Stretch) -> str:
    if before.found and after.found:
        return "The robot found itself, was carried away, and found itself again."
    if not before.found:
        return f"FAILED: the robot did not find itself before the kidnap ({_why(before)})."
    return f"FAILED: the robot did not find itself again after the kidnap ({_why(after)})."


def _why(stretch: Stretch) -> str:
    if not stretch.claims:
        return "it claimed no pose"
    if stretch.wrong_claims == stretch.claims:
        return f"all {stretch.claims} poses that it claimed were wrong"
    return f"{stretch.wrong_claims} of {stretch.claims} claimed poses were wrong, and the end was not right"


def _found(stretch: Stretch) -> str:
    if stretch.found_after is None:
        return "never"
    return f"after {stretch.found_after:.1f} s, {stretch.scans} scans"


def _noticed(stretch: Stretch) -> str:
    return "not noticed" if stretch.noticed_after is None else f"noticed after {stretch.noticed_after:.1f} s"


def _accuracy(stretch: Stretch) -> str:
    if not stretch.found:
        return "-"
    return f"{error_text(stretch.error_m, stretch.error_rad)} (median), confidence {stretch.confidence:.2f}"


def _file(path: Path) -> str:
    if path.is_dir():
        return f"{path}/"
    return f"{path}  ({path.stat().st_size / 1e6:.1f} MB)"
