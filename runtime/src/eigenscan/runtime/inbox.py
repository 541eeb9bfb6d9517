"""Samples that wait for the core: bounded, oldest dropped first, in order of arrival.

A core that falls behind gets of each sensor the newest sweep, in turn: it answers fewer, each fresh.

Zenoh's threads only append here; a slow callback would stall its whole session.
"""

from __future__ import annotations

import math
import threading
import time
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
    """Thread-safe queue over many keys, each bounded by its channel's depth. A sample costs it O(1)."""

    def __init__(
        self,
        slack: int = 1,
        behind_after_s: float = math.inf,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`slack` times the channels' depth may wait: for who wants all of it rather than the newest.

        Who has not been through with all that waits for `behind_after_s` of `clock`, in s, is behind.
        """
        self._slack, self._behind_after_s, self._clock = slack, behind_after_s, clock
        self._through_at = 0.0  # when a sample last found nothing before it
        self._waiting: OrderedDict[int, Arrival] = OrderedDict()  # by order of arrival
        self._orders: dict[str, deque[int]] = {}  # of the samples that wait, by key
        self._next = 0
        self._closed = False
        self._ready = threading.Condition()
        self.on_put: Callable[[], None] | None = None
        """Called after each sample, in its thread; then no other thread is woken."""
        self._dropped: Counter[str] = Counter()
        self.too_late = 0
        """Samples that gave way to newer ones of their key."""

    def put(self, channel: Channel, key: str, payload: bytes, encoding: str) -> None:
        """Adds a sample; where its key has enough waiting already the oldest of that key goes."""
        with self._ready:
            if not self._waiting:
                self._through_at = self._clock()
            orders = self._orders.setdefault(key, deque())
            if channel.qos.depth and len(orders) >= self._slack * channel.qos.depth:
                self._give_way(channel, orders)
            orders.append(self._next)
            self._waiting[self._next] = Arrival(channel, key, payload, encoding)
            self._next += 1
            if self.on_put is None:
                self._ready.notify()
        if self.on_put is not None:
            self.on_put()

    def take(self, timeout: float) -> Arrival | None:
        """Oldest sample, or None after `timeout` seconds without one, or when closed.

        If the service is behind and the channel allows, the newest of its key; those between are dropped.
        As the oldest decides whose turn it is, no key waits longer for that.
        """
        with self._ready:
            self._ready.wait_for(lambda: self._waiting or self._closed, timeout)
            if not self._waiting or self._closed:
                return None
            arrival = next(iter(self._waiting.values()))
            orders = self._orders[arrival.key]
            if arrival.channel.qos.newest and self._clock() - self._through_at > self._behind_after_s:
                while len(orders) > 1:
                    self._give_way(arrival.channel, orders)
            arrival = self._waiting.pop(orders.popleft())
            if not orders:
                del self._orders[arrival.key]
            return arrival

    def _give_way(self, channel: Channel, orders: deque[int]) -> None:
        """Drops the oldest sample of a key."""
        del self._waiting[orders.popleft()]
        self._dropped[channel.name] += 1
        self.too_late += 1

    def wait_until_closed(self, timeout: float) -> None:
        """Waits, at most `timeout` seconds."""
        with self._ready:
            self._ready.wait_for(lambda: self._closed, timeout)

    def drop(self, reason: str) -> None:
        """Counts a sample that was not taken in."""
        with self._ready:
            self._dropped[reason] += 1

    def close(self) -> None:
        """Wakes the waiting thread; nothing is given out any more."""
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
