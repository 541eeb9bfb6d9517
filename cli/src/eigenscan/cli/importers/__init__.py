"""Logs of any kind, read as the pipeline's own messages: one module for each format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from eigenscan.cli.importers.log import Log, LogError, LogOptions, stamp_of

__all__ = ["Log", "LogError", "LogOptions", "open_log", "stamp_of"]

Opener = Callable[[Path, LogOptions], Log]


def open_log(path: Path, options: LogOptions | None = None) -> Log:
    """The log at `path`, a file or a folder, whatever its format; recognized by its content.

    Raises LogError where it cannot be read or is of no format that is known.
    """
    try:
        opener = _folder(path) if path.is_dir() else _file(path)
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}: check the path") from error
    return opener(path, options or LogOptions())


def _file(path: Path) -> Opener:
    with path.open("rb") as file:
        start = file.read(4096)
    if start.startswith(b"\x89MCAP"):
        from eigenscan.cli.importers.recording import RecordingLog

        return RecordingLog
    from eigenscan.cli.importers.carmen import CarmenLog, looks_like_carmen

    if looks_like_carmen(path):
        return CarmenLog
    raise _unknown(path, "is empty" if not start else "is of no known format")


def _folder(path: Path) -> Opener:
    raise _unknown(path, "is a folder without a ROS 2 bag")


def _unknown(path: Path, what: str) -> LogError:
    return LogError(f"{path}: {what}: give a CARMEN log (plain, .gz, .bz2), a ROS 1 or ROS 2 bag, or an MCAP")
