"""`eigenscan replay-test`: a folder of recordings as a test suite."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.runtime.errors import FailedError, UsageError


def replay_test(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="folder; each .mcap in it is a test")],
    service: Annotated[
        list[str] | None,
        typer.Option(help="scan-ingest, projector, tracker or pipeline; repeat for more; default: all"),
    ] = None,
    update: Annotated[
        bool, typer.Option("--update", help="accept the answers of today as the reference")
    ] = False,
    junit_file: Annotated[Path | None, typer.Option("--junit", help="write results here, JUnit XML")] = None,
    tolerant: Annotated[
        bool, typer.Option("--tolerant", help="let small numerical differences pass, as on another machine")
    ] = False,
    least: Annotated[int, typer.Option(min=1, help="messages that a test must compare")] = 10,
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", min=0, help="recordings at a time; 0: one a core; same answers")
    ] = 0,
    json_file: JsonFile = None,
) -> None:
    """Replay every recording of a folder into the services of today, and compare their answers.

    A recording is its own reference, unless NAME.reference.mcap lies beside NAME.mcap; --update writes that.
    Exit code 0: all the same, 1: a difference, 2: a recording that cannot be replayed.

    \b
    Examples:
      eigenscan replay-test incidents --junit results.xml
      eigenscan replay-test incidents --service tracker --update
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.workbench.one_thread import one_thread

    one_thread()
    from eigenscan.workbench.replay import suite
    from eigenscan.workbench.replay.services import CHOICES, PIPELINE

    for name in service or ():
        if name not in CHOICES:
            raise UsageError(f"--service {name}: choose one of {', '.join(CHOICES)}")
    if update and PIPELINE in (service or ()) and len(service or ()) > 1:
        raise UsageError(f"--update --service {PIPELINE}: alone, for it gives the answers of the others")
    for file in (json_file, junit_file):
        prepare(file)
    files = suite.recordings(folder)
    plan = suite.Plan(tuple(service or ()), tolerant, least)

    def show_case(case: suite.Case) -> None:
        if not wants_words(json_file):
            return
        typer.echo(f"{case.result:9}  {case.recording.name}  {case.choice}: {case.line}")
        if case.result == suite.DIFFERENT:
            typer.echo("".join(f"    {line}\n" for line in case.text.splitlines()), nl=False)

    if update:
        cases = []
        for path in files:
            cases.append(suite.update(path, plan))
            show_case(cases[-1])
    else:
        cases = suite.run_all(files, plan, show_case, jobs or len(os.sched_getaffinity(0)))
    if junit_file:
        junit_file.write_text(suite.junit(cases), encoding="utf-8")
    write_figures([{**vars(case), "recording": str(case.recording)} for case in cases], json_file)
    different = sum(case.result == suite.DIFFERENT for case in cases)
    bad = sum(case.result == suite.BAD for case in cases)
    counted = f"{folder}: {different} different and {bad} bad of {len(cases)} tests"
    if different:
        raise FailedError(counted)
    if bad:
        raise UsageError(counted)
    if wants_words(json_file):
        typer.echo(f"{folder}: {len(cases)} references" if update else f"{folder}: all {len(cases)} the same")
