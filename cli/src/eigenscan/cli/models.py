"""`eigenscan models`: the versions of a model folder, back to an older one, on to one that is proposed."""

from __future__ import annotations

import time
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eigenscan.eigenspace.versions import Version


class Action(StrEnum):
    """Actions on a model folder."""

    LIST = "list"
    ROLLBACK = "rollback"
    ACCEPT = "accept"


def _action(text: str) -> Action:
    if text not in {*Action}:
        raise typer.BadParameter(f"give list, rollback or accept first: eigenscan models list {text}")
    return Action(text)


def models(
    action: Annotated[
        Action,
        typer.Argument(
            parser=_action,
            metavar="list|rollback|accept",
            help="list the versions, go back to one, or accept what is proposed",
        ),
    ],
    folder: Annotated[Path, typer.Argument(metavar="MODEL", help="folder that eigenscan build wrote")],
    version: Annotated[
        str | None,
        typer.Argument(
            help="the version, or how it begins; without it the newest older one, or the one proposed",
            metavar="VERSION",
        ),
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """List the versions of a model folder, put an older one in use again, or one that is proposed.

    A build into a folder that holds models keeps what it replaces, the last five versions, in
    MODEL.versions. A rollback checks the old version and swaps it in, in one step; what was in use is kept.
    A mapbuilder that keeps the map true proposes versions there; each has a picture, change.png. A mapbuilder
    that runs publishes what comes into use within seconds.

    \b
    Examples:
      eigenscan models list MODEL
      eigenscan models rollback MODEL
      eigenscan models rollback MODEL 7ce7719a
      eigenscan models accept MODEL
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.eigenspace.folder import read_models
    from eigenscan.eigenspace.versions import accept, choose, choose_proposal, replace, versions
    from eigenscan.runtime.errors import UsageError

    prepare(json_file)
    if action is Action.LIST:
        if version is not None:
            raise UsageError(f"list takes no version, {version!r} was given: eigenscan models list {folder}")
        _show(versions(folder), json_file)
        return
    pick, put = (choose, replace) if action is Action.ROLLBACK else (choose_proposal, accept)
    chosen = pick(versions(folder), version, folder)
    read_models(chosen.folder)  # a damaged one must not come into use
    put(folder, chosen.folder)
    _show(versions(folder)[:1], json_file)


def _show(found: Sequence[Version], json_file: Path | None) -> None:
    """The versions, the one in use first."""
    figures = []
    for number, version in enumerate(found):
        if wants_words(json_file):
            built = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(version.built))
            proposed = f"  proposed: {version.folder / 'change.png'}" if version.proposed_for else ""
            typer.echo(
                f"{' ' if number else '*'} {version.version[:12]}  {built}  {version.regions:4} regions  "
                f"{version.free_area_m2:7.0f} m²  {version.wire_bytes / 1e6:6.1f} MB{proposed}"
            )
        figures.append({**vars(version), "folder": str(version.folder), "in_use": number == 0})
    write_figures(figures, json_file)
