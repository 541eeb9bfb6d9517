"""`eigenscan view`: the picture of a recording, drawn again and opened in Rerun's web viewer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.cli.moment import METAVAR, START, Moment, moment, span
from eigenscan.recorder.picture.layout import Layout
from eigenscan.runtime.errors import FailedError, UsageError

if TYPE_CHECKING:
    from eigenscan.recorder.options import RecorderOptions

HOST = "127.0.0.1"
LOOK_S = 1.0
"""Between two looks whether the viewer is served, s."""
LEAST_FREE = 2**20
"""Bytes that a disk has that is not full: Rerun writes more at a time."""


def view(
    recording: Annotated[
        Path, typer.Argument(help="MCAP that a recorder wrote, or a folder of them", metavar="FILE.mcap")
    ],
    rrd: Annotated[
        Path | None, typer.Option(help="Rerun file to write; without it one that is gone afterwards")
    ] = None,
    is_opened: Annotated[bool, typer.Option("--open/--no-open", help="open the web viewer")] = True,
    at: Annotated[
        Moment,
        typer.Option(
            parser=moment,
            metavar=METAVAR,
            help="start: s from the recording's start, or its time of day, UTC",
        ),
    ] = START,
    end: Annotated[
        Moment | None, typer.Option("--to", parser=moment, metavar=METAVAR, help="end, the same")
    ] = None,
    layout: Annotated[Layout, typer.Option(help="panels in front")] = "operator",
    picture_hz: Annotated[
        float, typer.Option(min=0.01, max=1000.0, help="pictures a second of the recording's time")
    ] = 10.0,
    draw_all: Annotated[
        bool, typer.Option("--draw-all", help="also raw scans and coordinate frames")
    ] = False,
    port: Annotated[int, typer.Option(min=0, max=65535, help="port of the page; 0 chooses one")] = 0,
    json_file: JsonFile = None,
) -> None:
    """Draw a recording as the recorder draws live traffic, and look at it.

    For a long recording, select a part with --at and --to.

    \b
    Examples:
      eigenscan view recordings/site-20260131-120000.mcap
      eigenscan view night.mcap --at 03:11 --to 03:14
      eigenscan view night.mcap --at 8040
      eigenscan view drive.mcap --layout researcher
      eigenscan view drive.mcap --layout developer --draw-all
      eigenscan view drive.mcap --rrd drive.rrd --no-open
    """  # noqa: D301 - \b keeps the lines apart in --help
    if rrd is None and not is_opened:
        raise UsageError("nothing to do: give --rrd FILE.rrd, or leave --no-open out")
    from eigenscan.recorder.options import RecorderOptions
    from eigenscan.recorder.web_viewer import free_port
    from eigenscan.schemas.whole import whole

    prepare(json_file)
    if is_opened:  # a port that is taken is an error before a long recording is drawn
        port = free_port("--port", HOST, port)
    from tempfile import TemporaryDirectory

    with TemporaryDirectory(prefix="eigenscan-view-") as folder:
        target = rrd or Path(folder) / f"{recording.stem}.rrd"
        with whole(target) as part:
            settings = RecorderOptions(rrd=part, layout=layout, picture_hz=picture_hz, draw_all=draw_all)
            drawn = _draw(recording, at, end, settings)
        figures = {"picture": str(rrd) if rrd else None} | drawn
        if is_opened:
            _open(target, port, figures, json_file)
        else:
            write_figures(figures, json_file)
            if wants_words(json_file):
                typer.echo(f"wrote {rrd}")


def _draw(recording: Path, at: Moment, to: Moment | None, settings: RecorderOptions) -> dict[str, Any]:
    """Draws the part of a recording between two moments, with a progress bar."""
    from eigenscan.recorder.rerun_sink import RerunSink
    from eigenscan.runtime.recording import contents, read
    from eigenscan.workbench.progress import Bars

    found = contents(recording)
    if not found.counts:
        raise UsageError(f"{recording}: holds no message of ours: give a file that eigenscan wrote")
    if len(found.sites) > 1:
        raise UsageError(f"{recording}: holds the sites {', '.join(found.sites)}: give the files of one")
    begin, end = found.stretch(at.after(found.begin), to.after(found.begin) if to else None)
    if begin > found.end:
        raise UsageError(f"--at: {recording} is from {span(found.begin, found.end)}")
    if to and end <= begin:
        raise UsageError("--to: must be after --at")
    try:
        sink = RerunSink(settings)
        with Bars() as bars:
            moved = bars.start_share(f"drawing {recording.name}")
            for record in read(recording, begin):
                if record.log_time > end:
                    break
                sink.write(replace(record.envelope, arrived=record.log_time))
                moved(max(record.log_time - begin, 0) / max(end - begin, 1))
        sink.close()
    except RuntimeError as error:  # rerun's, which does not always name a full disk
        assert settings.rrd is not None
        _check_room(settings.rrd)
        raise FailedError(f"{settings.rrd}: {error}") from error
    if not found.complete:
        typer.echo(f"{recording}: its writer did not close it; drawn as far as it goes", err=True)
    return {
        "messages": sink.counters["drawn"],
        "begin_s": (begin - found.begin) * 1e-9,
        "end_s": (end - found.begin) * 1e-9,
        "recording_s": (found.end - found.begin) * 1e-9,
        "whole": found.complete,
    }


def _check_room(part: Path) -> None:
    """Raises OSError where the disk, a quota or the shell's limit on files has no room for more."""
    from eigenscan.schemas.whole import PART

    try:
        with part.open("ab") as file:
            file.write(bytes(LEAST_FREE))
    except OSError as error:
        error.filename = str(part).removesuffix(PART)
        raise


def _open(picture: Path, port: int, figures: dict[str, Any], json_file: Path | None) -> None:
    """Writes the figures with the link, and serves the viewer with `picture` until Ctrl-C.

    Raises FailedError if its server ends before.
    """
    import time
    import webbrowser
    from contextlib import suppress

    from eigenscan.recorder.web_viewer import free_port, serve_viewer

    page, data = free_port("--port", HOST, port), free_port("data port", HOST, 0)
    with serve_viewer(HOST, page, data, picture) as viewer:
        write_figures(figures | {"link": viewer.link}, json_file)
        if wants_words(json_file):
            typer.echo(f"viewer: {viewer.link}\nCtrl-C ends it")
        webbrowser.open(viewer.link)
        with suppress(KeyboardInterrupt):
            while not viewer.problem:
                time.sleep(LOOK_S)
            raise FailedError(viewer.problem)
