"""A sink on its own thread, so that nothing waits for it."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Mapping

from eigenscan.recorder.core import Sink
from eigenscan.runtime.logs import logger
from eigenscan.schemas.envelope import Envelope

WAITING = 4096
"""Most messages that wait; then the oldest is dropped. Of each latched key the newest alone waits."""
DRAIN_S = 0.3
"""s at the end for messages that still wait."""


class BackgroundSink(Sink):
    """Passes messages to `sink` in the background; its failures are counted and logged."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._waiting: deque[Envelope] = deque()
        self._latched: dict[str, Envelope] = {}
        self._news = threading.Condition()
        self._end_at: float | None = None
        self._counts: Counter[str] = Counter(undrawn=0, undrawable=0)
        self._known: set[type[BaseException]] = set()
        self._thread = threading.Thread(target=self._run, name="background sink", daemon=True)
        self._thread.start()

    @property
    def problem(self) -> str:
        """The sink's problem."""
        return self._sink.problem

    @property
    def remark(self) -> str:
        """The sink's."""
        return self._sink.remark

    @property
    def counters(self) -> Mapping[str, int]:
        """Those of the sink, and `undrawn` (no time for it) and `undrawable` (it failed)."""
        return {**self._sink.counters, **self._counts}

    def write(self, received: Envelope) -> None:
        """Lets the message wait its turn."""
        with self._news:
            if received.channel.qos.latched:
                self._counts["undrawn"] += self._latched.pop(received.key, None) is not None
                self._latched[received.key] = received
            else:
                self._waiting.append(received)
                if len(self._waiting) > WAITING:
                    self._waiting.popleft()
                    self._counts["undrawn"] += 1
            self._news.notify()

    def close(self) -> None:
        """Gives waiting messages DRAIN_S, then closes the sink."""
        with self._news:
            self._end_at = time.monotonic() + DRAIN_S
            self._news.notify()
        self._thread.join(2 * DRAIN_S)
        self._counts["undrawn"] += len(self._waiting) + len(self._latched)
        if not self._thread.is_alive():
            try:
                self._sink.close()
            except Exception as error:  # the other sinks are to be closed, too
                logger().error("sink_not_closed", exc_info=error)

    def _run(self) -> None:
        while True:
            received = self._take()
            if received is None:
                return
            try:
                self._sink.write(received)
            except BaseException as error:  # a panic in Rerun's Rust is no Exception
                self._counts["undrawable"] += 1
                if type(error) not in self._known:
                    self._known.add(type(error))
                    logger().warning("undrawable", key=received.key, exc_info=error)

    def _take(self) -> Envelope | None:
        """The next message, latched ones first; None at the end."""
        with self._news:
            self._news.wait_for(lambda: self._waiting or self._latched or self._end_at is not None)
            late = self._end_at is not None and time.monotonic() > self._end_at
            if late:
                return None
            if self._latched:
                return self._latched.pop(next(iter(self._latched)))
            return self._waiting.popleft() if self._waiting else None
