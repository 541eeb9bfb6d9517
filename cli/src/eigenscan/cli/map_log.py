"""`eigenscan map`: a whole log becomes a map."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from eigenscan.cli.figures import JsonFile, prepare, print_rows, wants_words, write_figures
from eigenscan.cli.log_options import LidarTopics, LogFile, OdometryTopic
from eigenscan.cli.paths import is_same
from eigenscan.runtime.errors import UsageError
from eigenscan.schemas.channels import DEFAULT_ROBOT

if TYPE_CHECKING:
    from eigenscan.mapbuilder.mapping.given_map import Located
    from eigenscan.mapbuilder.mapping.survey import Mapped
    from eigenscan.schemas.envelope import Envelope
    from eigenscan.workbench.logs.scans import Scans
    from eigenscan.workbench.progress import Bars


def map_log(
    log: LogFile,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="MAP.yaml to write; without it LOG's name, here")
    ] = None,
    on: Annotated[
        Path | None,
        typer.Option(
            metavar="MAP.yaml",
            help="make this map better (yaml or model folder): the result keeps its frame, and its walls "
            "where LOG saw nothing",
        ),
    ] = None,
    resolution: Annotated[float, typer.Option(min=0.01, max=0.5, help="m per cell")] = 0.05,
    no_odometry: Annotated[bool, typer.Option("--no-odometry", help="from the scans alone")] = False,
    of: Annotated[
        int | None,
        typer.Option(
            "--composite",
            min=2,
            metavar="N",
            help="of N evenly spread scans, without their order or poses",
        ),
    ] = None,
    lidar: LidarTopics = None,
    odometry: OdometryTopic = None,
    robot: Annotated[str, typer.Option(help="robot whose scans count, in a recording")] = DEFAULT_ROBOT,
    force: Annotated[bool, typer.Option("--force", help="replace files that are there")] = False,
    json_file: JsonFile = None,
) -> None:
    """Make a map of a log's scans, with its odometry or without any.

    Writes MAP.yaml and MAP.pgm for map_server, and MAP.png as a picture. MAP.tum is the path of the
    robot's base: t x y z qx qy qz qw, with the log's stamps.
    Needs gtsam: pip install 'eigenscan[mapping]'.

    \b
    Examples:
      eigenscan map drive.bag -o office.yaml
      eigenscan build office.yaml -o model
      eigenscan map drive.mcap --on thick.yaml -o better.yaml
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.geometry.gridmap import write_map
    from eigenscan.mapbuilder.mapping.composite import composite
    from eigenscan.mapbuilder.mapping.drawing import draw_way
    from eigenscan.mapbuilder.mapping.pose_graph import check_installed
    from eigenscan.mapbuilder.mapping.survey import MappingError, Survey, survey
    from eigenscan.workbench.logs import LogOptions
    from eigenscan.workbench.logs.remarks import remarks
    from eigenscan.workbench.logs.scans import read_scans
    from eigenscan.workbench.progress import Bars

    target = out or Path((log.name.split(".")[0] or "map") + ".yaml")
    if target.suffix not in (".yaml", ".yml"):
        raise UsageError(f"-o {target}: name a .yaml file, such as {target.with_suffix('.yaml')}")
    if on is not None and of is not None:
        raise UsageError("--composite takes scans without order; --on needs a drive: give one of them")
    others = [path for path in (log, on, json_file) if path and wants_words(path)]
    _check_outputs(target, others, force)
    if of is None:
        check_installed()
    prepare(json_file)
    options = LogOptions(robot=robot, lidars=tuple(lidar or ()), odometry=odometry)
    began = time.perf_counter()
    with Bars() as bars:
        reading = bars.start_share("reading")
        received: list[Envelope] = []
        scans = read_scans(
            log, options, reading, with_odometry=not no_odometry, received=received if on else None
        )
        for line in (*remarks(scans.counters), *filter(None, [scans.damage])):
            typer.echo(line, err=True)
        located = None
        try:
            if of is None:
                located = _located(on, received, scans, bars, with_odometry=not no_odometry)
                mapped = survey(scans.sweeps, Survey(resolution=resolution), bars.start_steps(), located)
            else:
                scans = scans.spread(of)
                mapped = composite(scans.sweeps, resolution, bars.start_steps())
        except MappingError as error:
            raise UsageError(f"{log}: {error}{scans.set_aside}") from error
    write_map(mapped.grid, target)
    target.with_suffix(".tum").write_text(scans.trajectory(mapped.numbers, mapped.poses), encoding="utf-8")
    target.with_suffix(".png").write_bytes(draw_way(mapped, located.grid if located else None))
    sure = len(located.numbers) if located else None
    _summarize(scans, mapped, sure, target, time.perf_counter() - began, json_file, composed=of is not None)


