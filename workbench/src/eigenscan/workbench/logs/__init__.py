"""Logs of any kind, read as the pipeline's own messages: one module for each format."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from eigenscan.workbench.logs.log import Log, LogError, LogOptions, Mount

__all__ = ["Log", "LogError", "LogOptions", "Mount", "open_log"]

Opener = Callable[[Path, LogOptions], Log]

_OF_A_MAP = frozenset((".yaml", ".yml", ".pgm", ".png"))
"""File name suffixes."""


def open_log(path: Path, options: LogOptions | None = None) -> Log:
    """Opens the log at `path`, a file or a folder. The content decides the format.

    Raises LogError if it cannot be read or has an unknown format.
    """
    try:
        opener = _folder(path) if path.is_dir() else _file(path)
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}: check the path") from error
    return opener(path, options or LogOptions())


def _file(path: Path) -> Opener:
    with path.open("rb") as file:
        start = file.read(16)
    if start.startswith(b"#ROSBAG V"):
        return _ros1
    if start.startswith(b"SQLite format 3"):
        return _ros2
    if start.startswith(b"\x89MCAP"):
        return _mcap
    if path.name.endswith(".mcap.zstd"):
        return _ros2_mcap
    from eigenscan.workbench.logs.carmen import CarmenLog, looks_like_carmen
    from eigenscan.workbench.logs.csv_table import CsvLog, looks_like_csv

    if looks_like_csv(path):
        return CsvLog
    if looks_like_carmen(path):
        return CarmenLog
    if path.suffix.lower() in _OF_A_MAP:
        raise LogError(f"{path}: is a map, no log: give a log in its place")
    if path.suffix.lower() == ".csv" and start:
        raise LogError(f"{path}: the first line must name the columns, with time_s: see docs/data.md")
    raise _unknown(path, "is of no known format" if start else "is empty")


def _folder(path: Path) -> Opener:
    if any(path.glob("*.mcap")):
        return _mcap
    if any(path.glob("*.mcap.zstd")):
        return _ros2_mcap
    if any(path.glob("*.db3*")):
        return _ros2
    raise _unknown(path, "is a folder without a ROS 2 bag")


def _ros1(path: Path, options: LogOptions) -> Log:
    from eigenscan.workbench.logs.ros import RosLog
    from eigenscan.workbench.logs.ros1 import Ros1Bag

    return RosLog(path, options, Ros1Bag(path))


def _ros2(path: Path, options: LogOptions) -> Log:
    from eigenscan.workbench.logs.ros import RosLog
    from eigenscan.workbench.logs.ros2 import Ros2Bag

    return RosLog(path, options, Ros2Bag(path))


def _ros2_mcap(path: Path, options: LogOptions) -> Log:
    from eigenscan.workbench.logs.ros import RosLog
    from eigenscan.workbench.logs.ros2 import McapBag

    return RosLog(path, options, McapBag(path))


def _mcap(path: Path, options: LogOptions) -> Log:
    if not path.is_dir():
        is_ours = _is_recording(path)
    else:
        is_ours = False
        for part in sorted(path.glob("*.mcap")):
            with suppress(LogError):  # of several files one may have been begun only
                is_ours = is_ours or _is_recording(part)
    if not is_ours:
        return _ros2_mcap(path, options)
    from eigenscan.workbench.logs.recording import RecordingLog

    return RecordingLog(path, options)


def _is_recording(path: Path) -> bool:
    """Whether an MCAP has channels of the pipeline."""
    from collections import Counter

    from eigenscan.schemas.channels import find
    from eigenscan.workbench.logs.mcap_messages import McapFile

    for topic, _, schema in McapFile(path, Counter()).channels():
        found = find(topic)
        if found is not None and found[0].schema_name == schema:
            return True
    return False


def _unknown(path: Path, what: str) -> LogError:
    return LogError(
        f"{path}: {what}: give a CARMEN log (plain, .gz, .bz2), a ROS 1 or ROS 2 bag, an MCAP, "
        "or a CSV with the column time_s"
    )
