"""Runs a core: decodes samples, lets the core handle them, publishes its answers and its condition."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable

from eigenscan.runtime.clock import Clock
from eigenscan.runtime.counters import Counters
from eigenscan.runtime.health import WAITING, Monitor
from eigenscan.runtime.inbox import Arrival, Inbox
from eigenscan.runtime.stop_event import Stopping
from eigenscan.schemas.channels import Channel, ContractError
from eigenscan.schemas.envelope import Condition, Core, Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tick import TICK, TICK_S, tick
from eigenscan.schemas.wire import decode

CONDITION_PERIOD_S = 0.25
SILENT_S = 10.0
"""Without its input for longer a service is no longer OK."""
TOO_SLOW_HINT = "give it more CPU time, or fewer robots (--robot) or regions (--part)"


class Work:
    """Runs one core from its first message to its last.

    An error in a message is counted and logged, not fatal.
    """

    def __init__(
        self,
        core: Core,
        inbox: Inbox,
        publish: Callable[[Envelope], None],
        keep: Callable[[Arrival], None],
        monitor: Monitor,
        counters: Counters,
        stop: Stopping,
        *,
        prompt: bool = False,
        drain_s: float = 0.0,
        clock: Clock = time,
        lives_on: Channel | None = None,
    ) -> None:
        """`keep` is called with each latched sample.

        `stop` ends the work, and is set when the condition changes.
        `prompt`: handles each message in the sender's thread. `drain_s`: seconds for messages that still wait
        when the work is stopped. `lives_on`: the input without which there is nothing to do.
        """
        self._drain_s = drain_s
        self._core, self._inbox, self._publish_one, self._keep = core, inbox, publish, keep
        self._monitor, self._counters, self._stop, self._prompt = monitor, counters, stop, prompt
        self._clock, self._lives_on = clock, lives_on
        self._fed_at: float | None = None
        self._due, self._tick_due = 0.0, (0.0 if TICK in core.inputs else math.inf)
        self._too_late = 0
        self._turn = threading.Lock()
        """Held by the thread that runs the core."""
        self.let_go_first: Callable[[], None] | None = None
        """Called after each answer: others in this thread handle it before the core makes the next one."""
        self._elsewhere_s = 0.0
        self._failing: dict[str, str] = {}
        """Why the core failed at the newest message of a channel, by the channel's name."""

    def begin(self) -> None:
        """Publishes the first messages of the core."""
        self._publish(self._core.start())

    def run(self) -> None:
        """Works until stopped, then publishes what the core holds back."""
        if self._prompt:
            self._inbox.on_put = self._work_off
        while not self._stop.stopping:
            self.keep_time()
            if self._prompt:
                self._work_off()  # samples that arrived meanwhile
                self._inbox.wait_until_closed(CONDITION_PERIOD_S)
            elif arrival := self._inbox.take(CONDITION_PERIOD_S):
                self._handle(arrival)
        self.finish()

    def step(self) -> bool:
        """Handles one waiting message; False if none waits. For a thread that runs several cores in turn."""
        arrival = self._inbox.take(0.0)
        if arrival is not None:
            self._handle(arrival)
        return arrival is not None

    def keep_time(self) -> None:
        """Sends the tick and reports the condition, when they are due."""
        now = self._clock.monotonic()
        if now >= self._tick_due:
            with self._turn:
                self._give(tick(self._clock.time_ns()), TICK.name)
            self._tick_due = now + TICK_S
        if now >= self._due:
            with self._turn:
                changed = self._monitor.turn(self._condition())
            if changed:
                self._stop.set()
            self._due = now + CONDITION_PERIOD_S

    def finish(self) -> None:
        """Handles what still waits, for the time there is for that; publishes what the core holds back."""
        end = self._clock.monotonic() + self._drain_s
        while self._clock.monotonic() < end and self.step():
            pass
        try:
            with self._turn:
                self._publish(self._core.finish())
        except Exception as error:
            self._counters.set_aside("finish_failed", "", error, trace=True)

    def _work_off(self) -> None:
        """Handles all waiting messages in this thread, unless another thread is doing so."""
        while len(self._inbox) and self._turn.acquire(blocking=False):
            try:
                while arrival := self._inbox.take(0.0):
                    self._handle(arrival)
            finally:
                self._turn.release()

    def _handle(self, arrival: Arrival) -> None:
        channel = arrival.channel
        address = channel.parse(arrival.key)
        if address is None:
            self._counters.set_aside("foreign_key", arrival.key)
            return
        try:
            message = arrival.message
            if message is None:
                message = decode(channel, arrival.payload, arrival.encoding)
            received = Envelope(channel, address, message, arrival.time, arrival.payload)
        except ContractError as error:
            self._counters.set_aside("undecodable", arrival.key, error)
            return
        self._give(received, arrival.key)
        if channel.qos.latched:
            self._keep(arrival)
        if channel.qos.rate_hz:  # channels with a rate have stamps
            self._monitor.dealt_with(channel.name, received.stamp)

    def _give(self, received: Envelope, key: str) -> None:
        """Lets the core handle a message, and publishes its answers."""
        name = received.channel.name
        self._counters.counts[f"heard_{name}"] += 1
        began, self._elsewhere_s = self._clock.perf_counter(), 0.0
        if received.channel is self._lives_on:
            self._fed_at = self._clock.monotonic()
        try:
            self._publish(self._core.handle(received))
            self._failing.pop(name, None)
        except Exception as error:
            # the next scan may be fine
            if not self._stop.stopping:
                self._failing[name] = str(error) or type(error).__name__
                self._counters.set_aside("core_failed", key, error, trace=True)
        self._monitor.handled(name, self._clock.perf_counter() - began - self._elsewhere_s)

    def _publish(self, envelopes: Iterable[Envelope]) -> None:
        for envelope in envelopes:
            self._publish_one(envelope)
            self._counters.counts[f"said_{envelope.channel.name}"] += 1
            if self.let_go_first is not None:
                left = self._clock.perf_counter()
                self.let_go_first()
                self._elsewhere_s += self._clock.perf_counter() - left

    def _condition(self) -> Condition:
        counters = dict(self._counters.counts)
        dropped = self._inbox.dropped
        if dropped.get("foreign_key", 0) > counters.get("foreign_key", 0):
            self._counters.counts["foreign_key"] = counters["foreign_key"] = dropped["foreign_key"]
            self._counters.warn("foreign_key", count=dropped["foreign_key"])
        if self._inbox.too_late > self._too_late:
            self._too_late = self._inbox.too_late
            self._counters.warn("too_slow", dropped=self._too_late, hint=TOO_SLOW_HINT)
        counters |= {f"dropped_{name}": count for name, count in dropped.items()}
        counters[WAITING] = len(self._inbox)
        try:
            own = self._core.condition()
        except Exception as error:
            self._counters.set_aside("core_failed", "", error, trace=True)
            return Condition(
                Health.STATUS_DEGRADED, f"the core cannot report its condition: {error}", counters
            )
        status, detail = own.status, own.detail
        if status == Health.STATUS_OK and (lacks := self._lacks()):
            status, detail = Health.STATUS_WAITING, lacks
        if self._failing:
            status = Health.STATUS_DEGRADED
            detail = "; ".join(filter(None, (detail, *self._fails())))
        return Condition(status, detail, dict(own.counters) | counters)

    def _fails(self) -> Iterable[str]:
        """What the core fails at, in words."""
        for name, why in sorted(self._failing.items()):
            yield f"the core fails at {name}: {why}: see core_failed in its log"

    def _lacks(self) -> str:
        """What no longer comes, in words; empty where it does."""
        if self._lives_on is None:
            return ""
        if self._fed_at is None:
            return f"no {self._lives_on.name} yet"
        silent = self._clock.monotonic() - self._fed_at > SILENT_S
        return f"no {self._lives_on.name} for more than {SILENT_S:.0f} s" if silent else ""
