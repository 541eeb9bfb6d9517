"""`eigenscan simulate`: a simulated robot's recording and its true path, or the robot live on Zenoh."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.cli.former import optional
from eigenscan.cli.names import check_names
from eigenscan.cli.paths import check_map_output, check_others
from eigenscan.runtime.errors import UsageError
from eigenscan.schemas.channels import DEFAULT_ROBOT, DEFAULT_SITE

if TYPE_CHECKING:
    from eigenscan.geometry.gridmap import GridMap
    from eigenscan.workbench.simulation.lidar import Lidar
    from eigenscan.workbench.simulation.stage import Fleet, Stage, Timed


CARRIED_M = 0.5
"""No robot drives that far from one tick to the next."""


def simulate(
    map_file: Annotated[
        Path | None, typer.Argument(metavar="MAP", help="map_server yaml; default: the demo's own building")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="MCAP to write")] = None,
    truth: Annotated[Path | None, typer.Option(help="true path to write, TUM: t x y z qx qy qz qw")] = None,
    save_map: Annotated[Path | None, typer.Option(help="yaml to write the map to, with its pgm")] = None,
    seconds: Annotated[float, typer.Option(min=0.1, max=100_000.0, help="length of the drive, s")] = 60.0,
    kidnap: Annotated[float | None, typer.Option(help="carry the robot elsewhere at this second")] = None,
    seed: Annotated[int, typer.Option(min=0, help="the same seed gives the same bytes")] = 1,
    people: Annotated[int, typer.Option(min=0, max=1000, help="people who walk about")] = 3,
    boxes: Annotated[int, typer.Option(min=0, help="boxes that stand about and are not in the map")] = 0,
    robots: Annotated[
        int, typer.Option(min=1, max=1000, help="robots; several are named ROBOT1, ROBOT2, ...")
    ] = 1,
    drift: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=1000.0,
            help="times the usual noise of odometry",
            rich_help_panel="Lidar and odometry",
        ),
    ] = 1.0,
    lidar: Annotated[
        str, typer.Option(metavar="MODEL", help="such as rplidar-a2; a wrong one names all")
    ] = "generic",
    beams: Annotated[
        int | None,
        typer.Option(
            min=2, max=100_000, help="beams, instead of the model's", rich_help_panel="Lidar and odometry"
        ),
    ] = None,
    fov: Annotated[
        float | None,
        typer.Option(
            min=1.0, max=360.0, help="degrees, instead of the model's", rich_help_panel="Lidar and odometry"
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            min=0.1, max=50.0, help="scans a second, instead of its", rich_help_panel="Lidar and odometry"
        ),
    ] = None,
    range_max: Annotated[
        float | None,
        typer.Option(
            min=0.5, max=1000.0, help="m of reach, instead of its", rich_help_panel="Lidar and odometry"
        ),
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=10.0,
            help="m, deviation of a range, instead of its",
            rich_help_panel="Lidar and odometry",
        ),
    ] = None,
    missing: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=1.0,
            help="share of beams that are lost, instead of its",
            rich_help_panel="Lidar and odometry",
        ),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="publish on Zenoh in real time", rich_help_panel="Publishing")
    ] = False,
    speed: Annotated[
        float,
        typer.Option(min=0.01, help="with --live: times faster than real time", rich_help_panel="Publishing"),
    ] = 1.0,
    zenoh: Annotated[
        Path | None,
        typer.Option(help="with --live: Zenoh configuration, JSON5", rich_help_panel="Publishing"),
    ] = None,
    site: Annotated[
        str, typer.Option(help="first chunk of every key", rich_help_panel="Publishing")
    ] = DEFAULT_SITE,
    robot: Annotated[
        str, typer.Option(help="name of the robot", rich_help_panel="Publishing")
    ] = DEFAULT_ROBOT,
    json_file: JsonFile = None,
    map_option: Annotated[Path | None, typer.Option("--map", hidden=True)] = None,
) -> None:
    """Drive simulated robots through a map: raw scans, odometry that drifts, people, boxes, a kidnap.

    Several robots share one recording, and see each other; each has a truth of its own, TRUTH-ROBOT.tum.

    \b
    Examples:
      eigenscan simulate -o drive.mcap --truth drive.tum --save-map map.yaml --kidnap 30
      eigenscan simulate MAP.yaml -o drive.mcap --seconds 120 --seed 7 --lidar rplidar-a2 --boxes 8
      eigenscan simulate MAP.yaml -o fleet.mcap --truth fleet.tum --robots 5 --robot r
      eigenscan simulate MAP.yaml --live --speed 2
    """  # noqa: D301 - \b keeps the lines apart in --help
    map_file = optional("MAP", map_file, map_option)
    check_names(robot, site)
    if not (out or truth or save_map or live):
        raise UsageError("nothing to do: give -o FILE.mcap, --truth FILE.tum, --save-map FILE.yaml or --live")
    if not live and (zenoh or speed != 1.0):
        raise UsageError(f"{f'--zenoh {zenoh}' if zenoh else f'--speed {speed:g}'}: give --live as well")
    if kidnap is not None and not 0 < kidnap < seconds:
        raise UsageError(f"--kidnap {kidnap:g}: give a second between 0 and --seconds {seconds:g}")
    named = [path for path in (map_file, out, json_file) if path and wants_words(path)]
    if save_map:
        check_map_output("--save-map", save_map, [*named, *([truth] if truth else [])])
        named += [save_map, save_map.with_suffix(".pgm")]
    from eigenscan.geometry.gridmap import write_map
    from eigenscan.workbench.simulation.robot import OdometryNoise
    from eigenscan.workbench.simulation.stage import Fleet, Scenario

    prepare(json_file)
    grid = _map(map_file)
    changes = {"beams": beams, "rate": rate, "range_max": range_max, "noise": noise, "missing": missing}
    scenario = Scenario(
        seconds=seconds,
        kidnap=kidnap,
        seed=seed,
        people=people,
        lidar=_lidar(lidar, fov, {name: value for name, value in changes.items() if value is not None}),
        odometry=OdometryNoise(**{name: drift * value for name, value in vars(OdometryNoise()).items()}),
        site=site,
        robot=robot,
    )
    fleet = Fleet(_with_boxes(grid, boxes, seed), scenario, robots)
    truths: dict[str, Path] = {}
    for stage in fleet.stages if truth else ():
        assert truth is not None
        name = f"{truth.stem}-{stage.scenario.robot}{truth.suffix}" if robots > 1 else truth.name
        truths[stage.scenario.robot] = truth.with_name(name)
        check_others(f"--truth {truth}", truths[stage.scenario.robot], named)
    if save_map:
        write_map(grid, save_map)
    for stage in fleet.stages if truth else ():
        _write_truth(stage, truths[stage.scenario.robot])
    if out:
        _record(fleet, out, {"seed": str(seed), "map_version": grid.version})
    if live:
        _publish(fleet, seconds / speed, zenoh, speed)
    figures = {
        "seed": seed,
        "seconds": seconds,
        "map_version": grid.version,
        "map": str(save_map) if save_map else None,
        "recording": str(out) if out else None,
        "robots": {
            stage.scenario.robot: _driven(stage)
            | {"truth": str(truths[stage.scenario.robot]) if truth else None}
            for stage in fleet.stages
        },
    }
    write_figures(figures, json_file)


def _driven(stage: Stage) -> dict[str, Any]:
    """Numbers of scans, and the distance driven, without kidnaps."""
    import numpy as np

    steps = np.hypot(*np.diff(stage.poses[:, :2], axis=0).T)
    return {"scans": len(stage.scan_ticks), "metres": round(float(steps[steps < CARRIED_M].sum()), 3)}


def _lidar(model: str, fov: float | None, changes: Mapping[str, Any]) -> Lidar:
    from dataclasses import replace

    from eigenscan.workbench.simulation.lidar import LIDARS

    if model not in LIDARS:
        raise UsageError(f"--lidar {model}: choose one of {', '.join(LIDARS)}")
    lidar = replace(LIDARS[model], **changes)
    # a full turn has as many steps as beams: the last beam does not repeat the first
    if fov is not None:
        turn = math.radians(fov) if fov < 360.0 else math.tau * (lidar.beams - 1) / lidar.beams
        lidar = replace(lidar, fov=turn)
    return lidar


def _with_boxes(grid: GridMap, boxes: int, seed: int) -> GridMap:
    """The building as it is, not as its map shows it."""
    import numpy as np
    from eigenscan.workbench.simulation.world import put_boxes

    return put_boxes(grid, boxes, np.random.default_rng([seed, boxes])) if boxes else grid


def _map(path: Path | None) -> GridMap:
    from eigenscan.geometry.gridmap import read_map
    from eigenscan.workbench.simulation.world import office

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


def _record(fleet: Fleet, path: Path, about: dict[str, str]) -> None:
    from eigenscan.runtime.recording import RecordingWriter
    from eigenscan.schemas.whole import whole

    with whole(path) as part, RecordingWriter(part, {"simulation": about}) as writer:
        for timed in _watched(fleet):
            writer.write(timed.envelope, timed.time)


def _watched(fleet: Fleet) -> Iterator[Timed]:
    """The messages, with a progress bar on a terminal."""
    from eigenscan.workbench.progress import Bars

    first = fleet.stages[0]
    with Bars(transient=True) as bars:
        moved = bars.start_share("simulating")
        for timed in fleet.messages():
            yield timed
            moved((timed.time - first.epoch) * 1e-9 / first.scenario.seconds)


def _publish(fleet: Fleet, seconds: float, zenoh: Path | None, speed: float) -> None:
    from eigenscan.fleet.view import connect
    from eigenscan.runtime.bus import Bus
    from eigenscan.workbench.simulation.live import publish

    with Bus(connect(zenoh)) as bus:
        typer.echo(f"publishing for {seconds:.0f} s; Ctrl-C ends it", err=True)
        fleet.begin(time.time_ns())
        publish(fleet.messages(), bus.publish, speed)
