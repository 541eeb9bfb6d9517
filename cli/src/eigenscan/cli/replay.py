"""`eigenscan replay`: a recording into a service's core, and its answers compared."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from eigenscan.cli.figures import JsonFile, prepare
from eigenscan.cli.process_replay import process_replay


def replay(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="recording, MCAP; or a folder of them, joined")
    ],
    service: Annotated[
        str, typer.Option(help="scan-ingest, projector, tracker, or pipeline: all three in a row")
    ],
    compare: Annotated[
        bool, typer.Option("--compare", help="exit code 1 if the answers differ from the recorded ones")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="write inputs and answers, MCAP")] = None,
    model: Annotated[Path | None, typer.Option(help="model folder, instead of the recorded models")] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", help="SETTING=VALUE other than recorded; repeat for more"),
    ] = None,
    tolerant: Annotated[
        bool, typer.Option("--tolerant", help="with --compare: small numerical differences pass")
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="with --compare: also compare what arrival order decides")
    ] = False,
    ignore: Annotated[
        list[str] | None, typer.Option(help="with --compare: CHANNEL.FIELD not to compare; repeat for more")
    ] = None,
    least: Annotated[int, typer.Option(min=1, help="with --compare: messages that must be compared")] = 10,
    rrd: Annotated[
        Path | None,
        typer.Option(help="with --compare: Rerun file of a difference; FILE.SERVICE.rrd beside FILE without"),
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Feed a recording to a service's core, without Zenoh, and compare the answers with the recorded ones.

    Exit code 0: identical, 1: a difference, or too little to compare, 2: the recording cannot be replayed.
    To publish a recording on Zenoh: eigenscan play.

    \b
    Examples:
      eigenscan replay night.mcap --service tracker --compare
      eigenscan replay night.mcap --service pipeline --set trust=0.5 --out tried.mcap
    """  # noqa: D301 - \b keeps the lines apart in --help
    prepare(json_file)
    process_replay(
        *(file, service),
        compare=compare,
        out=out,
        model=model,
        changes=changes or (),
        tolerant=tolerant,
        strict=strict,
        ignored=ignore or (),
        least=least,
        rrd=rrd,
        json_file=json_file,
    )
