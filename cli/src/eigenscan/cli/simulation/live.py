"""A simulation at the pace of a clock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable

from eigenscan.cli.simulation.stage import Timed
from eigenscan.schemas.envelope import Envelope

LATE_S = 0.05
"""What may be caught up with; a longer delay stays."""


def publish(
    messages: Iterable[Timed],
    say: Callable[[Envelope], None],
    speed: float = 1.0,
    stop: threading.Event | None = None,
) -> None:
    """Says each message when its time has come, `speed` times faster than real; until `stop` is set.

    Nothing is skipped, and nothing is said in a burst: where the machine is too slow, all that follows
    comes later.
    """
    stopped = stop or threading.Event()
    due: float | None = None
    last = 0
    for timed in messages:
        now = time.monotonic()
        due = now if due is None else max(due + (timed.time - last) * 1e-9 / speed, now - LATE_S)
        last = timed.time
        if stopped.wait(due - now) if due > now else stopped.is_set():
            return
        say(timed.envelope)
