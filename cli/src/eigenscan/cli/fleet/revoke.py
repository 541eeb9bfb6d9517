"""`eigenscan fleet revoke`: shut out a certificate that is in wrong hands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def revoke(
    name: Annotated[str, typer.Argument(help="robot, service of the site, or group", metavar="NAME")],
    folder: Annotated[Path, typer.Option("-o", "--fleet", help="the fleet's folder")] = Path("fleet"),
) -> None:
    """Shut out a robot whose certificate is in wrong hands: stolen, lost, sold.

    The site's router then passes nothing to it or from it. All other robots localize alone meanwhile and
    reconnect within seconds. A new certificate for the same name (eigenscan fleet certify --robot NAME) does
    not admit the old one.

    \b
    Example:
      eigenscan fleet revoke r17 -o fleet
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.fleet import layout

    kept = layout.revoke(folder, name)
    router = folder / "site" / "router.json5"
    typer.echo(f"{kept.name}: is no longer in {router}")
    typer.echo(
        "copy the file to the site's router; with end_on_change (our fleet deployment) it restarts, "
        "any other must be restarted",
        err=True,
    )
    listed = folder / "operator" / "operator.json5"
    if listed.exists():
        typer.echo(
            f"copy {listed} to the operator's machine, where doctor misses the robot otherwise", err=True
        )
    for line in layout.left_out(folder):
        typer.echo(line, err=True)
