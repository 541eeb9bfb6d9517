"""What `eigenscan replay --service` does."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from eigenscan.cli.figures import wants_words, write_figures
from eigenscan.runtime.errors import FailedError, UsageError

if TYPE_CHECKING:
    from eigenscan.schemas.envelope import Envelope
    from eigenscan.workbench.replay.survey import Survey


@dataclass(frozen=True)
class Request:
    """The options of a process replay, as they were given."""

    file: Path
    service: str
    compare: bool
    out: Path | None
    model: Path | None
    changes: Sequence[str]
    tolerant: bool
    strict: bool
    ignored: Sequence[str]
    least: int
    rrd: Path | None = None
    json_file: Path | None = None


def process_replay(request: Request) -> None:
    """Replays, reports, and raises FailedError for a difference."""
    from eigenscan.workbench.one_thread import one_thread

    one_thread()
    from eigenscan.workbench.replay.comparison import Terms
    from eigenscan.workbench.replay.report import figures, report, summary
    from eigenscan.workbench.replay.services import ARRIVAL, CHOICES
    from eigenscan.workbench.replay.survey import survey
    from eigenscan.workbench.replay.trial import Trial, picture, picture_beside, run

    if request.service not in CHOICES:
        raise UsageError(f"--service {request.service}: there are {', '.join(CHOICES)}")
    if not (request.compare or request.out):
        raise UsageError("--service: give --compare, --out FILE, or both")
    found = survey(request.file)
    if request.out and request.out.exists() and request.out.samefile(request.file):
        raise UsageError(f"--out {request.out}: is the recording itself: choose another file")
    trial = Trial(
        CHOICES[request.service],
        Terms(
            tolerant=request.tolerant,
            ignored=frozenset(_fields(request.ignored)),
            unjudged={} if request.strict else ARRIVAL,
            least=request.least,
        ),
        _changes(request.changes, request.service),
        _models(request.model, found) if request.model else (),
        out=request.out,
    )
    with _progress(found) as moved:
        outcome = run(trial, found, moved)
    wordy = wants_words(request.json_file)
    if wordy:
        typer.echo(report(outcome))
    differs = request.compare and bool(outcome.comparison.problems)
    target = request.rrd or picture_beside(request.file, request.service)
    drawn = differs and picture(trial, outcome, report(outcome), target)
    written = {
        "recording": str(request.file),
        "result": ("different" if differs else "same") if request.compare else None,
        "picture": str(target) if drawn else None,
    }
    write_figures(written | figures(outcome), request.json_file)
    if drawn and wordy:
        typer.echo(f"both sides: {target}")
    if differs:
        raise FailedError(f"{request.file}: {summary(outcome)}")
    if request.compare and wordy:
        typer.echo(f"the same: {summary(outcome)}")


def _fields(names: Sequence[str]) -> Iterator[str]:
    from eigenscan.schemas.channels import by_name

    for name in names:
        channel, _, path = name.partition(".")
        known = by_name(channel).message.DESCRIPTOR.fields_by_name
        if path.partition(".")[0] not in known:
            raise UsageError(f"--ignore {name}: give CHANNEL.FIELD; {channel} has {', '.join(known)}")
        yield name


def _changes(given: Sequence[str], service: str) -> dict[str, dict[str, str]]:
    """`--set` by service and setting; a setting without a service is of the one that is replayed."""
    result: dict[str, dict[str, str]] = {}
    for text in given:
        place, equals, value = text.partition("=")
        of, _, name = place.rpartition(".")
        if not equals or not name:
            raise UsageError(f"--set {text}: give SETTING=VALUE, or SERVICE.SETTING=VALUE for the pipeline")
        result.setdefault(of or service, {})[name] = value
    return result


def _models(folder: Path, found: Survey) -> list[Envelope]:
    """The messages of a model folder, for the site of the recording."""
    from eigenscan.eigenspace.folder import read_models
    from eigenscan.mapbuilder.core import MapbuilderCore
    from eigenscan.mapbuilder.settings import MapbuilderSettings

    built = read_models(folder)
    return [
        envelope
        for site in sorted(found.sites)
        for envelope in MapbuilderCore(MapbuilderSettings(), built, site=site).start()
    ]


@contextmanager
def _progress(found: Survey) -> Iterator[Callable[[int], None]]:
    """A bar in seconds of the recording; gives what moves it, by log time in ns."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bars:
        bar = bars.add_task("replay", total=max(found.end - found.begin, 1))
        yield lambda time: bars.update(bar, completed=time - found.begin)
