"""`eigenscan evaluate`: how good the pipeline is on a log, in one process and deterministic."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.cli.former import positional
from eigenscan.cli.settings import Changes, Method, SettingsFile
from eigenscan.runtime.errors import UsageError
from eigenscan.schemas.channels import DEFAULT_ROBOT

PARTS = ("windows", "single-scans", "exhaustive", "memory")


def evaluate(
    log: Annotated[
        Path | None, typer.Argument(metavar="LOG", help="CARMEN log, ROS 1 or ROS 2 bag, MCAP, CSV")
    ] = None,
    map_file: Annotated[
        Path | None, typer.Argument(metavar="MAP", help="map_server yaml, or a model folder")
    ] = None,
    ground_truth: Annotated[
        Path | None,
        typer.Option(
            help="reference, TUM: t x y z qx qy qz qw, base in the map; default: the recording's truth, "
            "or agreement"
        ),
    ] = None,
    windows: Annotated[
        Path | None,
        typer.Option(
            help="CSV start_time,end_time in seconds; without it a start every 10 s, 30 m or 60 s each"
        ),
    ] = None,
    single_scans: Annotated[
        Path | None,
        typer.Option(
            help="CSV time in seconds; without it up to 100 scans, evenly spread", rich_help_panel="Details"
        ),
    ] = None,
    kidnap: Annotated[
        bool, typer.Option("--kidnap", help="also jump to another window in the middle of each")
    ] = False,
    json_file: JsonFile = None,
    poses: Annotated[
        Path | None, typer.Option(help="write every pose of every window here, CSV; exact to the last bit")
    ] = None,
    spacing: Annotated[
        float | None,
        typer.Option(
            min=0.05,
            max=2.0,
            help="grid of positions, m; 0.25, or the method's",
            rich_help_panel="Details",
        ),
    ] = None,
    method: Method = "default",
    settings_file: SettingsFile = None,
    changes: Changes = None,
    skip: Annotated[list[str] | None, typer.Option(help=f"leave out one of: {', '.join(PARTS)}")] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="at most so many windows and single scans, evenly chosen")
    ] = None,
    jobs: Annotated[
        int, typer.Option(min=1, help="processes side by side; CPU figures are cleanest with one")
    ] = 1,
    lidar: Annotated[
        list[str] | None,
        typer.Option("--lidar-topic", help="topic or lidar name to take; repeat for more; default: all"),
    ] = None,
    odometry: Annotated[str | None, typer.Option("--odometry-topic", help="topic of the odometry")] = None,
    robot: Annotated[
        str, typer.Option(help="robot to judge, in a recording of several", rich_help_panel="Details")
    ] = DEFAULT_ROBOT,
    reference_offset: Annotated[
        float,
        typer.Option(
            help="s, added to the stamps of reference, windows and single scans", rich_help_panel="Details"
        ),
    ] = 0.0,
    log_option: Annotated[Path | None, typer.Option("--log", hidden=True)] = None,
    map_option: Annotated[Path | None, typer.Option("--map", hidden=True)] = None,
) -> None:
    """Judge global localization on a log: success, false claims, time to localize, errors, CPU.

    The pipeline never sees the reference. Without one, the report shows agreement: cold starts are compared
    with the log played as a whole. That shows how soon and how often a pose is claimed, not how accurate it
    is. The exit code does not depend on the figures.
    --set, --settings and --method change the settings of scan-ingest, projector, tracker and mapbuilder
    (docs/settings.md); the first wins. --method paper runs the paper's own pipeline.
    If a log lacks mounts: eigenscan import --mount, then evaluate the MCAP.

    \b
    Examples:
      eigenscan evaluate LOG.bag MAP.yaml
      eigenscan evaluate LOG.bag MAP.yaml --ground-truth REF.tum
      eigenscan evaluate LOG.clf.gz MAP.yaml --ground-truth REF.tum --kidnap --json OUT.json
      eigenscan evaluate LOG.bag MAP.yaml --method paper --set tracker.localized_above=0.95
    """  # noqa: D301 - \b keeps the lines apart in --help
    log, map_file = positional("LOG", log, log_option), positional("MAP", map_file, map_option)
    unknown = sorted(set(skip or ()) - set(PARTS))
    if unknown:
        raise UsageError(f"--skip {unknown[0]}: there are {', '.join(PARTS)}")
    # before numpy is imported: CPU is process time on one core
    from eigenscan.workbench.one_thread import one_thread

    one_thread()
    from eigenscan.runtime.choices import Choices
    from eigenscan.workbench.evaluation.chosen import SERVICES, chosen
    from eigenscan.workbench.evaluation.course import Task
    from eigenscan.workbench.evaluation.course import evaluate as run
    from eigenscan.workbench.evaluation.report import show
    from eigenscan.workbench.logs import LogOptions
    from eigenscan.workbench.progress import Bars
    from rich.console import Console

    task = Task(
        log=log,
        map=map_file,
        reference=ground_truth,
        windows=windows,
        single_scans=single_scans,
        kidnap=kidnap,
        skip=frozenset(skip or ()),
        offset_s=reference_offset,
        limit=limit,
        jobs=jobs,
        poses=poses,
        options=LogOptions(robot=robot, lidars=tuple(lidar or ()), odometry=odometry),
        settings=chosen(Choices.of(method, settings_file, changes or (), SERVICES), spacing),
    )
    for file in (json_file, poses):
        prepare(file)
    with Bars() as bars:
        figures = run(task, bars)
    if figures["log"]["is_cut"]:
        typer.echo(f"{log}: breaks off, or is damaged: judged as far as it can be read", err=True)
    write_figures(figures, json_file)
    if wants_words(json_file):
        show(figures, f"{log} on {map_file}", Console(width=None if sys.stdout.isatty() else 110))
