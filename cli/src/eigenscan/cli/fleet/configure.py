"""`eigenscan fleet configure`: writes the fleet's configuration again, after a change of fleet.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def configure(
    folder: Annotated[Path, typer.Option("-o", "--fleet", help="the fleet's folder")] = Path("fleet"),
) -> None:
    """Write the configuration of every router and service again, after a change of fleet.toml.

    Copy to each machine what has changed. Routers read it when they start.

    \b
    Example: in fleet/fleet.toml, let a robot send its raw scans to the site for a while
      [robots.r17]
      scan_raw = 5.0
    then
      eigenscan fleet configure -o fleet
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.fleet import layout

    layout.configure(folder)
    typer.echo(f"{folder}: configured for {', '.join(layout.robots(folder)) or 'no robot yet'}")
    for line in layout.left_out(folder):
        typer.echo(line, err=True)
