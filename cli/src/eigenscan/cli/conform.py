"""`eigenscan conform`: does a program fit in a service's place?"""

from __future__ import annotations

import json
import tempfile
import uuid
from pathlib import Path
from typing import Annotated

import typer
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.runtime.errors import FailedError, UsageError


def conform(
    service: Annotated[
        str, typer.Argument(metavar="SERVICE", help="scan-ingest, projector, tracker, mapbuilder or recorder")
    ],
    command: Annotated[
        list[str], typer.Argument(metavar="-- PROGRAM...", help="after --: the program and its arguments")
    ],
    latency: Annotated[
        float, typer.Option(min=0.001, help="s within which 95 % of the answers must come")
    ] = 0.2,
    start: Annotated[float, typer.Option(min=1.0, help="s that the program may take to be ready")] = 60.0,
    speed: Annotated[float, typer.Option(min=0.1, help="times faster than the drive was")] = 1.0,
    patience: Annotated[
        float, typer.Option(min=1.0, help="times longer than the contract has it may anything else take")
    ] = 1.0,
    json_file: JsonFile = None,
    junit_file: Annotated[
        Path | None, typer.Option("--junit", help="write the results here, JUnit XML")
    ] = None,
) -> None:
    """Start any program in a service's place, play it the contract's vectors over Zenoh, and judge it.

    In the program's arguments, {zenoh}, {endpoint}, {site}, {robot} and {instance} are replaced; for a
    mapbuilder also {map}, for a recorder {recording}, a folder. The environment has the same values:
    EIGENSCAN_ZENOH and so on.
    Exit code 0: it conforms, 1: it does not, 2: it cannot be started. Checks rest on docs/contract.md.

    \b
    Examples:
      eigenscan conform tracker -- eigenscan-tracker
      eigenscan conform projector --json result.json -- python my_projector.py
      eigenscan conform recorder -- eigenscan-recorder --mcap {recording}
      eigenscan conform scan-ingest -- ./my-ingest --connect {endpoint} --site {site} --robot {robot}
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.cli.launch.network import open_hub
    from eigenscan.workbench.conformance import vectors
    from eigenscan.workbench.conformance.candidate import Candidate
    from eigenscan.workbench.conformance.check import FAILED
    from eigenscan.workbench.conformance.checks import judge
    from eigenscan.workbench.conformance.profiles import PROFILES
    from eigenscan.workbench.conformance.recording import judge_killed, judge_whole
    from eigenscan.workbench.conformance.report import figures, junit, report
    from eigenscan.workbench.conformance.trial import Observed, Terms, Trial

    for file in (json_file, junit_file):
        prepare(file)
    profile = PROFILES.get(service)
    if profile is None:
        raise UsageError(f"{service}: choose one of {', '.join(PROFILES)}")
    address = {"site": f"conform-{uuid.uuid4().hex[:8]}", "robot": "r1"}
    vector = vectors.load(profile.file, profile.inputs, (*profile.outputs, *profile.reference), address)
    seen = Observed(profile, vector, address, instance="candidate")
    with tempfile.TemporaryDirectory() as place:
        session, others = open_hub(Path(place), patience)
        (endpoint,) = json.loads(others.read_text(encoding="utf-8"))["connect"]["endpoints"]
        places = {"zenoh": str(others), "endpoint": endpoint, **address, "instance": seen.instance}
        if profile.records:
            places["recording"] = str(Path(place) / "ended")
        elif profile.asks is None:
            places["map"] = str(vectors.folder() / vectors.MAP_FILE)
        trial = Trial(session, others, seen, Terms(start, speed=speed, patience=patience))
        with trial.prepared(), Candidate(command, places) as candidate:
            trial.run(candidate)
        if profile.records:
            seen.kept = judge_whole(Path(place) / "ended", seen.published)
            again = places | {"recording": str(Path(place) / "killed")}
            with Candidate(command, again) as candidate:
                killed = trial.kill(candidate)
            seen.kept.append(judge_killed(Path(place) / "killed", seen.published, killed, patience))
    checks = judge(seen, latency, patience)
    if wants_words(json_file):
        typer.echo(report(seen, checks))
    write_figures(figures(seen, checks, command), json_file)
    if junit_file:
        junit_file.write_text(junit(seen, checks), encoding="utf-8")
    failed = [check.name for check in checks if check.result == FAILED]
    if failed:
        raise FailedError(f"{command[0]} does not conform to {service}: {', '.join(failed)}")
    if wants_words(json_file):
        typer.echo(f"{command[0]} conforms to {service}")
