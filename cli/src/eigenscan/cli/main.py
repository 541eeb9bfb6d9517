"""The `eigenscan` command: one module of this folder for each subcommand."""

from __future__ import annotations

from importlib.metadata import version as package_version
from typing import Annotated

import typer

app = typer.Typer(
    name="eigenscan",
    help="Tells a robot with a 2D lidar where it is, from nothing.",
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
    rich_markup_mode=None,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(package_version("eigenscan-cli"))
        raise typer.Exit


@app.callback()
def _root(
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and end."),
    ] = False,
) -> None:
    pass
