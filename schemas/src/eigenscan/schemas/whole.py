"""Outputs that are there only once they are whole."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PART = ".part"


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """The place beside `path` to write to; at the end it becomes `path`, after an error it is deleted.

    So Ctrl-C leaves no half of a recording that looks like one. A device, such as /dev/null, is written to.
    """
    if path.exists() and not path.is_file():
        yield path
        return
    part = path.with_name(path.name + PART)
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
