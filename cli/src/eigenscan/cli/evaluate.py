"""`eigenscan evaluate`: how good the pipeline is on a log, in one process and deterministic."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.cli.former import optional, positional
from eigenscan.cli.log_options import LidarTopics
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
        Path | None,
        typer.Option(
            help="judge these instead: CSV stamp,x,y,heading[,confidence,window], or TUM, of any program"
        ),
    ] = None,
    save_poses: Annotated[
        Path | None,
        typer.Option(
            help="write every pose of every window here, as --poses reads it", rich_help_panel="Details"
        ),
    ] = None,
    save_runs: Annotated[
        Path | None,
        typer.Option(
            help="only write the log of each window here, for another program", rich_help_panel="Details"
        ),
    ] = None,
    spacing: Annotated[
        float | None,
        typer.Option(
            min=0.05,
            max=2.0,
            help="grid of positions, m; default: as eigenscan build, or the model folder's",
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
    lidar: LidarTopics = None,
    odometry: Annotated[
        str | None, typer.Option("--odometry-topic", help="topic of the odometry", rich_help_panel="Details")
    ] = None,
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
    With --poses, any program's poses are judged by the same protocols; no MAP is needed (docs/comparison.md).
    --set, --settings and --method change the settings of scan-ingest, projector, tracker and mapbuilder
    (docs/settings.md); the first wins. --method paper runs the paper's own pipeline.
    If a log lacks mounts: eigenscan import --mount, then evaluate the MCAP.

    \b
    Examples:
      eigenscan evaluate LOG.bag MAP.yaml
      eigenscan evaluate LOG.bag MAP.yaml --ground-truth REF.tum
      eigenscan evaluate LOG.clf.gz MAP.yaml --ground-truth REF.tum --kidnap --json OUT.json
      eigenscan evaluate LOG.bag MAP.yaml --method paper --set tracker.localized_above=0.95
      eigenscan evaluate LOG.bag --ground-truth REF.tum --poses CLAIMS.csv
    """  # noqa: D301 - \b keeps the lines apart in --help
    log = positional("LOG", log, log_option)
    claims_only = poses is not None or save_runs is not None
    if claims_only:
        _refuse_without_effect(
            "--poses" if poses else "--save-runs",
            {
                "--set": changes,
                "--settings": settings_file,
                "--method": method != "default",
                "--spacing": spacing,
                "--skip": skip,
                "--single-scans": single_scans,
                "--save-poses": save_poses,
            },
        )
    map_file = (optional if claims_only else positional)("MAP", map_file, map_option)
    unknown = sorted(set(skip or ()) - set(PARTS))
    if unknown:
        raise UsageError(f"--skip {unknown[0]}: choose among {', '.join(PARTS)}")
    # before numpy is imported: CPU is process time on one core
    from eigenscan.workbench.one_thread import one_thread

    one_thread()
    from eigenscan.runtime.choices import Choices
    from eigenscan.workbench.evaluation.chosen import SERVICES, chosen
    from eigenscan.workbench.evaluation.course import ClaimsTask, Task, evaluate_claims
    from eigenscan.workbench.evaluation.course import evaluate as run
    from eigenscan.workbench.evaluation.report import show
    from eigenscan.workbench.logs import LogOptions
    from eigenscan.workbench.progress import Bars
    from rich.console import Console

    options = LogOptions(robot=robot, lidars=tuple(lidar or ()), odometry=odometry)
    console = Console(width=None if sys.stdout.isatty() else 110)
    if map_file is None or claims_only:
        claims = ClaimsTask(
            *(log, poses, save_runs, ground_truth, windows),
            kidnap=kidnap,
            offset_s=reference_offset,
            limit=limit,
            options=options,
        )
        prepare(json_file)
        with Bars() as bars:
            figures = evaluate_claims(claims, bars)
        if wants_words(json_file) and save_runs:
            typer.echo(f"{save_runs}: {len(figures['runs'])} runs")
        elif wants_words(json_file):
            show(figures, f"{poses} on {log}", console)
        write_figures(figures, json_file)
        return
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
        poses=save_poses,
        options=options,
        settings=chosen(Choices.of(method, settings_file, changes or (), SERVICES), spacing),
    )
    for file in (json_file, save_poses):
        prepare(file)
    with Bars() as bars:
        figures = run(task, bars)
    if damage := figures["log"]["damage"]:
        typer.echo(damage, err=True)
    if wants_words(json_file):
        show(figures, f"{log} on {map_file}", console)
    write_figures(figures, json_file)


def _refuse_without_effect(way: str, ours: Mapping[str, object]) -> None:
    """Raises UsageError for an option of our own pipeline, which does not run this way."""
    for option, given in ours.items():
        if given:
            raise UsageError(f"{option}: has no effect with {way}: leave it out")
