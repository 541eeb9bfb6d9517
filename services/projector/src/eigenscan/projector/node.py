"""Entry point of the projector."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eigenscan.schemas.extra import needs

with needs("eigenscan-projector[node]", SystemExit):
    from eigenscan.projector.options import ProjectorOptions
    from eigenscan.projector.port import LocalizePort
    from eigenscan.runtime.node import Service
    from eigenscan.runtime.node import main as run


if TYPE_CHECKING:
    from eigenscan.projector.core import ProjectorCore


def _make_core(options: ProjectorOptions) -> ProjectorCore:
    from eigenscan.projector.core import (
        ProjectorCore,
    )  # numba takes its time, and neighbours are found meanwhile
    from eigenscan.projector.table_folder import TableFolder, in_a_thread
    from eigenscan.projector.warm_up import warm_up

    warm_up(options)
    store = TableFolder(options.keep / "tables") if options.keep is not None else None
    return ProjectorCore(options, options.instance, store, in_a_thread)


_PORT = LocalizePort()
SERVICE = Service(
    "projector",
    ProjectorOptions,
    _make_core,
    make_port=lambda _: _PORT,
    attend=_PORT.attend,
    quick=True,
    compiles=True,
)


def main() -> None:
    """Runs the projector until SIGTERM or SIGINT."""
    run(SERVICE)
