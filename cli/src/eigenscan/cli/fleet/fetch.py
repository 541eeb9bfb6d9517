"""`eigenscan fleet fetch`: a robot's recordings of some time, over the air, on request."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.cli.moment import INSTANT, instant
from eigenscan.cli.names import Site
from eigenscan.runtime.errors import UsageError
from eigenscan.schemas.channels import DEFAULT_SITE, is_chunk


def fetch(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="the robot's name")],
    begin: Annotated[
        str,
        typer.Option(
            "--from",
            metavar=INSTANT,
            help="begin: how long ago (15m, 2h), a time of day in UTC (03:12), or 2026-01-31T03:12",
        ),
    ],
    end: Annotated[str, typer.Option("--to", metavar=INSTANT, help="end, likewise")] = "now",
    out: Annotated[
        Path, typer.Option("--out", "-o", help="folder; each robot's files are in one of its own")
    ] = Path("out/fetched"),
    site: Site = DEFAULT_SITE,
    zenoh: Annotated[Path | None, typer.Option(help="Zenoh configuration, JSON5")] = None,
    seconds: Annotated[float, typer.Option(min=1.0, max=86_400.0, help="s to wait for each answer")] = 10.0,
    json_file: JsonFile = None,
) -> None:
    """Fetch a robot's recordings of a period.

    Whole files arrive, by the robot's clock; an open one as far as it is written. The same command resumes
    after a break and fetches only what is missing. Poses have priority on the link. Exit code 0: complete,
    1: incomplete.

    \b
    Examples:
      eigenscan fleet fetch r17 --from 15m --site hospital --zenoh /etc/eigenscan/operator.json5
      eigenscan fleet fetch r17 --from 03:10 --to 03:20 --out night
      eigenscan view out/fetched/r17
    """  # noqa: D301 - \b keeps the lines apart in --help
    if not is_chunk(robot) or "," in robot:
        raise UsageError(f"{robot!r}: is no robot's name; give one robot")
    now = time.time_ns()
    begin_ns, end_ns = instant("--from", begin, now), instant("--to", end, now)
    if begin_ns >= end_ns:
        raise UsageError(f"--from {begin} --to {end}: --from must be earlier")
    from eigenscan.fleet.fetch import asker, missing_bytes, parts_within, utc
    from eigenscan.fleet.fetch import fetch as fetch_one
    from eigenscan.fleet.view import connect
    from eigenscan.workbench.progress import Bars

    prepare(json_file)
    if out.exists() and not out.is_dir():
        raise UsageError(f"--out {out}: is no folder: name one")
    folder = out / robot  # two robots may name their files alike
    with connect(zenoh) as session:
        ask = asker(session, site, robot, seconds)
        parts = parts_within(ask, robot, begin_ns, end_ns)
        missing, came = max(missing_bytes(parts, folder), 1), 0
        with Bars() as bars:
            share = bars.start_share(f"from {robot}")

            def moved(size: int) -> None:
                nonlocal came
                came += size
                share(min(came / missing, 1.0))

            fetched = [fetch_one(ask, part, folder, moved) for part in parts]
            share(1.0)
    if wants_words(json_file):
        for one in fetched:
            state = "" if one.part.closed else ", still being written there"
            span = f"{utc(one.part.begin_ns)} to {utc(one.part.end_ns)}, {one.part.size / 1e6:.1f} MB{state}"
            typer.echo(f"{one.path}: {span}" + ("" if one.bytes_moved else ", was here"))
    write_figures(
        {
            "robot": robot,
            "folder": str(folder),
            "bytes_moved": sum(one.bytes_moved for one in fetched),
            "files": [
                {
                    "path": str(one.path),
                    "begin_ns": one.part.begin_ns,
                    "end_ns": one.part.end_ns,
                    "bytes": one.part.size,
                    "closed": one.part.closed,
                }
                for one in fetched
            ],
        },
        json_file,
    )
