"""`eigenscan repair`: a recording that was cut, made whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.runtime.errors import UsageError


def repair(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="recording, MCAP")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="MCAP to write; NAME.repaired.mcap beside it without")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Save all that can be read of a recording whose recorder was killed, or whose disk was full or failed.

    The file itself is left as it is. Whole recordings need no repair, and get none.
    Exit code 0: repaired, or whole already; 2: nothing can be saved.

    \b
    Examples:
      eigenscan repair night.mcap
      eigenscan repair night.mcap -o saved.mcap
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.runtime.recording import REPAIRED
    from eigenscan.runtime.repair import is_sound
    from eigenscan.runtime.repair import repair as save

    if file.is_dir():
        raise UsageError(f"{file}: is a folder: name one of its recordings")
    target = out or file.with_name(f"{file.stem}{REPAIRED}")
    prepare(json_file)
    with _progress(file) as passed:
        found = None if is_sound(file, passed("looking")) else save(file, target, passed("saving"))
    if found is None:
        if wants_words(json_file):
            typer.echo(f"{file}: is whole, nothing to repair")
        write_figures({"whole": True, "recording": str(file)}, json_file)
        return
    lost = [
        f"damaged chunks, lost: {found.lost_chunks}" if found.lost_chunks else "",
        f"messages lost: {found.lost_messages}" if found.lost_messages else "",
        "it breaks off" if found.cut else "",
        f"{found.beyond} bytes after its end, left out: another recording?" if found.beyond else "",
    ]
    words = ", ".join(part for part in lost if part) or "its index was missing or damaged"
    if wants_words(json_file):
        typer.echo(f"{target}: {found.messages} messages on {len(found.channels)} keys ({words})")
    figures = {
        "whole": False,
        "recording": str(target),
        "messages": found.messages,
        "keys": len(found.channels),
        "lost_chunks": found.lost_chunks,
        "lost_messages": found.lost_messages,
        "cut": found.cut,
        "bytes_beyond": found.beyond,
    }
    write_figures(figures, json_file)


@contextmanager
def _progress(file: Path) -> Iterator[Callable[[str], Callable[[int], None]]]:
    """Gives a bar over the file's bytes for each thing that is done with it, on a terminal."""
    from eigenscan.workbench.progress import Bars

    size = file.stat().st_size if file.exists() else 1
    with Bars(transient=True) as bars:

        def passed(what: str) -> Callable[[int], None]:
            moved = bars.start_share(what)
            return lambda done: moved(done / max(size, 1))

        yield passed
