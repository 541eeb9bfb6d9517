"""`eigenscan demo`: a robot that knows nothing finds itself, is kidnapped, and finds itself again."""

from __future__ import annotations

import time
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from eigenscan.cli.command_group import EXIT_FAILED
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.cli.former import optional
from eigenscan.runtime.errors import UsageError


def demo(
    map_file: Annotated[
        Path | None, typer.Argument(metavar="MAP", help="map_server yaml; default: the demo's own building")
    ] = None,
    real: Annotated[
        bool, typer.Option("--real", help="a real robot's log instead: 35 s in the Intel Research Lab")
    ] = False,
    headless: Annotated[
        bool, typer.Option("--headless", help="no viewer; ends by itself, exit code 1 if not found again")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="folder for all files; out/demo-<time> without it")
    ] = None,
    seconds: Annotated[
        float, typer.Option(min=10.0, max=100_000.0, help="length; the kidnap is halfway, s")
    ] = 60.0,
    speed: Annotated[float, typer.Option(min=0.1, max=20.0, help="times faster than real time")] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="of route, noise and people")] = 1,
    people: Annotated[int, typer.Option(min=0, max=1000, help="people who walk about")] = 3,
    json_file: JsonFile = None,
    map_option: Annotated[Path | None, typer.Option("--map", hidden=True)] = None,
) -> None:
    """Watch a robot find itself, get kidnapped, and find itself again.

    Starts every service as a process on this machine; nothing has to be configured.

    \b
    Examples:
      eigenscan demo
      eigenscan demo --real
      eigenscan demo --headless
      eigenscan demo MAP.yaml --seed 7 --seconds 120
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.cli.demonstration.show import Demonstration
    from eigenscan.geometry.gridmap import read_map
    from eigenscan.workbench.simulation.recorded import INTEL, Recorded
    from eigenscan.workbench.simulation.stage import Scenario, Stage
    from eigenscan.workbench.simulation.world import STORE, office

    map_file = optional("MAP", map_file, map_option)
    if real and map_file:
        raise UsageError("--real has its own map: leave out MAP, or leave out --real")
    folder = out or Path("out") / f"demo-{datetime.now():%Y%m%d-%H%M%S}"
    if (folder / "demo.mcap").exists():
        raise UsageError(f"--out {folder}: holds a demo already; give a new folder")
    site = f"demo-{time.time_ns():x}"
    prepare(json_file)
    stage: Stage | Recorded
    if real:
        stage = Recorded(INTEL, site)
    else:
        scenario = Scenario(
            seconds=seconds,
            kidnap=seconds / 2,
            seed=seed,
            people=people,
            kidnap_to=None if map_file else STORE,
            site=site,
        )
        stage = Stage(read_map(map_file) if map_file else office().render(), scenario)
    demonstration = Demonstration(
        stage, folder, speed, viewer=not headless, to_stderr=not wants_words(json_file)
    )
    found = demonstration.run()
    write_figures(demonstration.figures or {"found": False}, json_file)
    if not found:
        raise typer.Exit(EXIT_FAILED)
