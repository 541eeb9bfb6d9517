"""Names of a site and a robot on a command line."""

from __future__ import annotations

from typing import Annotated

import typer
from eigenscan.runtime.errors import UsageError
from eigenscan.schemas.channels import is_chunk


def check_names(robot: str | None, site: str | None) -> None:
    """Raises UsageError for a name that no key can have; None is none."""
    for option, value in (("--robot", robot), ("--site", site)):
        if value is not None and not is_chunk(value):
            raise UsageError(f"{option} {value!r}: a name has no blanks and none of / * $ # ? @")


def _checked(site: str) -> str:
    check_names(None, site)
    return site


Site = Annotated[str, typer.Option(callback=_checked, help="name of the site")]
"""The site that a command listens to."""
