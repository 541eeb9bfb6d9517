"""State of a running service: its Health messages, and what its metrics are made of."""

from __future__ import annotations

import math
import threading
import time
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from eigenscan.runtime.clock import Clock
from eigenscan.runtime.printable import printable
from eigenscan.runtime.settings import SettingsError
from eigenscan.schemas.envelope import Condition, stamp
from eigenscan.schemas.health_pb2 import Health

if TYPE_CHECKING:
    from eigenscan.runtime.metrics import Server

STALLED_AFTER_S = 10.0
"""Age of the core's last step beyond which /healthz fails, s."""

WAITING = "waiting"
"""Of each service: samples in its inbox."""
LEVELS = frozenset({WAITING, "lidars", "mcap_slowest_ms", "positions", "regions"})
"""Counters of the health whose rate has no meaning: gauges for Prometheus."""


def has_fallen(before: Mapping[str, int], after: Mapping[str, int]) -> bool:
    """Whether a counter of the health fell: then another process speaks, or the service began again."""
    return any(after.get(name, 0) < count for name, count in before.items() if name not in LEVELS)


DUPLICATE_HINT = "give each instance of a service its own --instance"
DUPLICATE_FORGOTTEN_S = 3.0
"""Age of the last message of a duplicate beyond which it counts as gone, s."""


class Times:
    """A histogram of seconds for each channel; prometheus_client's own takes several times as long."""

    def __init__(self, name: str, about: str, bounds: Sequence[float]) -> None:
        self.name, self.about, self.bounds = name, about, bounds
        self.counts: dict[str, list[int]] = {}
        """By channel: how many were at most each bound and above the one before, then those above all."""
        self.sums: dict[str, float] = {}

    def observe(self, channel: str, seconds: float) -> None:
        """Adds one duration."""
        counts = self.counts.get(channel)
        if counts is None:
            counts = self.counts[channel] = [0] * (len(self.bounds) + 1)
        counts[bisect_left(self.bounds, seconds)] += 1
        self.sums[channel] = self.sums.get(channel, 0.0) + seconds


class Monitor:
    """Holds a service's condition, for health and metrics; safe to use from any thread."""

    def __init__(
        self,
        service: str,
        instance: str,
        version: str,
        stalled_after_s: float = STALLED_AFTER_S,
        settings: str = "",
        clock: Clock = time,
    ) -> None:
        self.service, self.instance, self.version = service, instance, version
        self._settings, self._clock = settings, clock
        self._condition = Condition(Health.STATUS_WAITING, "starting")
        self.remark = ""
        """Published in every health message of this process, after the core's own detail."""
        self.missing = ""
        """What of others did not arrive; degraded while it says so."""
        self._turned: float | None = None
        self._stalled_after_s = stalled_after_s
        self._duplicate_seen_at = -math.inf
        self.handling = Times(
            "eigenscan_handling_seconds",
            "time in the core per message",
            (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.5, 1, 10),
        )
        self.lag = Times(
            "eigenscan_lag_seconds",
            "from a message's own stamp to the end of its handling, by this machine's clock",
            (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 60),
        )
        self._server: Server | None = None

    def turn(self, condition: Condition) -> bool:
        """Records a step of the core and its condition; True if status or detail changed."""
        self._turned = self._clock.monotonic()
        before, self._condition = self._condition, condition
        return (before.status, before.detail) != (condition.status, condition.detail)

    def handled(self, channel: str, seconds: float) -> None:
        """Records how long the core took for a message."""
        self.handling.observe(channel, seconds)

    def dealt_with(self, channel: str, stamp_ns: int) -> None:
        """Records a message's age at the end of its handling."""
        # a stamp ahead of this clock has no age, and a counter must not fall
        self.lag.observe(channel, max(self._clock.time_ns() - stamp_ns, 0) * 1e-9)

    def note_duplicate(self) -> None:
        """Records that another process publishes under this one's name."""
        self._duplicate_seen_at = self._clock.monotonic()

    def busy_s(self) -> float:
        """Seconds since the core's last step; 0 while it starts."""
        return 0.0 if self._turned is None else self._clock.monotonic() - self._turned

    def condition(self) -> Condition:
        """The core's condition; degraded if it makes no step, misses messages, or has another's name."""
        condition = self._condition
        if self._clock.monotonic() - self._duplicate_seen_at < DUPLICATE_FORGOTTEN_S:
            detail = f"another {self.service} has the name {self.instance!r} too: {DUPLICATE_HINT}"
            return Condition(Health.STATUS_DEGRADED, detail, condition.counters)
        if self.busy_s() > self._stalled_after_s:
            detail = f"no answer from the core for {self.busy_s():.0f} s"
            return Condition(Health.STATUS_DEGRADED, detail, condition.counters)
        if self.remark or self.missing:
            detail = "; ".join(filter(None, (condition.detail, self.remark, self.missing)))
            status = Health.STATUS_DEGRADED if self.missing else condition.status
            return Condition(status, detail, condition.counters)
        return condition

    def message(self) -> Health:
        """The condition as a message of the contract."""
        condition = self.condition()
        return Health(
            timestamp=stamp(self._clock.time_ns()),
            service=self.service,
            instance=self.instance,
            status=condition.status,
            detail=printable(condition.detail),  # it may quote what a stranger published
            counters=dict(condition.counters),
            package_version=self.version,
            settings=self._settings,
        )

    def probe(self) -> tuple[int, dict[str, object]]:
        """HTTP code and body of /healthz: 200 while the core makes steps, else 503."""
        condition = self.condition()
        starting, stalled = self._turned is None, self.busy_s() > self._stalled_after_s
        body = {
            "status": Health.Status.Name(condition.status),
            "detail": condition.detail,
            "starting": starting,
            "stalled": stalled,
        }
        return 503 if starting or stalled else 200, body

    def serve(self, host: str, port: int) -> int:
        """Serves /metrics and /healthz on their own thread; returns the port. Raises SettingsError."""
        from eigenscan.runtime.metrics import Server  # 10 MB that most services of a robot need not

        try:
            self._server = Server((host, port), self)
        except (OSError, TypeError, UnicodeError) as error:  # the latter two: no name of a host
            why = error.strerror if isinstance(error, OSError) else error
            raise SettingsError(
                f"metrics_port = {port}: cannot listen on {host}: {why}: "
                "choose another port, or 0; or another metrics_host"
            ) from error
        threading.Thread(target=self._server.serve_forever, args=(0.1,), name="metrics", daemon=True).start()
        return int(self._server.server_address[1])

    def close(self) -> None:
        """Stops serving."""
        if self._server:
            self._server.shutdown()
            self._server.server_close()
