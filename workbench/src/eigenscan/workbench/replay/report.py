"""The outcome of a replay in words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from eigenscan.runtime.printable import printable
from eigenscan.workbench.replay.comparison import Comparison, Finding
from eigenscan.workbench.replay.fields import Difference
from eigenscan.workbench.replay.trial import Outcome

SHOWN = 12
"""Fields of the first difference that are listed."""
WIDTH = 40
"""Characters of a value that are shown."""


def report(outcome: Outcome) -> str:
    """The whole report: instances, counts, the first difference, notes."""
    return "\n".join(_lines(outcome))


def summary(outcome: Outcome) -> str:
    """One line: the difference, or the number of equal messages."""
    problems = outcome.comparison.problems
    if problems:
        return "; ".join(problems)
    counts = outcome.comparison.judged.values()
    same, within = sum(count.same for count in counts), sum(count.within for count in counts)
    rest = f", {within} within tolerance or but for ignored fields" if within else ""
    return f"{same} messages the same to the last bit{rest}, {pace(outcome)}"


def figures(outcome: Outcome) -> dict[str, Any]:
    """Values for scripts: counts by channel, the first difference, notes."""
    first = outcome.comparison.first
    return {
        "problems": outcome.comparison.problems,
        "notes": outcome.notes,
        "recording_s": outcome.survey.seconds,
        "took_s": outcome.took_s,
        "heard": {channel.name: count for channel, count in outcome.received.items() if count},
        "channels": {
            channel.name: vars(count) | {"judged": channel in outcome.comparison.judged}
            for channel, count in outcome.comparison.counts.items()
        },
        "first_difference": {
            "channel": first.channel.name,
            "stamp_ns": first.stamp,
            "key": first.key,
            "fields": {one.path: [_plain(one.recorded), _plain(one.replayed)] for one in first.fields},
        }
        if first
        else None,
    }


def _plain(value: Any) -> Any:
    """A value that JSON can hold, else its text."""
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    return value if isinstance(value, bool | int | str) or value is None else str(value)


def pace(outcome: Outcome) -> str:
    """How long it took."""
    seconds = outcome.survey.seconds
    return f"{seconds:.1f} s in {outcome.took_s:.1f} s ({seconds / max(outcome.took_s, 1e-9):.1f}x)"


def _lines(outcome: Outcome) -> Iterator[str]:
    for instance in outcome.instances:
        reported = outcome.survey.reported.get((instance.service.name, instance.name))
        then = f", recorded with version {reported.version}" if reported and reported.version else ""
        yield f"{instance.service.name} {instance.name}: {instance.source}{then}"
    received = ", ".join(f"{count} {channel.name}" for channel, count in outcome.received.items() if count)
    yield f"received {received}; {pace(outcome)}"
    yield from (f"note: {note}" for note in outcome.notes)
    yield from _table(outcome.comparison)
    first = outcome.comparison.first
    if first:
        yield from _finding(first)


def _table(comparison: Comparison) -> Iterator[str]:
    names = ("recorded", "replayed", "same", "within", "different", "missing", "extra", "outside")
    yield f"{'channel':12}" + "".join(f"{name:>10}" for name in names)
    for channel, count in comparison.counts.items():
        yield f"{channel.name:12}" + "".join(f"{getattr(count, name):>10}" for name in names)
    for channel, reason in comparison.terms.unjudged.items():
        if channel in comparison.counts:
            yield f"not judged: {channel.name}: {reason}"
    for name in sorted(comparison.terms.ignored):
        yield f"not judged: {name}: --ignore"
    if any(count.within for count in comparison.counts.values()):
        yield "within: other bytes, but the same within tolerances and but for ignored fields"
    if any(count.outside for count in comparison.counts.values()):
        yield "outside: before the first or after the last recorded stamp of its key, not judged"


def _finding(finding: Finding) -> Iterator[str]:
    seconds, rest = divmod(finding.stamp, 10**9)
    yield f"first difference: {finding.channel.name} at {seconds}.{rest:09d} on {finding.key}"
    shown = finding.fields[:SHOWN]
    width = max(len(one.path) for one in shown)
    yield f"  {'field':{width}}  {'recorded':{WIDTH}}  replayed"
    for one in shown:
        yield f"  {one.path:{width}}  {_value(one.recorded):{WIDTH}}  {_value(one.replayed)}{_gap(one)}"
    if len(finding.fields) > SHOWN:
        yield f"  and {len(finding.fields) - SHOWN} fields more"


def _value(value: Any) -> str:
    text = printable(str(value))
    return text if len(text) <= WIDTH else text[: WIDTH - 3] + "..."


def _gap(one: Difference) -> str:
    if isinstance(one.recorded, float) and isinstance(one.replayed, float):
        return f"  ({one.replayed - one.recorded:+.3g})"
    return ""
