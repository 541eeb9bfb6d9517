"""`eigenscan simulate`: a simulated robot's recording and its true path, or the robot live on Zenoh."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from eigenscan.cli.frame import UsageError
from eigenscan.schemas.channels import DEFAULT_ROBOT, DEFAULT_SITE

if TYPE_CHECKING:
    from eigenscan.cli.simulation.stage import Stage, Timed
    from eigenscan.geometry.gridmap import GridMap


def simulate(
    map_file: Annotated[
        Path | None, typer.Option("--map", help="map_server yaml; without it the demo's own building")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="MCAP to write")] = None,
    truth: Annotated[Path | None, typer.Option(help="true path to write, TUM: t x y z qx qy qz qw")] = None,
    save_map: Annotated[Path | None, typer.Option(help="yaml to write the map to, with its pgm")] = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="length of the drive, s")] = 60.0,
    kidnap: Annotated[float | None, typer.Option(help="carry the robot elsewhere at this second")] = None,
    seed: Annotated[int, typer.Option(min=0, help="the same seed gives the same bytes")] = 1,
    people: Annotated[int, typer.Option(min=0, help="people who walk about")] = 3,
    beams: Annotated[int, typer.Option(min=2, help="beams of the lidar")] = 361,
    fov: Annotated[float, typer.Option(min=1.0, max=360.0, help="field of view, degrees")] = 180.0,
    rate: Annotated[float, typer.Option(min=0.1, max=50.0, help="scans a second")] = 10.0,
    range_max: Annotated[float, typer.Option(min=0.5, help="reach of the lidar, m")] = 30.0,
    noise: Annotated[float, typer.Option(min=0.0, help="standard deviation of a range, m")] = 0.015,
    missing: Annotated[float, typer.Option(min=0.0, max=1.0, help="share of beams that are lost")] = 0.01,
    live: Annotated[bool, typer.Option("--live", help="publish on Zenoh in real time")] = False,
    speed: Annotated[float, typer.Option(min=0.01, help="with --live: times faster than real time")] = 1.0,
    zenoh: Annotated[Path | None, typer.Option(help="with --live: Zenoh configuration, JSON5")] = None,
    site: Annotated[str, typer.Option(help="first chunk of every key")] = DEFAULT_SITE,
    robot: Annotated[str, typer.Option(help="name of the robot")] = DEFAULT_ROBOT,
) -> None:
    """Drive a simulated robot through a map: raw scans, odometry that drifts, people, a kidnap.

    \b
    Examples:
      eigenscan simulate -o drive.mcap --truth drive.tum --save-map map.yaml --kidnap 30
      eigenscan simulate --map MAP.yaml -o drive.mcap --seconds 120 --seed 7 --fov 270 --beams 1080
      eigenscan simulate --map MAP.yaml --live --speed 2
    """  # noqa: D301 - \b keeps the lines apart in --help
    if not (out or truth or save_map or live):
        raise UsageError("nothing to do: give -o FILE.mcap, --truth FILE.tum, --save-map FILE.yaml or --live")
    if kidnap is not None and not 0 < kidnap < seconds:
        raise UsageError(f"--kidnap {kidnap:g}: give a second between 0 and --seconds {seconds:g}")
    from eigenscan.cli.simulation.lidar import Lidar
    from eigenscan.cli.simulation.stage import Scenario, Stage
    from eigenscan.geometry.gridmap import write_map

    grid = _map(map_file)
    # a full turn has as many steps as beams: the last beam does not repeat the first
    turn = math.radians(fov) if fov < 360.0 else math.tau * (beams - 1) / beams
    lidar = Lidar(beams=beams, fov=turn, rate=rate, range_max=range_max, noise=noise, missing=missing)
    scenario = Scenario(
        seconds=seconds,
        kidnap=kidnap,
        seed=seed,
        people=people,
        lidar=lidar,
        site=site,
        robot=robot,
    )
    stage = Stage(grid, scenario)
    if save_map:
        write_map(grid, save_map)
    if truth:
        _write_truth(stage, truth)
    if out:
        _record(stage, out)
    if live:
        _publish(stage, zenoh, speed)


def _map(path: Path | None) -> GridMap:
    from eigenscan.cli.simulation.world import office
    from eigenscan.geometry.gridmap import read_map

    return read_map(path) if path else office().render()


def _write_truth(stage: Stage, path: Path) -> None:
    """One line a scan; seconds and metres, the robot's base in the map frame."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8") as file:
        for tick in stage.scan_ticks.tolist():
            time, (x, y, theta) = int(stage.times[tick]), stage.poses[tick].tolist()
            seconds = f"{time // 10**9}.{time % 10**9:09d}"
            file.write(
                f"{seconds} {x:.6f} {y:.6f} 0 0 0 {math.sin(theta / 2):.9f} {math.cos(theta / 2):.9f}\n"
            )


def _record(stage: Stage, path: Path) -> None:
    from eigenscan.runtime.recording import RecordingWriter

    scenario = stage.scenario
    metadata = {"simulation": {"seed": str(scenario.seed), "map_version": stage.grid.version}}
    with RecordingWriter(path, metadata) as writer:
        for timed in _watched(stage):
            writer.write(timed.envelope, timed.time)


def _watched(stage: Stage) -> Iterator[Timed]:
    """The messages, with a progress bar on a terminal."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as progress:
        bar = progress.add_task("simulating", total=stage.scenario.seconds)
        for timed in stage.messages():
            yield timed
            progress.update(bar, completed=(timed.time - stage.epoch) * 1e-9)


def _publish(stage: Stage, zenoh: Path | None, speed: float) -> None:
    from eigenscan.cli.simulation.live import publish
    from eigenscan.runtime.bus import Bus
    from eigenscan.runtime.session import open_session

    with Bus(open_session(zenoh)) as bus:
        typer.echo(f"publishing for {stage.scenario.seconds / speed:.0f} s; Ctrl-C ends it", err=True)
        stage.epoch = time.time_ns()
        publish(stage.messages(), bus.say, speed)
