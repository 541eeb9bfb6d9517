"""`eigenscan replay`: a recording back onto Zenoh, at its own pace."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from eigenscan.cli.frame import UsageError

if TYPE_CHECKING:
    from eigenscan.cli.simulation.stage import Timed

INPUTS = ("scan_raw", "odometry")
"""What a pipeline is given; all else is its own answer."""


@dataclass(frozen=True)
class Selection:
    """What of a recording is played. Times in s from its start; empty names: any."""

    channels: tuple[str, ...]
    begin: float
    end: float
    site: str | None
    robot: str | None


def replay(
    file: Annotated[Path, typer.Argument(help="recording, MCAP")],
    speed: Annotated[float, typer.Option(min=0.01, help="times faster than it was recorded")] = 1.0,
    begin: Annotated[float, typer.Option("--from", min=0.0, help="s from the recording's start")] = 0.0,
    end: Annotated[float | None, typer.Option("--to", help="s from the recording's start")] = None,
    only: Annotated[
        list[str] | None, typer.Option(help="channel to play, such as scan_raw; may be given again")
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="play every channel, not raw scans and odometry alone")
    ] = False,
    site: Annotated[str | None, typer.Option(help="play under this site's name")] = None,
    robot: Annotated[str | None, typer.Option(help="play under this robot's name")] = None,
    zenoh: Annotated[Path | None, typer.Option(help="Zenoh configuration, JSON5")] = None,
    wait: Annotated[float, typer.Option(min=0.0, help="s to wait for somebody who listens")] = 5.0,
) -> None:
    """Play a recording onto Zenoh, stamps as recorded: raw scans and odometry, or what is asked for.

    \b
    Examples:
      eigenscan replay drive.mcap --speed 4
      eigenscan replay night.mcap --from 120 --to 180 --only scan_raw --only odometry
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.cli.simulation.live import publish
    from eigenscan.runtime.bus import Bus
    from eigenscan.runtime.session import open_session

    if end is not None and end <= begin:
        raise UsageError(f"--to {end:g}: must be after --from {begin:g}")
    selection = Selection(
        _channels(only, everything), begin, float("inf") if end is None else end, site, robot
    )
    first, length = _span(file, selection)
    with Bus(open_session(zenoh)) as bus:
        if not bus.wait_for_listener(first, wait):
            typer.echo(f"eigenscan replay: nobody listens to {first}", err=True)
        publish(_watched(_chosen(file, selection), length), bus.say, speed)


def _channels(only: Sequence[str] | None, everything: bool) -> tuple[str, ...]:
    from eigenscan.schemas.channels import CHANNELS

    names = [channel.name for channel in CHANNELS]
    for name in only or ():
        if name not in names:
            raise UsageError(f"--only {name}: there are {', '.join(names)}")
    return tuple(only or (names if everything else INPUTS))


def _chosen(file: Path, selection: Selection) -> Iterator[Timed]:
    """What is played, with the time at which it was logged."""
    from eigenscan.cli.simulation.stage import Timed
    from eigenscan.runtime.recording import read
    from eigenscan.schemas.envelope import Envelope

    start: int | None = None
    other = {"site": selection.site, "robot": selection.robot}
    renamed = {name: value for name, value in other.items() if value is not None}
    for record in read(file):
        start = record.log_time if start is None else start
        at = (record.log_time - start) * 1e-9
        if at > selection.end:
            return
        envelope = record.envelope
        if at >= selection.begin and envelope.channel.name in selection.channels:
            known = {name: value for name, value in renamed.items() if name in envelope.channel.fields}
            yield Timed(
                record.log_time, Envelope(envelope.channel, {**envelope.address, **known}, envelope.message)
            )


def _span(file: Path, selection: Selection) -> tuple[str, int]:
    """Key of the first message that is played, and the time, ns, from it to the last."""
    first = last = None
    for timed in _chosen(file, selection):
        first, last = first or timed, timed
    if first is None or last is None:
        raise UsageError(
            f"{file}: nothing to play between --from and --to on the channels {', '.join(selection.channels)}"
        )
    return first.envelope.key, last.time - first.time


def _watched(messages: Iterator[Timed], length: int) -> Iterator[Timed]:
    """The messages, with a progress bar in seconds of the recording."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns: list[Any] = [
        TextColumn("replay"),
        BarColumn(),
        TextColumn("{task.completed:.1f} of {task.total:.1f} s"),
        TimeRemainingColumn(),
    ]
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("replay", total=length * 1e-9)
        begun: int | None = None
        for timed in messages:
            begun = timed.time if begun is None else begun
            yield timed
            progress.update(bar, completed=(timed.time - begun) * 1e-9)
