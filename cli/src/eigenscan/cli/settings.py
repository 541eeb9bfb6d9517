"""Options of the commands that take the services' settings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from eigenscan.schemas.methods import METHODS

Method = Annotated[str, typer.Option("--method", help=f"settings that belong together: {', '.join(METHODS)}")]
SettingsFile = Annotated[
    Path | None,
    typer.Option(
        "--settings",
        help="TOML file with the services' settings, as their own --config takes",
        rich_help_panel="Details",
    ),
]
Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="SERVICE.SETTING=VALUE",
        help="change one setting, such as tracker.localized_above=0.95; repeat for more; docs/settings.md",
    ),
]
