"""Progress bars that cost nothing while the clock counts: drawn by hand, no thread. In a log, lines."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from eigenscan.runtime.errors import StoppedError, signal_within
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

REDRAWN_EVERY_S = 0.2
STATED_EVERY_S = 10.0
"""Where standard error is a file or a pipe: a line this often, so shorter work states nothing."""
SHARE = 100
"""Steps of a bar that shows a share."""


def _how_far(bar: Task) -> str:
    """Such as "windows 12 of 25" or "model 40 %"."""
    steps = f"{bar.completed:.0f} of {bar.total or 0:.0f}"
    return f"{bar.description} " + (f"{bar.completed:.0f} %" if bar.total == SHARE else steps)


class Bars:
    """Progress bars on standard error; a line now and then if that is no terminal. Use it with `with`.

    `transient`: bars disappear at the end.
    """

    def __init__(self, transient: bool = False) -> None:
        self._progress = Progress(
            TextColumn("{task.description:<13}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            auto_refresh=False,
            transient=transient,
            disable=not sys.stderr.isatty(),
        )
        self._drawn = time.monotonic()

    def __enter__(self) -> Bars:
        self._progress.start()
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        """Raises StoppedError, which states how far each bar is, in a KeyboardInterrupt's place."""
        self._progress.stop()
        if type(signal_within(error)) is KeyboardInterrupt:
            raise StoppedError(", ".join(map(_how_far, self._progress.tasks))) from None

    def start(self, title: str, total: int) -> Callable[[], None]:
        """Starts a bar; the function given back moves it by one."""
        bar = self._progress.add_task(title, total=total)
        self._draw(bar, at_once=True)

        def advance() -> None:
            self._progress.advance(bar)
            self._draw(bar, at_once=bool(self._progress.tasks[bar].finished))

        return advance

    def start_share(self, title: str) -> Callable[[float], None]:
        """Starts a bar; returns the function to call with its share, 0..1."""
        bar = self._progress.add_task(title, total=SHARE)
        self._draw(bar, at_once=True)

        def move(share: float) -> None:
            self._progress.update(bar, completed=int(SHARE * share))
            self._draw(bar, at_once=False)

        return move

    def start_steps(self) -> Callable[[str, float], None]:
        """Starts a bar for each step; returns the function to call with a step's name and share."""
        running: dict[str, Callable[[float], None]] = {}

        def moved(step: str, share: float) -> None:
            if step not in running:
                running[step] = self.start_share(step)
            running[step](share)

        return moved

    def _draw(self, bar: TaskID, at_once: bool) -> None:
        now = time.monotonic()
        if self._progress.disable:
            if now - self._drawn >= STATED_EVERY_S:
                print(_how_far(self._progress.tasks[bar]), file=sys.stderr, flush=True)
                self._drawn = now
        elif at_once or now - self._drawn >= REDRAWN_EVERY_S:
            self._progress.refresh()
            self._drawn = now
