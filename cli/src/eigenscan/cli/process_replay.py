"""The work of `eigenscan replay`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from eigenscan.cli.figures import wants_words, write_figures
from eigenscan.runtime.errors import FailedError, UsageError, one_line

if TYPE_CHECKING:
    from eigenscan.schemas.envelope import Envelope
    from eigenscan.workbench.replay.survey import Survey


def process_replay(
    file: Path,
    service: str,
    *,
    compare: bool,
    out: Path | None,
    model: Path | None,
    changes: Sequence[str],
    tolerant: bool,
    strict: bool,
    ignored: Sequence[str],
    least: int,
    rrd: Path | None,
    json_file: Path | None,
) -> None:
    """Replays, reports, and raises FailedError for a difference."""
    from eigenscan.workbench.one_thread import one_thread

    one_thread()
    from eigenscan.workbench.progress import Bars
    from eigenscan.workbench.replay.comparison import Terms
    from eigenscan.workbench.replay.report import figures, report, summary
    from eigenscan.workbench.replay.services import ARRIVAL, CHOICES
    from eigenscan.workbench.replay.survey import survey
    from eigenscan.workbench.replay.trial import Trial, picture, picture_beside, run

    if service not in CHOICES:
        raise UsageError(f"--service {service}: choose one of {', '.join(CHOICES)}")
    if not (compare or out):
        raise UsageError("nothing to do: give --compare, --out FILE, or both")
    found = survey(file)
    trial = Trial(
        CHOICES[service],
        Terms(
            tolerant=tolerant,
            ignored=frozenset(_fields(ignored)),
            unjudged={} if strict else ARRIVAL,
            least=least,
        ),
        _changes(changes, service),
        _models(model, found) if model else (),
        out=out,
    )
    with Bars(transient=True) as bars:
        moved, length = bars.start_share("replay"), max(found.end - found.begin, 1)
        outcome = run(trial, found, lambda time: moved((time - found.begin) / length))
    wordy = wants_words(json_file)
    if wordy:
        typer.echo(report(outcome))
    differs = compare and bool(outcome.comparison.problems)
    target = rrd or picture_beside(file, service)
    try:
        drawn = differs and picture(trial, outcome, report(outcome), target)
    except OSError as error:  # the verdict holds without it
        drawn = False
        typer.echo(f"no picture: {one_line(error)}", err=True)
    written = {
        "recording": str(file),
        "result": ("different" if differs else "same") if compare else None,
        "picture": str(target) if drawn else None,
    }
    write_figures(written | figures(outcome), json_file)
    if drawn and wordy:
        typer.echo(f"both sides: {target}")
    failed = next((instance for instance in outcome.instances if instance.failure), None)
    cause = failed.first_error if failed else None
    if differs:
        why = f"; {failed.failure}" if failed else ""
        raise FailedError(f"{file}: {summary(outcome)}{why}") from cause
    if compare and wordy:
        typer.echo(f"the same: {summary(outcome)}")
    if failed and not compare:  # a comparison may reproduce the failure of the night: that is the same
        raise FailedError(f"{file}: {failed.failure}") from cause


def _fields(names: Sequence[str]) -> Iterator[str]:
    from eigenscan.schemas.channels import by_name

    for name in names:
        channel, _, path = name.partition(".")
        known = by_name(channel).message.DESCRIPTOR.fields_by_name
        if path.partition(".")[0] not in known:
            raise UsageError(f"--ignore {name}: give CHANNEL.FIELD; {channel} has {', '.join(known)}")
        yield name


def _changes(given: Sequence[str], service: str) -> dict[str, dict[str, str]]:
    """`--set` by service and setting; without a service, a setting belongs to the replayed one."""
    result: dict[str, dict[str, str]] = {}
    for text in given:
        place, equals, value = text.partition("=")
        of, _, name = place.rpartition(".")
        if not equals or not name:
            raise UsageError(f"--set {text}: give SETTING=VALUE, or SERVICE.SETTING=VALUE for the pipeline")
        result.setdefault(of or service, {})[name] = value
    return result


def _models(folder: Path, found: Survey) -> list[Envelope]:
    """Messages of a model folder, addressed to each site of the recording."""
    from eigenscan.eigenspace.folder import read_models
    from eigenscan.mapbuilder.core import MapbuilderCore
    from eigenscan.mapbuilder.settings import MapbuilderSettings

    built = read_models(folder)
    return [
        envelope
        for site in sorted(found.sites)
        for envelope in MapbuilderCore(MapbuilderSettings(), built, site=site).start()
    ]
