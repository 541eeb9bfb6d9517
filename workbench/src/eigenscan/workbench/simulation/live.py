"""A simulation at the pace of a clock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable

from eigenscan.schemas.envelope import Envelope
from eigenscan.workbench.simulation.stage import Timed

LATE_S = 0.05
"""Largest delay that is caught up, s; a longer one stays."""


class Metronome:
    """Due times of messages, `speed` times faster than real.

    None is skipped and none comes in a burst: on a slow machine, all later ones are delayed.
    """

    def __init__(self, speed: float = 1.0) -> None:
        self._speed = speed
        self.reset()

    def reset(self) -> None:
        """The next message is due at once."""
        self._due, self._last = 0.0, 0

    def rest(self, moment: int) -> float:
        """Seconds until the message of `moment` (ns) is due; moments must not decrease."""
        now = time.monotonic()
        if not self._due:
            self._due = now
        elif moment != self._last:
            self._due = max(self._due + (moment - self._last) * 1e-9 / self._speed, now - LATE_S)
        self._last = moment
        return self._due - now


def publish(
    messages: Iterable[Timed],
    publish: Callable[[Envelope], None],
    speed: float = 1.0,
    stop: threading.Event | None = None,
) -> None:
    """Publishes each message when its time has come, `speed` times faster than real; until `stop` is set."""
    stopped, metronome = stop or threading.Event(), Metronome(speed)
    for timed in messages:
        rest = metronome.rest(timed.time)
        if stopped.wait(rest) if rest > 0.0 else stopped.is_set():
            return
        publish(timed.envelope)
