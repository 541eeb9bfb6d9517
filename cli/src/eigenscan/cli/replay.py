"""`eigenscan replay`: a recording back onto Zenoh, at its own pace, or into a service and compared."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from eigenscan.cli.frame import UsageError
from eigenscan.cli.process_replay.command import Request, process_replay

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
    file: Annotated[Path, typer.Argument(help="recording, MCAP; or a folder of them, joined")],
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
    service: Annotated[
        str | None,
        typer.Option(help="replay into scan-ingest, projector, tracker or pipeline, here and without Zenoh"),
    ] = None,
    compare: Annotated[
        bool, typer.Option("--compare", help="with --service: it must say what is recorded")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="with --service: write what it hears and says, MCAP")
    ] = None,
    model: Annotated[
        Path | None, typer.Option(help="with --service: model folder, instead of the recorded models")
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", help="with --service: SETTING=VALUE other than recorded; repeat for more"),
    ] = None,
    tolerant: Annotated[
        bool, typer.Option("--tolerant", help="with --compare: small numerical differences pass")
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="with --compare: judge also what arrival order decides")
    ] = False,
    ignore: Annotated[
        list[str] | None, typer.Option(help="with --compare: CHANNEL.FIELD not to judge; repeat for more")
    ] = None,
    least: Annotated[int, typer.Option(min=1, help="with --compare: messages that must be compared")] = 10,
) -> None:
    """Play a recording onto Zenoh, stamps as recorded: raw scans and odometry, or what is asked for.

    With --service NAME --compare: give a service what it heard, and compare what it says with what it said.
    Exit code 0: the same, 1: a difference, 2: the recording cannot be replayed.

    \b
    Examples:
      eigenscan replay drive.mcap --speed 4
      eigenscan replay night.mcap --from 120 --to 180 --only scan_raw --only odometry
      eigenscan replay night.mcap --service tracker --compare
    """  # noqa: D301 - \b keeps the lines apart in --help
    if service is not None:
        _refuse_for_service(begin=begin, end=end, only=only, everything=everything, site=site, robot=robot)
        process_replay(
            Request(
                *(file, service, compare, out, model),
                changes=changes or (),
                tolerant=tolerant,
                strict=strict,
                ignored=ignore or (),
                least=least,
            )
        )
        return
    if compare or out or model or changes or tolerant or strict or ignore:
        raise UsageError("--compare and what goes with it: give --service NAME as well")
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


def _refuse_for_service(**options: object) -> None:
    """Raises UsageError for what would leave out a part: a service remembers all that it heard."""
    names = {"begin": "from", "end": "to", "everything": "all"}
    for name, value in options.items():
        if value:
            raise UsageError(f"--{names.get(name, name)}: not with --service, which hears all that it heard")


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
