"""`eigenscan run`: all services for one's own map and robot, in one command."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

import typer
from eigenscan.cli.figures import JsonFile, events, prepare, wants_words
from eigenscan.cli.former import positional
from eigenscan.cli.names import check_names
from eigenscan.cli.settings import Changes, Method, SettingsFile
from eigenscan.runtime.errors import UsageError
from eigenscan.schemas.channels import DEFAULT_ROBOT, DEFAULT_SITE

REPLACEABLE = ("scan-ingest", "projector", "tracker", "mapbuilder")

DECIDED = {"site", "robot", "instance", "zenoh"}
"""Settings that run itself gives to all services."""

MAP_S = 30.0
"""Longest wait for the robot's own map, s."""


def run(
    map_or_model: Annotated[
        Path | None,
        typer.Argument(
            metavar="MAP",
            help="map_server yaml, or a model folder of eigenscan build; with --ros2: else the robot's /map",
        ),
    ] = None,
    robot: Annotated[str, typer.Option(help="name of the robot, a chunk of its keys")] = DEFAULT_ROBOT,
    site: Annotated[str, typer.Option(help="first chunk of every key")] = DEFAULT_SITE,
    zenoh: Annotated[
        Path | None,
        typer.Option(help="Zenoh configuration, JSON5; without it programs of this machine alone can join"),
    ] = None,
    listen: Annotated[
        list[str] | None,
        typer.Option(
            help="also let other machines in by this endpoint, such as tcp/0.0.0.0:7447; needs --insecure"
        ),
    ] = None,
    insecure: Annotated[
        bool,
        typer.Option(
            "--insecure", help="with --listen: any program that reaches it may read and forge every message"
        ),
    ] = False,
    ros2: Annotated[
        Literal["rmw_zenoh", "rmw_zenoh_humble", "ros2dds"] | None,
        typer.Option(help="also the bridge to a robot with ROS 2, by what it speaks on Zenoh: docs/ros2.md"),
    ] = None,
    ros2_router: Annotated[
        str | None,
        typer.Option(
            help="with --ros2: where the robot's rmw_zenohd or DDS bridge listens; else tcp/localhost:7447"
        ),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SERVICE",
            help="leave out a service that your own program replaces: docs/conform.md; repeat for more",
            rich_help_panel="Details",
        ),
    ] = None,
    together: Annotated[
        bool,
        typer.Option(
            "--together",
            help="all services in one process: less CPU time and memory",
            rich_help_panel="Details",
        ),
    ] = False,
    viewer: Annotated[bool, typer.Option(help="serve the live web viewer on this machine")] = True,
    foxglove: Annotated[
        bool,
        typer.Option(
            "--foxglove",
            help="serve Foxglove and Lichtblick too, on ws://127.0.0.1:8765",
            rich_help_panel="Details",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="folder for recording and logs; out/run-<time> without it"),
    ] = None,
    method: Method = "default",
    settings_file: SettingsFile = None,
    changes: Changes = None,
    json_file: JsonFile = None,
    map_option: Annotated[Path | None, typer.Option("--map", hidden=True)] = None,
) -> None:
    """Start all services for your own map and robot; Ctrl-C ends them all.

    The robot's driver connects to tcp/127.0.0.1:7448. It publishes raw scans on
    SITE/robot/ROBOT/scan/raw/LIDAR and odometry on SITE/robot/ROBOT/odom. The pose comes on
    SITE/robot/ROBOT/pose. With --ros2 they are the robot's /scan, /odom and /amcl_pose. --json writes a
    line for each event: ready, state (after a change), pose (one a second), ended.
    --set, --settings and --method change the services' settings (docs/settings.md); the first wins.
    --method paper runs the paper's own pipeline, for comparison.

    \b
    Examples:
      eigenscan run MAP.yaml --robot r17
      eigenscan run MAP.yaml --robot r17 --ros2 rmw_zenoh
      eigenscan run --ros2 rmw_zenoh
      eigenscan run MAP.yaml --robot r17 --without projector
      eigenscan run MODEL --robot r17 --site hospital --zenoh zenoh.json5 --no-viewer
    """  # noqa: D301 - \b keeps the lines apart in --help
    check_names(robot, site)
    left_out = without or []
    if unknown := sorted(set(left_out) - set(REPLACEABLE)):
        raise UsageError(f"--without {unknown[0]}: choose from {', '.join(REPLACEABLE)}")
    if map_option is not None or (map_or_model is None and ros2 is None and "mapbuilder" not in left_out):
        map_or_model = positional("MAP, a map_server yaml or a model folder,", map_or_model, map_option)
    if ros2_router and not ros2:
        raise UsageError(f"--ros2-router {ros2_router}: give --ros2 as well, or leave it out")
    _check_listen(listen or [], insecure, zenoh)
    chosen = _flags(method, settings_file, changes or [])
    from eigenscan.cli.launch.attend import attend
    from eigenscan.cli.launch.services import Pipeline

    folder = out or Path("out") / f"run-{datetime.now():%Y%m%d-%H%M%S}"
    ros2_flags = ["--dialect", ros2] if ros2 else None
    if ros2_flags and ros2_router:
        ros2_flags += ["--ros-router", ros2_router]
    if map_or_model is None and ros2_flags and "mapbuilder" not in left_out:
        map_or_model = _take_map([*ros2_flags, *chosen["ros-bridge"]], folder / "map.yaml")
        chosen["ros-bridge"] += ["--map", ""]  # the robot publishes its own map
    flags, version = _model_flags(map_or_model, method) if map_or_model else ([], "")
    mcap = folder / "mcap"
    pipeline = Pipeline(
        site, robot, flags, zenoh, mcap, None, viewer=viewer, ros2_flags=ros2_flags, listen=listen or (),
        flags=chosen, together=together, foxglove=foxglove, map_version=version, without=left_out,
    )  # fmt: skip
    prepare(json_file)
    with events(json_file) as written:
        attend(pipeline, folder, written, to_stderr=not wants_words(json_file))


