"""The program that is judged: started as a service is, watched, and always ended."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress

from eigenscan.runtime.errors import UsageError

KILLED_AFTER_S = 10.0
LAST_LINES = 6
KEPT_BYTES = 65_536
"""Of the end of its output."""
READ_S = 1.0
"""Longest wait for the last words of a program that has ended."""


class Candidate:
    """A process of the user's command. Use `with`: at its end it and all that it started are gone.

    `reported` (zenoh, endpoint, site, …) replaces `{name}` in the command, and is in the environment as
    EIGENSCAN_NAME. Raises UsageError if the command cannot be started.
    """

    def __init__(self, command: Sequence[str], places: Mapping[str, str]) -> None:
        words = [_filled(word, places) for word in command]
        if not shutil.which(words[0]):
            raise UsageError(f"{words[0]}: is no program that can be started: check the command after --")
        own = {f"EIGENSCAN_{name.upper()}": value for name, value in places.items()}
        try:
            self._process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | own,
            )
        except OSError as error:  # a script without its first line
            raise UsageError(f"{words[0]}: {error.strerror}: check the command after --") from error
        self._written = bytearray()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> Candidate:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self.kill()
        self._end_children()

    def _end_children(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def _read(self) -> None:
        """Keeps the end of the output: a file would take as much of the disk as the program writes."""
        assert self._process.stdout is not None
        with self._process.stdout as pipe:
            while piece := os.read(pipe.fileno(), KEPT_BYTES):
                self._written = (self._written + piece)[-KEPT_BYTES:]

    @property
    def lives(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    @property
    def obituary(self) -> str:
        """How it ended by itself, with the last line that it wrote."""
        lines = self.last_lines
        return f"it ended with code {self._process.poll()}" + (f": {lines[-1]}" if lines else "")

    @property
    def last_lines(self) -> list[str]:
        """The last lines of its output."""
        if not self.lives:
            self._reader.join(READ_S)
        text = self._written.decode("utf-8", "replace")
        return [line for line in text.splitlines() if line.strip()][-LAST_LINES:]

    def kill(self) -> None:
        """Ends it without warning."""
        self._process.kill()
        self._process.wait()

    def terminate(self, patience: float = 1.0) -> tuple[int | None, float]:
        """Sends SIGTERM; returns the exit code (None if it had to be killed) and the seconds until the end.

        `patience`: factor on the time that it may take.
        """
        before = time.monotonic()
        self._process.send_signal(signal.SIGTERM)
        try:
            code = self._process.wait(KILLED_AFTER_S * patience)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            return None, time.monotonic() - before
        return code, time.monotonic() - before


def _filled(word: str, places: Mapping[str, str]) -> str:
    for name, value in places.items():
        word = word.replace(f"{{{name}}}", value)
    return word
