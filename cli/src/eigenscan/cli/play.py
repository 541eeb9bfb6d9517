"""`eigenscan play`: publishes a recording on Zenoh, at its own pace."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from eigenscan.cli.figures import JsonFile, prepare, write_figures
from eigenscan.cli.moment import METAVAR, START, Moment, moment
from eigenscan.cli.names import check_names
from eigenscan.runtime.errors import FailedError, UsageError

if TYPE_CHECKING:
    from eigenscan.schemas.envelope import Envelope
    from eigenscan.workbench.playback.player import Score


class Stamps(StrEnum):
    """Stamps of the messages that are played."""

    RECORDED = "recorded"
    NOW = "now"


def play(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="recording, MCAP; or a folder of them, joined")
    ],
    speed: Annotated[float, typer.Option(min=0.01, help="times faster than it was recorded")] = 1.0,
    begin: Annotated[
        Moment,
        typer.Option(
            "--from",
            parser=moment,
            metavar=METAVAR,
            help="s from the recording's start, or its time of day, UTC",
        ),
    ] = START,
    end: Annotated[
        Moment | None, typer.Option("--to", parser=moment, metavar=METAVAR, help="the same")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="channel to play, such as scan_raw, or key, such as 'site/robot/r1/**'; repeat for more"
        ),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="play every channel, not raw scans and odometry alone")
    ] = False,
    site: Annotated[
        str | None, typer.Option(help="play under this site's name", rich_help_panel="Zenoh")
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(help="play this robot alone; of a recording that holds one: play it under this name"),
    ] = None,
    robots: Annotated[
        int | None,
        typer.Option(min=1, max=1000, help="play its one robot as so many: r-001, r-002, and so on"),
    ] = None,
    stamps: Annotated[
        Stamps, typer.Option(help="as recorded, or shifted to the present, without ever going back")
    ] = Stamps.RECORDED,
    commands: Annotated[
        bool,
        typer.Option("--commands", help="take pause, play, step, seek S, skip S, end from standard input"),
    ] = False,
    zenoh: Annotated[
        Path | None, typer.Option(help="Zenoh configuration, JSON5", rich_help_panel="Zenoh")
    ] = None,
    wait: Annotated[
        float,
        typer.Option(
            min=0.0,
            help="s to wait for a subscriber, then give up; 0: do not wait",
            rich_help_panel="Zenoh",
        ),
    ] = 5.0,
    json_file: JsonFile = None,
) -> None:
    """Publish a recording on Zenoh: raw scans and odometry, or what --all and --only select.

    In a terminal: space pauses, arrows seek 5 s or a minute. A dot plays one message, q ends.
    Where no message came for over 10 minutes, it goes on at the next one.

    \b
    Examples:
      eigenscan play drive.mcap --speed 4
      eigenscan play night.mcap --from 120 --to 180 --only scan_raw --only odometry
      eigenscan play drive.mcap --robots 50 --stamps now
    """  # noqa: D301 - \b keeps the lines apart in --help
    check_names(robot, site)
    prepare(json_file)
    from eigenscan.fleet.view import connect
    from eigenscan.runtime.bus import Bus
    from eigenscan.schemas.channels import CHANNELS
    from eigenscan.workbench.playback.cast import Cast
    from eigenscan.workbench.playback.controls import controls
    from eigenscan.workbench.playback.player import Player, Score
    from eigenscan.workbench.playback.selection import INPUTS, select

    names = only or ([channel.name for channel in CHANNELS] if everything else INPUTS)
    selection = select(file, names, robot, *_seconds(file, begin, end))
    if robots and len(selection.robots) != 1:
        held = ", ".join(selection.robots) or "no robot"
        raise UsageError(f"--robots {robots}: needs one robot, there is {held}: select one with --robot")
    parts = Cast(site, robot, robots or 0)
    score = Score(
        lambda start: parts.messages(selection.messages(start)),
        *(selection.start, selection.begin, selection.end),
    )
    first = next(score.messages(score.begin)).envelope
    clock = time.time_ns if stamps is Stamps.NOW else None
    with Bus(connect(zenoh)) as bus:
        bus.offer(selection.latched, first.address)
        received = bus.wait_for_listener(first.key, wait)
        if wait and not received:
            raise FailedError(
                f"nobody subscribes to {first.key} within {wait:g} s: start eigenscan run, or check "
                "--site, --robot and --zenoh; --wait 0 plays without one"
            )
        published: Counter[str] = Counter()

        def publish(envelope: Envelope) -> None:
            bus.publish(envelope)
            published[envelope.channel.name] += 1

        before = time.monotonic()
        with controls(scripted=commands) as given, _progress(score, given.hint) as moved:
            Player(score, publish, given, moved, speed, clock).play()
        took = time.monotonic() - before
    figures = {
        "recording": str(file),
        "heard_by_somebody": received,
        "played": dict(published),
        "took_s": took,
    }
    write_figures(figures, json_file)


def _seconds(file: Path, begin: Moment, end: Moment | None) -> tuple[float, float | None]:
    """The same from the recording's start, which only a time of day has to be looked up for."""
    from eigenscan.runtime.recording import contents

    of_day = begin.of_day or (end is not None and end.of_day)
    start = contents(file).begin if of_day else 0
    return begin.after(start), end.after(start) if end else None


@contextmanager
def _progress(score: Score, hint: str) -> Iterator[Callable[[int, bool], None]]:
    """A bar in seconds of the recording; yields the function that moves it, by log time (ns) and pause."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    columns: list[Any] = [
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.1f} of {task.total:.1f} s"),
        TextColumn(hint, style="dim"),
    ]
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("play", total=(score.end - score.start) * 1e-9)

        def moved(moment: int, paused: bool) -> None:
            at = (min(moment, score.end) - score.start) * 1e-9
            progress.update(bar, completed=at, description="paused" if paused else "play")

        yield moved
