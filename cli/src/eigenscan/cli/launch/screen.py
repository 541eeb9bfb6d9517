"""The terminal of the demo and of `run`: a live line, and a summary."""

from __future__ import annotations

import time
from math import degrees

from eigenscan.runtime.printable import MOST, printable, shortened
from rich.console import Console
from rich.markup import escape

QUIET_PERIOD_S = 5.0
"""Without a terminal a line is printed so often."""


class StatusLine:
    """One line that is rewritten on a terminal; elsewhere a line now and then."""

    def __init__(self, to_stderr: bool = False) -> None:
        self.console = Console(highlight=False, stderr=to_stderr)
        self._status = self.console.status("")
        self._due = 0.0

    def __enter__(self) -> StatusLine:
        if self.console.is_terminal:
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._status.stop()

    def show(self, text: str) -> None:
        """Puts `text` in the line."""
        if self.console.is_terminal:
            self._status.update(escape(_printable(text)))
        elif time.monotonic() >= self._due:
            self.keep(text)

    def keep(self, text: str) -> None:
        """Prints a line that stays."""
        self._due = time.monotonic() + QUIET_PERIOD_S
        self.console.print(_printable(text), markup=False, soft_wrap=True)

    def keep_own(self, text: str) -> None:
        """Prints this program's own text as it is, with its lines and columns."""
        self._due = time.monotonic() + QUIET_PERIOD_S
        self.console.print(text, markup=False, soft_wrap=True)


def _printable(text: str) -> str:
    """Printable and cut as a whole, with the gaps between its columns."""
    return "  ".join(map(printable, shortened(text, MOST).split("  ")))


def error_text(metres: float, radians: float) -> str:
    """An error as people read it."""
    return f"{100 * metres:.0f} cm, {degrees(radians):.1f} deg"
