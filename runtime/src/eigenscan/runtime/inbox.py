"""A bounded queue of samples for the core, in order of arrival; the oldest are dropped first.

If the core falls behind, it receives the newest scan of each lidar in turn: fewer answers, each of them
recent. Zenoh's threads only append, because a slow callback would stall the whole session.
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
"""Bytes that may wait in all, besides latched samples.

Each key has a queue, and a hostile sender may invent keys.
"""


SAMPLE_BYTES = 1000
"""Approximate memory of a waiting sample besides its payload."""


@dataclass(frozen=True)
class Arrival:
    """One sample. It is not decoded yet, unless a service of the same process gave its `message`."""

    channel: Channel
    key: str
    payload: bytes
    encoding: str
    message: Message | None = None
    time: int = 0
    """When it arrived, ns since the epoch by this machine's clock."""


class Inbox:
    """Thread-safe queue over many keys, each bounded by its channel's depth. A sample costs O(1)."""

    def __init__(
        self,
        slack: int = 1,
        behind_after_s: float = math.inf,
        clock: Callable[[], float] = time.monotonic,
        ready: threading.Condition | None = None,
        most_bytes: int = MOST_BYTES,
        batch_s: float = 0.0,
        time_of_day: Callable[[], int] = time.time_ns,
    ) -> None:
        """`slack`: factor on the channels' depths, for a service that needs all samples.

        Beyond `most_bytes` the oldest samples of any key are dropped. The core is behind if the queue has not
        been empty for `behind_after_s` seconds of `clock`. `ready`: shared by inboxes that one thread
        empties. `batch_s`: a sample wakes no thread; `take` looks this often, because waking a thread costs
        more than recording a message.
        """
        self._slack, self._behind_after_s, self._clock = slack, behind_after_s, clock
        self._through_at = 0.0  # when the queue was last empty
        self._waiting: OrderedDict[int, Arrival] = OrderedDict()  # by order of arrival
        self._orders: dict[str, deque[int]] = {}  # of the waiting samples, by key
        self._next = 0
        self._most_bytes, self._bytes = most_bytes, 0
        self._closed = self._discards = False
        self._batch_s, self._time_of_day = batch_s, time_of_day
        self._ready = ready or threading.Condition()
        self.on_put: Callable[[], None] | None = None
        """Called after each sample, in the sender's thread, instead of waking another one."""
        self._dropped: Counter[str] = Counter()
        self.too_late = 0
        """Samples dropped for newer ones."""

    def put(
        self, channel: Channel, key: str, payload: bytes, encoding: str, message: Message | None = None
    ) -> None:
        """Adds a sample; if its key's queue is full, drops the oldest of that key."""
        with self._ready:
            if not self._waiting:
                self._through_at = self._clock()
            orders = self._orders.setdefault(key, deque())
            if channel.qos.depth and len(orders) >= self._slack * channel.qos.depth:
                self._give_way(channel, orders)
            orders.append(self._next)
            self._waiting[self._next] = Arrival(channel, key, payload, encoding, message, self._time_of_day())
            self._next += 1
            if channel.qos.depth:
                self._bytes += len(payload) + SAMPLE_BYTES
                self._make_room()
            if self.on_put is None and not self._batch_s:
                self._ready.notify()
        if self.on_put is not None:
            self.on_put()

    def take(self, timeout: float) -> Arrival | None:
        """Oldest sample; None when closed, or after `timeout` seconds without one.

        If the core is behind and the channel allows it, the newest sample of the oldest one's key instead;
        those between are dropped. No key waits longer by that.
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
        """Drops the oldest samples until the rest fits."""
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
        """Waits until closed, at most `timeout` seconds."""
        with self._ready:
            self._ready.wait_for(lambda: self._closed, timeout)

    def drop(self, reason: str) -> None:
        """Counts a rejected sample."""
        with self._ready:
            self._dropped[reason] += 1

    def close(self, *, discard: bool = True) -> None:
        """Wakes the waiting thread. `take` returns None from now on; without `discard`, after what waits."""
        with self._ready:
            self._closed, self._discards = True, discard
            self._ready.notify_all()

    @property
    def dropped(self) -> dict[str, int]:
        """Numbers of samples dropped or rejected, by channel or reason."""
        with self._ready:
            return dict(self._dropped)

    def __len__(self) -> int:
        with self._ready:
            return len(self._waiting)