def _flags(method: str, file: Path | None, changes: list[str]) -> dict[str, list[str]]:
    """The chosen settings as flags of each service. Raises SettingsError."""
    from eigenscan.cli.launch.supervision import SERVICES
    from eigenscan.runtime.choices import Choices
    from eigenscan.workbench.settings_page import settings_of

    choices = Choices.of(method, file, changes, [*SERVICES, "ros-bridge"])
    for service, changed in choices.changes.items():
        if decided := sorted(DECIDED & changed.keys()):
            option = "--robot, after which it is named" if decided[0] == "instance" else f"--{decided[0]}"
            raise UsageError(f"--set {service}.{decided[0]}: is the same for all services: give {option}")
    return {name: choices.flags(settings_of(name), name) for name in [*SERVICES, "ros-bridge"]}


def _check_listen(listen: list[str], insecure: bool, zenoh: Path | None) -> None:
    """Refuses to open a robot to the network by accident."""
    if insecure and not listen:
        raise UsageError("--insecure: opens nothing by itself: give --listen, or leave it out")
    if listen and zenoh:
        raise UsageError(
            f"--listen {listen[0]}: {zenoh} decides that: put the endpoint into its listen.endpoints"
        )
    if listen and not insecure:
        raise UsageError(
            f"--listen {listen[0]}: any program may then read and forge every message: use certificates "
            "(eigenscan fleet certify, then --zenoh), or add --insecure"
        )


def _model_flags(map_or_model: Path, method: str) -> tuple[list[str], str]:
    """The mapbuilder's flags, and the map's version. Reads all of it, so that an error shows at once."""
    from eigenscan.eigenspace.folder import read_models
    from eigenscan.geometry.gridmap import read_map

    if not map_or_model.exists():
        raise UsageError(f"{map_or_model}: no such file or folder: give a map_server yaml or a model folder")
    if map_or_model.is_dir():
        models = read_models(map_or_model)
        models.check_method(method)
        return ["--model", str(map_or_model)], models.grid.version
    return ["--map", str(map_or_model)], read_map(map_or_model).version


def _take_map(ros2_flags: list[str], path: Path) -> Path:
    """Writes the robot's own map to `path`. Raises MapError if the robot publishes none.

    `ros2_flags`: all of the bridge.
    """
    from eigenscan.geometry.gridmap import write_map
    from eigenscan.ros_bridge.options import RosBridgeOptions
    from eigenscan.ros_bridge.robot_map import take_map
    from eigenscan.ros_bridge.settings import qualified
    from eigenscan.runtime.settings import load

    settings = load(RosBridgeOptions, "ros-bridge", ros2_flags)
    if not settings.map:  # that the bridge publishes none does not tell where the robot does
        settings = settings.model_copy(update={"map": RosBridgeOptions.model_fields["map"].default})
    typer.echo(
        f"waiting for the robot's {qualified(settings.namespace, settings.map)}, at most {MAP_S:.0f} s",
        err=True,
    )
    grid = take_map(settings, MAP_S)
    write_map(grid, path)
    typer.echo(f"received the map: {path}", err=True)
    return path
