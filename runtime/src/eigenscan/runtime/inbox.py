"""Samples that wait for the core: bounded, oldest dropped first, in order of arrival.

Zenoh's threads only append here; a slow callback would stall its whole session.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from dataclasses import dataclass

from eigenscan.schemas.channels import Channel


@dataclass(frozen=True)
class Arrival:
    """One sample, not yet decoded."""

    channel: Channel
    key: str
    payload: bytes
    encoding: str
    order: int


class Inbox:
    """Thread-safe queue over several channels; each is bounded by its own depth."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[Arrival]] = {}
        self._ready = threading.Condition()
        self._order = 0
        self.dropped: Counter[str] = Counter()

    def put(self, channel: Channel, key: str, payload: bytes, encoding: str) -> None:
        """Adds a sample; where its key's queue is full the oldest of that key goes."""
        with self._ready:
            queue = self._waiting.setdefault(key, deque())
            if channel.qos.depth and len(queue) >= channel.qos.depth:
                queue.popleft()
                self.dropped[channel.name] += 1
            queue.append(Arrival(channel, key, payload, encoding, self._order))
            self._order += 1
            self._ready.notify()

    def take(self, timeout: float) -> Arrival | None:
        """Oldest sample, or None after `timeout` seconds without one."""
        with self._ready:
            if not any(self._waiting.values()):
                self._ready.wait(timeout)
            waiting = [queue for queue in self._waiting.values() if queue]
            return min(waiting, key=lambda queue: queue[0].order).popleft() if waiting else None

    def __len__(self) -> int:
        with self._ready:
            return sum(len(queue) for queue in self._waiting.values())
