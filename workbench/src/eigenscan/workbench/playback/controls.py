"""Pause, seek and the like: keys of a terminal, or words on standard input."""

from __future__ import annotations

import io
import os
import queue
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Protocol, TextIO

from eigenscan.runtime.errors import UsageError

if TYPE_CHECKING:
    from blessed import Terminal

STEP_S, LEAP_S = 5.0, 60.0
MOST_S = 1e9
"""Thirty years: farther than any recording goes, and fewer than a stamp can count."""


class Do(Enum):
    """Commands of a playback."""

    TOGGLE = "toggle"
    PAUSE = "pause"
    PLAY = "play"
    STEP = "step"
    """Publishes one message, and stays paused."""
    SKIP = "skip"
    """Goes on some seconds later, or earlier."""
    SEEK = "seek"
    """Goes on at a second of the recording."""
    END = "end"


@dataclass(frozen=True)
class Command:
    """Something to do; `seconds` for SKIP and SEEK."""

    do: Do
    seconds: float = 0.0


class Controls(Protocol):
    """A source of commands."""

    hint: str
    """The commands in a few words."""

    def wait(self, seconds: float | None) -> Command | None:
        """The next command, or None after `seconds`; None waits without end."""
        ...


class NoControls:
    """A source without commands."""

    hint = ""

    def wait(self, seconds: float | None) -> Command | None:
        """Waits."""
        time.sleep(max(0.0, seconds or 0.0))
        return None


KEYS = {
    " ": Command(Do.TOGGLE),
    ".": Command(Do.STEP),
    "q": Command(Do.END),
    "KEY_LEFT": Command(Do.SKIP, -STEP_S),
    "KEY_RIGHT": Command(Do.SKIP, STEP_S),
    "KEY_DOWN": Command(Do.SKIP, -LEAP_S),
    "KEY_UP": Command(Do.SKIP, LEAP_S),
}
"""As in players of films."""


class Keyboard:
    """Keys of a terminal that gives them at once."""

    hint = f"space: pause  ←→: {STEP_S:g} s  ↓↑: {LEAP_S:g} s  .: one message  q: end"

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal

    def wait(self, seconds: float | None) -> Command | None:
        """As Controls; other keys end the wait early."""
        key = self._terminal.inkey(timeout=None if seconds is None else max(0.0, seconds))
        return KEYS.get(key.name or str(key))


class Script:
    """Lines such as `pause`, `play`, `step`, `seek 120`, `skip -5`, `end`. At their end it plays on."""

    hint = "commands from standard input"

    def __init__(self, lines: TextIO) -> None:
        self._lines = lines
        self._published: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._listen, name="script", daemon=True).start()

    def wait(self, seconds: float | None) -> Command | None:
        """As Controls. Raises UsageError for a line that is no command."""
        try:
            line = self._published.get(timeout=None if seconds is None else max(0.0, seconds))
        except queue.Empty:
            return None
        return _command(line)

    def _listen(self) -> None:
        for line in self._lines:
            if line.strip():
                self._published.put(line)
        self._published.put(Do.PLAY.value)


def _command(line: str) -> Command:
    word, *rest = line.split()
    try:
        do = Do(word)
        (seconds,) = map(float, rest) if do in {Do.SKIP, Do.SEEK} else [0.0]
        if not abs(seconds) <= MOST_S:
            raise ValueError
    except ValueError:
        known = ", ".join(f"{do.value} S" if do in {Do.SKIP, Do.SEEK} else do.value for do in Do)
        raise UsageError(f"standard input: {line.strip()!r} is no command; choose one of {known}") from None
    return Command(do, seconds)


@contextmanager
def controls(*, scripted: bool) -> Iterator[Controls]:
    """Standard input's words if `scripted`; else keys, on a terminal in the foreground."""
    if scripted:
        yield Script(sys.stdin or io.StringIO())
    elif sys.stdin and sys.stderr and sys.stdin.isatty() and sys.stderr.isatty() and _is_in_front():
        from blessed import Terminal

        terminal = Terminal(stream=sys.stderr)
        with terminal.cbreak():
            yield Keyboard(terminal)
    else:
        yield NoControls()


def _is_in_front() -> bool:
    """Whether this process is in the terminal's foreground; otherwise changing its mode suspends us."""
    return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
