"""The program that is judged: started as a service is, watched, and always ended."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from eigenscan.runtime.errors import UsageError

KILLED_AFTER_S = 10.0
LAST_LINES = 6


class Candidate:
    """A process of the user's command. Use `with`: at its end the process is gone.

    `reported` (zenoh, endpoint, site, …) replaces `{name}` in the command, and is in the environment as
    EIGENSCAN_NAME. Raises UsageError if the command cannot be started.
    """

    def __init__(self, command: Sequence[str], places: Mapping[str, str], log: Path) -> None:
        self.log = log
        words = [_filled(word, places) for word in command]
        if not shutil.which(words[0]):
            raise UsageError(f"{words[0]}: is no program that can be started: check the command after --")
        own = {f"EIGENSCAN_{name.upper()}": value for name, value in places.items()}
        with log.open("wb") as file:
            self._process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | own,
            )

    def __enter__(self) -> Candidate:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self.kill()

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
        text = self.log.read_text(encoding="utf-8", errors="replace")
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
