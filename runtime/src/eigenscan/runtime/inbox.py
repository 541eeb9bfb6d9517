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
from google.protobuf.message import Message

MOST_BYTES = 2**28
"""That wait in all, beside latched samples: whoever makes up ever new keys has a queue for each of them."""


SAMPLE_BYTES = 1000
"""That a waiting sample takes beside its payload, about."""


@dataclass(frozen=True)
class Arrival:
    """One sample, not yet decoded, but for one of a service in the same process: that has its `message`."""

    channel: Channel
    key: str
    payload: bytes
    encoding: str
    message: Message | None = None
    time: int = 0
    """When it arrived, ns since the epoch by this machine's clock."""


class Inbox:
    """Thread-safe queue over many keys, each bounded by its channel's depth. A sample costs it O(1)."""

    def __init__(
        self,
        slack: int = 1,
        behind_after_s: float = math.inf,
        clock: Callable[[], float] = time.monotonic,
        ready: threading.Condition | None = None,
        most_bytes: int = MOST_BYTES,
        batch_s: float = 0.0,
    ) -> None:
        """`slack` times the channels' depth may wait: for who wants all of it rather than the newest.

        Beyond `most_bytes` the oldest go, of whatever key.
        Who has not been through with all that waits for `behind_after_s` of `clock`, in s, is behind.
        `ready`: of several inboxes that one thread empties.
        `batch_s`: a sample wakes nobody; who empties the inbox looks so often. To wake a thread costs more
        than to record a message.
        """
        self._slack, self._behind_after_s, self._clock = slack, behind_after_s, clock
        self._through_at = 0.0  # when a sample last found nothing before it
        self._waiting: OrderedDict[int, Arrival] = OrderedDict()  # by order of arrival
        self._orders: dict[str, deque[int]] = {}  # of the samples that wait, by key
        self._next = 0
        self._most_bytes, self._bytes = most_bytes, 0
        self._closed = self._discards = False
        self._batch_s = batch_s
        self._ready = ready or threading.Condition()
        self.on_put: Callable[[], None] | None = None
        """Called after each sample, in its thread; then no other thread is woken."""
        self._dropped: Counter[str] = Counter()
        self.too_late = 0
        """Samples that gave way to newer ones of their key."""

    def put(
        self, channel: Channel, key: str, payload: bytes, encoding: str, message: Message | None = None
    ) -> None:
        """Adds a sample; where its key has enough waiting already the oldest of that key goes."""
        with self._ready:
            if not self._waiting:
                self._through_at = self._clock()
            orders = self._orders.setdefault(key, deque())
            if channel.qos.depth and len(orders) >= self._slack * channel.qos.depth:
                self._give_way(channel, orders)
            orders.append(self._next)
            self._waiting[self._next] = Arrival(channel, key, payload, encoding, message, time.time_ns())
            self._next += 1
            if channel.qos.depth:
                self._bytes += len(payload) + SAMPLE_BYTES
                self._make_room()
            if self.on_put is None and not self._batch_s:
                self._ready.notify()
        if self.on_put is not None:
            self.on_put()

    def take(self, timeout: float) -> Arrival | None:
        """Oldest sample, or None after `timeout` seconds without one, or when closed.

        If the service is behind and the channel allows, the newest of its key; those between are dropped.
        As the oldest decides whose turn it is, no key waits longer for that.
        """
        with self._ready:
            if not self._waiting and not self._closed:
                if self._batch_s:
                    self._ready.wait(min(self._batch_s, timeout))
                else:
                    self._ready.wait_for(lambda: self._waiting or self._closed, timeout)
            if not self._waiting or self._discards:
                return None
            arrival = next(iter(self._waiting.values()))
            orders = self._orders[arrival.key]
            if arrival.channel.qos.newest and self._clock() - self._through_at > self._behind_after_s:
                while len(orders) > 1:
                    self._give_way(arrival.channel, orders)
            arrival = self._waiting.pop(orders.popleft())
            self._note_gone(arrival)
            if not orders:
                del self._orders[arrival.key]
            return arrival

    def _make_room(self) -> None:
        """Drops the oldest samples while all together are too large."""
        while self._bytes > self._most_bytes:
            oldest = next(each for each in self._waiting.values() if each.channel.qos.depth)
            orders = self._orders[oldest.key]
            self._give_way(oldest.channel, orders)
            if not orders:
                del self._orders[oldest.key]

    def _note_gone(self, arrival: Arrival) -> None:
        if arrival.channel.qos.depth:
            self._bytes -= len(arrival.payload) + SAMPLE_BYTES

    def _give_way(self, channel: Channel, orders: deque[int]) -> None:
        """Drops the oldest sample of a key."""
        self._note_gone(self._waiting.pop(orders.popleft()))
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

    def close(self, *, discard: bool = True) -> None:
        """Wakes the waiting thread. Nothing more is given out; without `discard`, what waits still is."""
        with self._ready:
            self._closed, self._discards = True, discard
            self._ready.notify_all()

    @property
    def dropped(self) -> dict[str, int]:
        """Counts of samples not given out, by channel or reason."""
        with self._ready:
            return dict(self._dropped)

    def __len__(self) -> int:
        with self._ready:
            return len(self._waiting)
