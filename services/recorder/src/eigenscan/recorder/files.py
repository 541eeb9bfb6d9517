"""The files of one recorder: their names, when the next one begins, and which go when there are too many."""

from __future__ import annotations

import fcntl
import re
from dataclasses import dataclass
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

    def is_full(self, size: int, age_ns: int) -> bool:
        """Whether the next file is to begin."""
        too_large = self.file_bytes is not None and size >= self.file_bytes
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


@dataclass(frozen=True)
class Files:
    """Files in `target`, a folder, or named as `target` where that ends in .mcap."""

    target: Path
    site: str

    def unused(self, now: int) -> Path:
        """A name that no file has, by the time `now`, ns since the epoch."""
        first = self.target
        if not self._is_file:
            started = datetime.fromtimestamp(now / 1e9, tz=UTC)
            first = self.target / f"{self.site}-{started:%Y%m%d-%H%M%S}{SUFFIX}"
        others = (first.with_name(f"{first.stem}-{number}{SUFFIX}") for number in count(2))
        return first if not first.exists() else next(path for path in others if not path.exists())

    def own(self) -> list[Path]:
        """The files that recorders of this target wrote, oldest first."""
        start = re.escape(self.target.stem) if self._is_file else rf"{re.escape(self.site)}-\d{{8}}-\d{{6}}"
        name = re.compile(rf"{start}(-\d+)?{re.escape(SUFFIX)}")
        folder = self.target.parent if self._is_file else self.target
        found = [path for path in folder.glob(f"*{SUFFIX}") if name.fullmatch(path.name)]
        return sorted(found, key=lambda path: (path.stat().st_mtime_ns, path.name))

    def make_room(self, total_bytes: int, kept: Path) -> int:
        """Deletes the oldest files until all take at most `total_bytes`; how many.

        Never `kept`, and none that a recorder still writes.
        """
        files = self.own()
        excess, deleted = sum(path.stat().st_size for path in files) - total_bytes, 0
        for path in files:
            if excess <= 0:
                break
            if path != kept and not _is_written(path):
                excess -= path.stat().st_size
                path.unlink()
                deleted += 1
        return deleted

    @property
    def _is_file(self) -> bool:
        return self.target.suffix == SUFFIX
