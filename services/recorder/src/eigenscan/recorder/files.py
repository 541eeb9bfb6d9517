"""The files of one recorder: their names, when the next one begins, and which go when there are too many."""

from __future__ import annotations

import fcntl
import re
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

SUFFIX = ".mcap"


@dataclass(frozen=True)
class Limits:
    """Limits of a file, and of all files of a recorder; None: no limit."""

    file_bytes: int | None = None
    file_ns: int | None = None
    total_bytes: int | None = None

    def is_full(self, size: int, head: int, age_ns: int) -> bool:
        """Whether the next file is to begin, at `size` bytes.

        The `head`, bytes, repeats the latched messages. Where it takes most of `file_bytes` by itself, a
        file grows to twice the head: otherwise each message would begin a file.
        """
        too_large = self.file_bytes is not None and size >= max(self.file_bytes, 2 * head)
        return too_large or (self.file_ns is not None and age_ns >= self.file_ns)


def _is_written(path: Path) -> bool:
    """Whether a RecordingWriter of any process has the file open; it holds a lock on it."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _size(path: Path) -> int:
    """Bytes; 0 for a file that another recorder has deleted meanwhile."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


@dataclass(frozen=True)
class Files:
    """Files in `target`, a folder, or named as `target` where that ends in .mcap.

    Their order is that of their names, which hold the start. File times change when files are copied. The
    files of this recorder come last, in the order of `begun`: a clock that is set back makes their names
    old, but not their content.
    """

    target: Path
    site: str
    begun: list[Path] = field(default_factory=list)
    stuck: list[str] = field(default_factory=list)
    """Files that were to be deleted and cannot be, and why."""

    def begin(self, now: int) -> Path:
        """A new empty file, named by the time `now`, ns since the epoch. Raises OSError.

        Numbers of deleted files are not used again.
        """
        first = self.target
        if not self._is_file:
            started = datetime.fromtimestamp(now / 1e9, tz=UTC)
            first = self.target / f"{self.site}-{started:%Y%m%d-%H%M%S}{SUFFIX}"
        first.parent.mkdir(parents=True, exist_ok=True)
        named = self._named()
        last = max((number for start, number, _ in named if start == first.stem), default=0)
        for number in count(last + 1):
            path = first if number == 1 else first.with_name(f"{first.stem}-{number}{SUFFIX}")
            with suppress(FileExistsError):  # another recorder was faster
                path.touch(exist_ok=False)
                break
        there = {each for *_, each in named}
        self.begun[:] = [each for each in self.begun if each in there] + [path]
        return path

    def own(self) -> list[Path]:
        """The files that recorders of this target wrote, oldest first."""
        here = {path: place for place, path in enumerate(self.begun)}
        return [path for *_, path in sorted(self._named(), key=lambda each: (here.get(each[2], -1), *each))]

    def _named(self) -> list[tuple[str, int, Path]]:
        """The name's start, the number after it, from 1 on, and the path of each file."""
        start = re.escape(self.target.stem) if self._is_file else rf"{re.escape(self.site)}-\d{{8}}-\d{{6}}"
        name = re.compile(rf"({start})(?:-(\d+))?{re.escape(SUFFIX)}")
        folder = self.target.parent if self._is_file else self.target
        found = [(name.fullmatch(path.name), path) for path in folder.glob(f"*{SUFFIX}")]
        return [(match[1], int(match[2] or 1), path) for match, path in found if match]

    def make_room(self, total_bytes: int) -> int:
        """Deletes the oldest files until all take at most `total_bytes`; how many.

        None that a recorder still writes. Those that cannot be deleted are `stuck`, and the next ones go.
        Other recorders may delete some at the same time.
        """
        files = self.own()
        self.stuck.clear()
        excess, deleted = sum(map(_size, files)) - total_bytes, 0
        for path in files:
            if excess <= 0:
                break
            size = _size(path)
            if _is_written(path):
                continue
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                self.stuck.append(f"{path}: {error.strerror}")
            else:
                excess -= size
                deleted += 1
        return deleted

    @property
    def _is_file(self) -> bool:
        return self.target.suffix == SUFFIX
