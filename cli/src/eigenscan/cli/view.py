"""`eigenscan view`: the picture of a recording, drawn again and opened in Rerun's web viewer."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from eigenscan.cli.frame import UsageError
from eigenscan.recorder.picture.layout import Layout

if TYPE_CHECKING:
    from eigenscan.recorder.settings import RecorderSettings

HOST = "127.0.0.1"


def view(
    recording: Annotated[
        Path, typer.Argument(help="MCAP that a recorder wrote, or a folder of them", metavar="FILE.mcap")
    ],
    rrd: Annotated[
        Path | None, typer.Option(help="Rerun file to write; without it one that is gone afterwards")
    ] = None,
    is_opened: Annotated[bool, typer.Option("--open/--no-open", help="open the web viewer")] = True,
    at: Annotated[
        float, typer.Option(min=0.0, help="second of the recording that the picture begins and opens at")
    ] = 0.0,
    end: Annotated[float | None, typer.Option("--to", help="second of the recording that it ends at")] = None,
    layout: Annotated[Layout, typer.Option(help="what the picture shows first")] = "operator",
    picture_hz: Annotated[
        float, typer.Option(min=0.01, help="pictures a second of the recording's time")
    ] = 10.0,
    port: Annotated[int, typer.Option(min=0, max=65535, help="port of the page; 0 chooses one")] = 0,
) -> None:
    """Draw a recording as the recorder draws live traffic, and look at it.

    A long recording is open sooner where --at and --to say which part.

    \b
    Examples:
      eigenscan view recordings/site-20260131-120000.mcap
      eigenscan view night.mcap --at 8040
      eigenscan view drive.mcap --layout researcher
      eigenscan view drive.mcap --rrd drive.rrd --no-open
    """  # noqa: D301 - \b keeps the lines apart in --help
    if rrd is None and not is_opened:
        raise UsageError("nothing to do: give --rrd FILE.rrd, or leave --no-open out")
    if end is not None and end <= at:
        raise UsageError(f"--to {end:g}: must be after --at {at:g}")
    stretch = (at, math.inf if end is None else end)
    from eigenscan.recorder.settings import RecorderSettings

    if rrd is not None:
        _draw(recording, stretch, RecorderSettings(rrd=rrd, layout=layout, picture_hz=picture_hz))
        if is_opened:
            _open(rrd, port)
        return
    from tempfile import TemporaryDirectory

    with TemporaryDirectory(prefix="eigenscan-view-") as folder:
        target = Path(folder) / f"{recording.stem}.rrd"
        _draw(recording, stretch, RecorderSettings(rrd=target, layout=layout, picture_hz=picture_hz))
        _open(target, port)


def _draw(recording: Path, stretch: tuple[float, float], settings: RecorderSettings) -> None:
    """Draws what lies between two seconds of a recording, message by message, with a progress bar."""
    from eigenscan.recorder.rerun_sink import RerunSink
    from eigenscan.runtime.recording import contents, read
    from rich.console import Console
    from rich.progress import Progress

    found = contents(recording)
    begin = found.begin + int(stretch[0] * 1e9)
    end = found.end if math.isinf(stretch[1]) else min(found.end, found.begin + int(stretch[1] * 1e9))
    if not found.counts:
        raise UsageError(f"{recording}: holds no message of ours: give a file that eigenscan wrote")
    if begin > end:
        length = (found.end - found.begin) * 1e-9
        raise UsageError(f"--at {stretch[0]:g}: {recording} lasts {length:.1f} s")
    sink = RerunSink(settings)
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task(f"drawing {recording.name}", total=max(end - begin, 1))
        for record in read(recording, begin):
            if record.log_time > end:
                break
            sink.write(record.envelope)
            progress.update(task, completed=max(record.log_time - begin, 0))
    sink.close()
    if not found.complete:
        typer.echo(f"{recording}: its writer did not close it; drawn as far as it goes", err=True)


def _open(picture: Path, port: int) -> None:
    """Serves the viewer with `picture` until Ctrl-C."""
    import time
    import webbrowser
    from contextlib import suppress

    from eigenscan.recorder.web_viewer import free_port, serve_viewer

    page, data = free_port("--port", HOST, port), free_port("data port", HOST, 0)
    with serve_viewer(HOST, page, data, picture) as link:
        typer.echo(f"viewer: {link}\nCtrl-C ends it")
        webbrowser.open(link)
        with suppress(KeyboardInterrupt):
            while True:
                time.sleep(3600)
