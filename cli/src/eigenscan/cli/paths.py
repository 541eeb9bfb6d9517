"""Paths on a command line: what is read can be read, and nothing that is needed is written over."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain, combinations, product
from pathlib import Path
from typing import Any

from eigenscan.cli.figures import wants_words
from eigenscan.runtime.errors import UsageError

WRITTEN = frozenset(
    ("out", "json_file", "junit_file", "rrd", "truth", "save_map", "save_poses", "save_runs"),
)
"""Parameters of all commands that name what is written; every other path is read."""

FILES = WRITTEN - {"out"}
"""Those that are never a folder."""

_MCAP = b"\x89MCAP0\r\n"

Named = tuple[str, Path]
"""A path, and how the user gave it."""


def check(parameters: list[Any], values: Mapping[str, Any]) -> None:
    """Raises UsageError for paths of a command that cannot be meant."""
    given = [(parameter.name, named) for parameter in parameters for named in _named(parameter, values)]
    written = [named for name, named in given if name in WRITTEN]
    read = [named for name, named in given if name not in WRITTEN]
    read += [(f"the image {image}", image) for _, path in read for image in _images_beside(path)]
    for shown, path in read:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise UsageError(f"{shown}: is no file that can be read to its end: name a file or a folder")
    for name, (shown, path) in given:
        if name in FILES and path.is_dir():
            raise UsageError(f"{shown}: is a folder: name a file in it")
    for (shown, path), (other, there) in chain(product(written, read), combinations(written, 2)):
        if path.exists() and not (path.is_file() or path.is_dir()):
            continue  # such as /dev/null
        if is_same(path, there):
            raise UsageError(f"{shown}: would overwrite {other}: name another file")
    for shown, path in written:
        if not values.get("force") and path.is_file() and _is_recorded(path):
            raise UsageError(f"{shown}: is a recorder's file: name another one")


def check_map_output(shown: str, path: Path, others: Iterable[Path]) -> None:
    """Raises UsageError where the image beside the map `path` would replace what is no image of that map."""
    image = path.with_suffix(".pgm")
    if path.suffix == ".pgm":
        raise UsageError(f"{shown} {path}: the image goes there: name a .yaml")
    check_others(f"{shown} {path}", image, others)
    if image.exists() and not path.exists():
        raise UsageError(f"{shown} {path}: {image.name} is there already: name another file")


def _images_beside(path: Path) -> list[Path]:
    """Images that a map_server yaml at `path` may name, as map savers name them."""
    if path.suffix not in (".yaml", ".yml"):
        return []
    return [image for end in (".pgm", ".png") if (image := path.with_suffix(end)).exists()]


def check_others(shown: str, path: Path, others: Iterable[Path]) -> None:
    """Raises UsageError where `path`, which a command writes besides, is one of `others`."""
    for other in others:
        if is_same(path, other):
            raise UsageError(f"{shown}: {path.name} would overwrite {other}: name another file")


def _is_recorded(path: Path) -> bool:
    """Whether `path` is a recording of what really was: what commands make can be made again."""
    with path.open("rb") as file:
        if file.read(len(_MCAP)) != _MCAP:
            return False
    from eigenscan.runtime.recording import RecordingError, read_metadata

    try:
        return "recorder" in read_metadata(path)
    except RecordingError:  # cut: only a recorder leaves such files
        return True


def is_same(one: Path, other: Path) -> bool:
    """Whether two paths lead to the same file, by links too."""
    try:
        return one.samefile(other)
    except OSError:  # one of them is not there
        return os.path.realpath(one) == os.path.realpath(other)


def written_ones(parameters: list[Any], values: Mapping[str, Any]) -> str:
    """What a command writes, as the user gave it."""
    return ", ".join(
        shown
        for parameter in parameters
        if parameter.name in WRITTEN
        for shown, _ in _named(parameter, values)
    )


def _named(parameter: Any, values: Mapping[str, Any]) -> Iterator[Named]:
    value = values.get(parameter.name)
    for path in value if isinstance(value, list | tuple) else [value]:
        if isinstance(path, Path) and wants_words(path):
            option = max(parameter.opts, key=len) if parameter.param_type_name == "option" else ""
            yield f"{option} {path}".strip(), path
