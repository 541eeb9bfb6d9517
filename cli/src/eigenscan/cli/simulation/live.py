"""A simulation at the pace of a clock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable

from eigenscan.cli.simulation.stage import Timed
from eigenscan.schemas.envelope import Envelope


def publish(
    messages: Iterable[Timed],
    say: Callable[[Envelope], None],
    speed: float = 1.0,
    stop: threading.Event | None = None,
) -> None:
    """Says each message when its time has come, `speed` times faster than real; until `stop` is set.

    Nothing is skipped: where the machine is too slow, messages come late.
    """
    stopped = stop or threading.Event()
    begun: int | None = None
    started = time.monotonic()
    for timed in messages:
        begun = timed.time if begun is None else begun
        ahead = (timed.time - begun) * 1e-9 / speed - (time.monotonic() - started)
        if stopped.wait(ahead) if ahead > 0 else stopped.is_set():
            return
        say(timed.envelope)
