"""`eigenscan import`: a log of any kind into the pipeline's own MCAP."""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.cli.log_options import LidarTopics, LogFile, OdometryTopic
from eigenscan.cli.names import check_names
from eigenscan.cli.paths import is_same
from eigenscan.runtime.errors import UsageError
from eigenscan.runtime.printable import printable
from eigenscan.schemas.channels import DEFAULT_ROBOT, DEFAULT_SITE

if TYPE_CHECKING:
    from eigenscan.workbench.logs import Log, Mount
    from eigenscan.workbench.logs.summary import Summary


def import_log(
    log: LogFile,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="MCAP to write; without it LOG's name with .mcap, here")
    ] = None,
    lidar: LidarTopics = None,
    odometry: OdometryTopic = None,
    base_frame: Annotated[str | None, typer.Option(help="the base frame; default: odometry's")] = None,
    mount: Annotated[
        list[str] | None,
        typer.Option(help="LIDAR=X,Y,YAW[,upside-down], m and deg, instead of the log's; repeat for more"),
    ] = None,
    site: Annotated[str, typer.Option(help="first chunk of every key")] = DEFAULT_SITE,
    robot: Annotated[str, typer.Option(help="name of the robot")] = DEFAULT_ROBOT,
    force: Annotated[bool, typer.Option("--force", help="replace a file that is there")] = False,
    json_file: JsonFile = None,
) -> None:
    """Turn a log into the pipeline's own MCAP: raw scans and odometry, in order of their stamps.

    \b
    Examples:
      eigenscan import intel.clf.gz -o intel.mcap
      eigenscan import drive.bag -o drive.mcap --lidar-topic /front/scan --robot r17
      eigenscan import no_tf.bag --mount scan=0.2,0,180
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.workbench.logs import LogOptions, open_log
    from rich.console import Console

    check_names(robot, site)
    target = out or Path(_stem(log) + ".mcap")
    if is_same(target, log):
        raise UsageError(f"-o {target}: is the log itself: name another file")
    if target.exists() and not target.is_file():  # it would be replaced, also a device
        raise UsageError(f"-o {target}: is no file: name another one")
    if target.exists() and not force:
        raise UsageError(f"-o {target}: is there already: name another file, or add --force")
    prepare(json_file)
    mounts = dict(_mount(text) for text in mount or ())
    options = LogOptions(site, robot, tuple(lidar or ()), odometry, base_frame, mounts)
    opened = open_log(log, options)
    summary = _write(opened, target, mounts)
    if wants_words(json_file):
        summary.show(Console(markup=False, emoji=False), opened, target)
    write_figures(summary.figures(opened, target), json_file)


def _mount(text: str) -> tuple[str, Mount]:
    from eigenscan.geometry.normalize import FARTHEST_MOUNT
    from eigenscan.workbench.logs import Mount

    lidar, _, place = text.partition("=")
    numbers, upside_down = place.removesuffix(",upside-down"), place.endswith(",upside-down")
    try:
        x, y, yaw = (float(number) for number in numbers.split(","))
    except ValueError:
        raise UsageError(f"--mount {text}: give LIDAR=X,Y,YAW in m and deg, such as scan=0.2,0,180") from None
    if not lidar or not all(map(math.isfinite, (x, y, yaw))):
        raise UsageError(f"--mount {text}: give a lidar's name and finite numbers, such as scan=0.2,0,180")
    if max(abs(x), abs(y)) > FARTHEST_MOUNT:
        raise UsageError(
            f"--mount {text}: is farther than {FARTHEST_MOUNT:g} m from the base: give X and Y in m"
        )
    return lidar, Mount(x, y, math.radians(yaw), upside_down)


def _stem(log: Path) -> str:
    return log.name.split(".")[0] or "log"


def _write(log: Log, target: Path, mounts: Collection[str]) -> Summary:
    """Writes beside `target` and moves it there when it is whole."""
    from eigenscan.runtime.recording import RecordingWriter
    from eigenscan.schemas.channels import SCAN_RAW
    from eigenscan.schemas.whole import whole
    from eigenscan.workbench.logs.summary import Summary
    from eigenscan.workbench.progress import Bars

    summary = Summary()
    with whole(target) as part:
        with Bars() as bars, RecordingWriter(part, {"import": _metadata(log)}) as writer:
            moved = bars.start_share("import")
            for envelope in log.envelopes():
                time = envelope.stamp
                # a reference trajectory may have the stamps as logged
                logged = log.logged.get(time, time) if envelope.channel is SCAN_RAW else time
                writer.write(envelope, time, publish_time=logged)
                summary.add(envelope, time)
                moved(log.progress)
            moved(1.0)
        unknown = sorted(set(mounts) - set(summary.lidars))
        if unknown:
            there = ", ".join(summary.lidars)
            raise UsageError(
                f"--mount {unknown[0]}=…: no lidar that is taken has this name: choose one of {there}"
            )
        if summary.not_in_metres:
            raise UsageError(
                f"{log.path}: lidar {summary.not_in_metres[0]}: ranges must be metres, all are far above: "
                "convert them (of a CSV in mm, name the columns range_mm), or take others with --lidar-topic"
            )
    return summary


def _metadata(log: Log) -> dict[str, str]:
    return {"source": printable(log.path.name), "format": log.format}
