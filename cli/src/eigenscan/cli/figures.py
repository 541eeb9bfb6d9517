"""Results of a command: text for people, and JSON for scripts."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Annotated, Any

import typer

STDOUT = Path("-")

JsonFile = Annotated[
    Path | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help="write the figures here, JSON; -: to standard output, nothing else there",
    ),
]


def wants_words(target: Path | None) -> bool:
    """Whether standard output is for people."""
    return target != STDOUT


def prepare(target: Path | None) -> None:
    """Makes sure that `target` can be written: an error now, not after the work.

    No empty file stays: Ctrl-C may end the work before there is anything to write.
    """
    if target is not None and wants_words(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        was_there, place = target.exists(), target.resolve()
        target.touch()
        if not was_there:
            place.unlink(missing_ok=True)


def write_figures(figures: Any, target: Path | None) -> None:
    """Writes `figures` as JSON to `target`, if given; all numbers must be finite."""
    if target is None:
        return
    is_file = wants_words(target)  # a terminal may know ASCII alone
    text = json.dumps(figures, indent=1, allow_nan=False, ensure_ascii=not is_file and not _shows("°")) + "\n"
    text = text.encode("utf-8", "backslashreplace").decode()  # names of files that are no UTF-8
    if is_file:
        target.write_text(text, encoding="utf-8")
    else:
        typer.echo(text, nl=False)


def _shows(text: str) -> bool:
    """Whether standard output can show `text`."""
    try:
        text.encode(getattr(sys.stdout, "encoding", None) or "utf-8")
    except UnicodeEncodeError:
        return False
    return True


class Events:
    """Events of a running command, one JSON object a line, each at once."""

    def __init__(self, file: IO[str] | None) -> None:
        self._file = file

    def write(self, event: str, **values: Any) -> None:
        """Writes `event` with its values; all numbers must be finite."""
        if self._file is not None:
            line = json.dumps({"event": event, **values}, allow_nan=False, ensure_ascii=False)
            print(line, file=self._file, flush=True)


@contextmanager
def events(target: Path | None) -> Iterator[Events]:
    """Events go to `target`, standard output for `-`, nowhere without one."""
    if target is None or not wants_words(target):
        yield Events(sys.stdout if target else None)
        return
    with target.open("w", encoding="utf-8") as file:
        yield Events(file)


def print_rows(rows: dict[str, str], target: Path | None) -> None:
    """Prints names and values, a line each, where standard output is for people."""
    if wants_words(target):
        for name, value in rows.items():
            typer.echo(f"{name:<13} {value}")
