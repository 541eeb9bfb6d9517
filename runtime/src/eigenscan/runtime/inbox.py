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
from typing import Any, NamedTuple

from eigenscan.schemas.channels import Channel
from google.protobuf.message import Message

MOST_BYTES = 2**28
"""Bytes that may wait in all, besides latched samples.

Each key has a queue, and a hostile sender may invent keys.
"""


SAMPLE_BYTES = 1000
"""Approximate memory of a waiting sample besides its payload."""

MOST_UNSORTED = 256
"""Samples that wait as they came before the sender's thread sorts them: a second of a busy robot."""

Take = Callable[[Any, int], None]
"""Puts a sample that arrived at a time, ns since the epoch."""


class Arrival(NamedTuple):
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
        *,
        wakes: bool = False,
        time_of_day: Callable[[], int] = time.time_ns,
    ) -> None:
        """`slack`: factor on the channels' depths, for a service that needs all samples.

        Beyond `most_bytes` the oldest samples of any key are dropped. The core is behind if the queue has not
        been empty for `behind_after_s` seconds of `clock`. `ready`: shared by inboxes that one thread
        empties. `batch_s`: `take` looks this often for samples that wake no thread, because waking one costs
        more than handling a message. Those are all samples, or with `wakes` only those of `sources`.
        """
        self._slack, self._behind_after_s, self._clock = slack, behind_after_s, clock
        self._through_at = 0.0  # when the queue was last empty
        self._waiting: OrderedDict[int, Arrival] = OrderedDict()  # by order of arrival
        self._orders: dict[str, deque[int]] = {}  # of the waiting samples, by key
        self._next = 0
        self._most_bytes, self._bytes = most_bytes, 0
        self._closed = self._discards = False
        self.batch_s, self._time_of_day = batch_s, time_of_day
        self.wakes = wakes or not batch_s
        """Whether a sample that is put wakes the thread that takes."""
        self.sources: list[Callable[[], None]] = []
        """Each puts what arrived elsewhere meanwhile."""
        self._unsorted: deque[tuple[Take, Any, int]] = deque()
        self._sorting = threading.Lock()
        self._ready = ready or threading.Condition()
        self.on_put: Callable[[], None] | None = None
        """Called after each sample, in the sender's thread, instead of waking another one."""
        self._dropped: Counter[str] = Counter()
        self.too_late = 0
        """Samples dropped for newer ones."""

    def put(
        self,
        channel: Channel,
        key: str,
        payload: bytes,
        encoding: str,
        message: Message | None = None,
        time: int | None = None,
    ) -> None:
        """Adds a sample; if its key's queue is full, drops the oldest of that key. `time`: by default now."""
        arrival = Arrival(
            channel, key, payload, encoding, message, self._time_of_day() if time is None else time
        )
        depth = channel.qos.depth
        with self._ready:
            if self._discards:
                return
            if not self._waiting:
                self._through_at = self._clock()
            orders = self._orders.get(key)
            if orders is None:
                orders = self._orders[key] = deque()
            elif depth and len(orders) >= self._slack * depth:
                self._give_way(channel, orders)
            orders.append(self._next)
            self._waiting[self._next] = arrival
            self._next += 1
            if depth:
                self._bytes += len(payload) + SAMPLE_BYTES
                if self._bytes > self._most_bytes:
                    self._make_room()
            if self.on_put is None and self.wakes:
                self._ready.notify()
        if self.on_put is not None:
            self.on_put()

    def put_unsorted(self, take: Take, sample: Any) -> None:
        """Adds a sample as it came; `take` puts it when the core's thread looks, where that is cheap."""
        if self._discards:
            return
        self._unsorted.append((take, sample, self._time_of_day()))
        if len(self._unsorted) > MOST_UNSORTED:
            self.sort()

    def sort(self) -> None:
        """Puts what arrived so far and woke no thread; called before a sample is put that came after it."""
        if not self.sources and not self._unsorted:
            return
        with self._sorting:  # one thread at a time, so that samples keep their order
            for source in self.sources:
                source()
            while self._unsorted:
                take, sample, time = self._unsorted.popleft()
                take(sample, time)

    def take(self, timeout: float) -> Arrival | None:
        """Oldest sample; None when closed, or after `timeout` seconds without one.

        If the core is behind and the channel allows it, the newest sample of the oldest one's key instead;
        those between are dropped. No key waits longer by that.
        """
        if self._unsorted or not self._waiting:  # else what the sources have came later
            self.sort()
        if timeout and not self._waiting and self._wait(timeout):
            self.sort()
        with self._ready:
            if not self._waiting:
                return None
            arrival = self._waiting[next(iter(self._waiting))]
            orders = self._orders[arrival.key]
            if arrival.channel.qos.newest and self._clock() - self._through_at > self._behind_after_s:
                while len(orders) > 1:
                    self._give_way(arrival.channel, orders)
            arrival = self._waiting.pop(orders.popleft())
            self._note_gone(arrival)
            if not orders:
                del self._orders[arrival.key]
            return arrival

    def _wait(self, timeout: float) -> bool:
        """Waits for a sample or until closed; whether there may be samples that woke no thread."""
        with self._ready:
            if self._waiting or self._closed:
                return False
            if self.batch_s:
                self._ready.wait(min(self.batch_s, timeout))
                return True
            self._ready.wait_for(lambda: self._waiting or self._closed, timeout)
            return False

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
        """Wakes the waiting thread. `discard`: what waits is dropped, and what is put from now on."""
        with self._ready:
            self._closed, self._discards = True, discard
            if discard:
                self._unsorted.clear()
                self._waiting.clear()
                self._orders.clear()
                self._bytes = 0
            self._ready.notify_all()

    @property
    def dropped(self) -> dict[str, int]:
        """Numbers of samples dropped or rejected, by channel or reason."""
        with self._ready:
            return dict(self._dropped)

    @property
    def waiting(self) -> dict[str, int]:
        """Numbers of sorted samples that wait, by key."""
        with self._ready:
            return {key: len(orders) for key, orders in self._orders.items()}

    @property
    def is_waiting(self) -> bool:
        """Whether a sorted sample waits."""
        return bool(self._waiting)

    def __len__(self) -> int:
        return len(self._waiting) + len(self._unsorted)
