"""`eigenscan doctor`: finds the faults of a deployment and the fix for each."""

from __future__ import annotations

import shutil
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from eigenscan.cli.command_group import EXIT_FAILED
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.cli.names import Site
from eigenscan.runtime.errors import UsageError
from eigenscan.runtime.printable import printable
from eigenscan.schemas.channels import DEFAULT_SITE

if TYPE_CHECKING:
    from eigenscan.fleet.diagnosis import Finding

LEAST_FREE_MB = 1000
"""Free disk below which a recorder on this machine soon ends."""


def doctor(
    site: Site = DEFAULT_SITE,
    zenoh: Annotated[Path | None, typer.Option(help="Zenoh configuration, JSON5")] = None,
    robot: Annotated[
        list[str] | None, typer.Option(help="a robot that must be there; repeat for more")
    ] = None,
    seconds: Annotated[float, typer.Option(min=1.0, max=86_400.0, help="listening time, s")] = 5.0,
    json_file: JsonFile = None,
) -> None:
    """Find what is wrong with a deployment: one line for each fault, and one with its fix.

    It only listens, so it is safe on a running site. Exit code 0: all is well, 1: it found faults.

    \b
    Examples:
      eigenscan doctor --site hospital --zenoh deploy/site.json5
      eigenscan doctor --site hospital --robot r1 --robot r2 --json -
    """  # noqa: D301 - \b keeps the lines apart in --help
    prepare(json_file)
    found = [
        *_of_this_machine(),
        *_of_certificates(zenoh),
        *_of_the_site(site, zenoh, tuple(robot or ()), seconds),
    ]
    if wants_words(json_file):
        for finding in found:
            typer.echo(f"{printable(finding.where)}: {printable(finding.what)}")
            typer.echo(f"    fix: {printable(finding.mend)}")
        faults = "1 fault" if len(found) == 1 else f"{len(found)} faults"
        typer.echo(f"{faults} found" if found else f"all is well on site {site}")
    write_figures([asdict(finding) for finding in found], json_file)
    if found:
        raise typer.Exit(EXIT_FAILED)


def _of_the_site(site: str, zenoh: Path | None, robots: tuple[str, ...], seconds: float) -> list[Finding]:
    from eigenscan.fleet.configuration import robots_in
    from eigenscan.fleet.diagnosis import Finding, diagnose
    from eigenscan.fleet.view import FleetView, NoRouterError, connect

    try:
        session = connect(zenoh)
    except NoRouterError as error:
        what, _, mend = str(error).partition(": ")
        return [Finding("router", what, mend)]
    with FleetView(session, site, robots_in(zenoh), robots) as view:
        view.until(lambda: False, seconds)
        return diagnose(view)


def _of_certificates(zenoh: Path | None) -> list[Finding]:
    if zenoh is None:
        return []
    try:
        from eigenscan.fleet.expiry import of_certificates
    except UsageError:  # eigenscan[fleet] is not installed
        return []
    return list(of_certificates(zenoh))


def _of_this_machine() -> list[Finding]:
    from eigenscan.fleet.diagnosis import Finding

    free = shutil.disk_usage(Path.cwd()).free // 1_000_000
    if free >= LEAST_FREE_MB:
        return []
    return [
        Finding("this machine", f"{free} MB of disk are left", "delete old recordings, or lower budget_mb")
    ]