def _check_outputs(target: Path, inputs: list[Path], force: bool) -> None:
    """Raises UsageError where one of the four files would replace something unasked.

    OSError where one cannot be written: now, not after the work.
    """
    for path in (target, *(target.with_suffix(f".{end}") for end in ("pgm", "tum", "png"))):
        for given in inputs:
            if is_same(path, given):
                raise UsageError(f"-o {target}: would overwrite {given}: name another file")
        if path.exists() and not (path.is_file() and force):
            raise UsageError(f"-o {target}: {path.name} is there already: name another file, or add --force")
        prepare(path)


def _located(
    on: Path | None, received: list[Envelope], scans: Scans, bars: Bars, with_odometry: bool
) -> Located | None:
    """Poses of the scans on the given map, if there is one."""
    if on is None:
        return None
    from eigenscan.workbench.evaluation.locating import locate

    return locate(on, received, scans.sweeps, bars.start_share, with_odometry)


def _summarize(
    scans: Scans,
    mapped: Mapped,
    sure: int | None,
    target: Path,
    seconds: float,
    json_file: Path | None,
    *,
    composed: bool,
) -> None:
    odometry = sum(sweep.odometry is not None for sweep in scans.sweeps)
    on_map = {} if sure is None else {"located": f"{sure} of {len(scans.sweeps)} on the given map"}
    rows = {
        "scans": f"{len(mapped.numbers)} of {scans.received} in the map, {odometry} with odometry",
        **on_map,
        "way": f"{mapped.way:.0f} m in {scans.seconds:.0f} s",
        "keyframes": f"{mapped.keyframes}; loop closures: {mapped.closures}; rejected: {mapped.rejected}",
        "free area": f"{mapped.grid.free_area:.0f} m²",
        "mapped in": f"{seconds:.0f} s",
        "map": f"{target}, {target.with_suffix('.pgm').name}",
        "trajectory": str(target.with_suffix(".tum")),
        "picture": str(target.with_suffix(".png")),
    }
    print_rows(rows, json_file)
    figures = {
        "scans_heard": scans.received,
        "scans_in_map": len(mapped.numbers),
        "scans_with_odometry": odometry,
        "scans_located": sure,
        "set_aside": dict(scans.counters),
        "way_m": mapped.way,
        "log_s": scans.seconds,
        "keyframes": mapped.keyframes,
        "loop_closures": mapped.closures,
        "loop_closures_rejected": mapped.rejected,
        "odometry_jumps": mapped.jumps,
        "stretches_not_joined": len(mapped.unjoined),
        "free_area_m2": mapped.grid.free_area,
        "build_s": seconds,
        "map": str(target),
        "trajectory": str(target.with_suffix(".tum")),
        "picture": str(target.with_suffix(".png")),
    }
    write_figures(figures, json_file)
    if mapped.left_out or scans.set_aside:
        typer.echo(f"left out: {mapped.left_out} scans with too few walls{scans.set_aside}", err=True)
    if composed and mapped.rejected:
        picture = target.with_suffix(".png")
        typer.echo(
            f"{mapped.rejected} pairs of scans fit otherwise, as in rooms alike: check {picture}", err=True
        )
    if mapped.jumps:
        typer.echo(f"odometry jumped {mapped.jumps} times: there the scans alone count", err=True)
    for first, last in mapped.unjoined:
        typer.echo(f"not joined to the rest: {scans.span(first, last)}: no sure overlap was found", err=True)
