"""What a child writes: to its log file, and its last lines in memory, also where the disk is full."""

from __future__ import annotations

import fcntl
import os
import sys
import threading
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import IO

LAST_LINES = 8
LINE_BYTES = 4096
"""A longer line comes in parts."""
PIPE_BYTES = 2**20
"""A child that writes so much waits where this process is stopped."""
READ_S = 1.0
"""Longest wait for the last words of a child that has ended."""


class Output:
    """Reads a child's output until its end.

    A child whose standard error is a file of a full disk would end without a word, or by an abort.
    """

    def __init__(self, log: Path, *, appends: bool) -> None:
        """`appends`: after what is in the file already. Raises OSError if it cannot be opened."""
        self._file = log.open("ab" if appends else "wb", buffering=0)
        self._lines: deque[str] = deque(maxlen=LAST_LINES)
        self._links: deque[str] = deque(maxlen=1)
        self._thread: threading.Thread | None = None

    def follow(self, pipe: IO[bytes]) -> None:
        """Begins to read."""
        if sys.platform == "linux":
            with suppress(PermissionError):  # the user has as many large pipes as the system allows
                fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._thread = threading.Thread(target=self._read, args=(pipe,), daemon=True)
        self._thread.start()

    def _read(self, pipe: IO[bytes]) -> None:
        with pipe, self._file:
            is_whole = True
            while line := pipe.readline(LINE_BYTES):
                text = line.decode(errors="replace").rstrip("\n")
                self._lines.append(text)
                if text.startswith("viewer: "):
                    self._links.append(text.removeprefix("viewer: ").strip())
                try:
                    # after a line that was cut, the next one has a line of its own
                    is_whole = os.write(self._file.fileno(), line if is_whole else b"\n" + line) >= len(line)
                except OSError:
                    is_whole = False

    @property
    def link(self) -> str | None:
        """The link to the live viewer, once the child has said it."""
        return self._links[-1] if self._links else None

    def last_lines(self) -> str:
        """Its end, indented."""
        return "\n".join(f"  {line}" for line in [*self._lines]) or "  (it logged nothing)"

    def close(self) -> None:
        """Reads the rest of a child that has ended."""
        if self._thread is not None:
            self._thread.join(READ_S)
