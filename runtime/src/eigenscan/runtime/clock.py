"""The clock that a service goes by: of its machine, or of a simulated one."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol


class Clock(Protocol):
    """The part of the module `time` that services use; the module itself is one."""

    def monotonic(self) -> float:
        """Seconds; no one sets it."""
        ...

    def perf_counter(self) -> float:
        """Seconds, to measure how long something takes."""
        ...

    def time_ns(self) -> int:
        """Ns since the epoch; it may be set, forwards and back."""
        ...


Later = Callable[[float, Callable[[], None]], None]
"""Does something after so many seconds."""


def later(seconds: float, action: Callable[[], None]) -> None:
    """On a thread of its own; never, where the process ends before."""
    timer = threading.Timer(seconds, action)
    timer.daemon = True
    timer.start()
