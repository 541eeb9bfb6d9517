"""Samples that wait for the core: bounded, oldest dropped first, in order of arrival.

Zenoh's threads only append here; a slow callback would stall its whole session.
"""

from __future__ import annotations

import threading
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass

from eigenscan.schemas.channels import Channel


@dataclass(frozen=True)
class Arrival:
    """One sample, not yet decoded."""

    channel: Channel
    key: str
    payload: bytes
    encoding: str


class Inbox:
    """Thread-safe queue over many keys, each bounded by its channel's depth. All it does takes O(1)."""

    def __init__(self, slack: int = 1) -> None:
        """`slack` times the channels' depth may wait: for who wants all of it rather than the newest."""
        self._slack = slack
        self._waiting: OrderedDict[int, Arrival] = OrderedDict()  # by order of arrival
        self._orders: dict[str, deque[int]] = {}  # of the samples that wait, by key
        self._next = 0
        self._closed = False
        self._ready = threading.Condition()
        self.on_put: Callable[[], None] | None = None
        """Called behind each sample, in its thread; then nobody is woken who takes."""
        self._dropped: Counter[str] = Counter()

    def put(self, channel: Channel, key: str, payload: bytes, encoding: str) -> None:
        """Adds a sample; where its key has enough waiting already the oldest of that key goes."""
        with self._ready:
            orders = self._orders.setdefault(key, deque())
            if channel.qos.depth and len(orders) >= self._slack * channel.qos.depth:
                del self._waiting[orders.popleft()]
                self._dropped[channel.name] += 1
            orders.append(self._next)
            self._waiting[self._next] = Arrival(channel, key, payload, encoding)
            self._next += 1
            if self.on_put is None:
                self._ready.notify()
        if self.on_put is not None:
            self.on_put()

    def take(self, timeout: float) -> Arrival | None:
        """Oldest sample, or None after `timeout` seconds without one, or when closed."""
        with self._ready:
            self._ready.wait_for(lambda: self._waiting or self._closed, timeout)
            if not self._waiting or self._closed:
                return None
            _, arrival = self._waiting.popitem(last=False)
            orders = self._orders[arrival.key]
            orders.popleft()
            if not orders:
                del self._orders[arrival.key]
            return arrival

    def wait_until_closed(self, timeout: float) -> None:
        """Waits, at most `timeout` seconds."""
        with self._ready:
            self._ready.wait_for(lambda: self._closed, timeout)

    def drop(self, reason: str) -> None:
        """Counts a sample that was not taken in."""
        with self._ready:
            self._dropped[reason] += 1

    def close(self) -> None:
        """Wakes whoever takes; nothing is given out any more."""
        with self._ready:
            self._closed = True
            self._ready.notify_all()

    @property
    def dropped(self) -> dict[str, int]:
        """Counts of samples not given out, by channel or reason."""
        with self._ready:
            return dict(self._dropped)

    def __len__(self) -> int:
        with self._ready:
            return len(self._waiting)
