"""State of a running service: Health messages, Prometheus metrics, /healthz."""

from __future__ import annotations

import json
import math
import threading
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import accumulate

from eigenscan.runtime.clock import Clock
from eigenscan.runtime.settings import SettingsError
from eigenscan.schemas.channels import CONTRACT_VERSION
from eigenscan.schemas.envelope import Condition, stamp
from eigenscan.schemas.health_pb2 import Health
from prometheus_client import CollectorRegistry, Info, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import generate_latest
from prometheus_client.registry import Collector
from prometheus_client.utils import floatToGoString

STALLED_AFTER_S = 10.0
"""Age of the core's last step beyond which /healthz fails, s."""


WAITING = "waiting"
"""The only counter that also falls."""

DUPLICATE_HINT = "give each instance of a service its own --instance"
DUPLICATE_FORGOTTEN_S = 3.0
"""Age of the last message of a duplicate beyond which it counts as gone, s."""


class _Counters(Collector):
    def __init__(self, read: Callable[[], Condition]) -> None:
        self._read = read

    def collect(self) -> Iterator[Metric]:
        condition = self._read()
        counts = CounterMetricFamily(
            "eigenscan_messages",
            "messages received, published, dropped and rejected since the start",
            labels=["what"],
        )
        for name, value in sorted(condition.counters.items()):
            if name != WAITING:
                counts.add_metric([name], value)
        yield counts
        yield GaugeMetricFamily(
            "eigenscan_waiting_messages", "samples in the inbox now", condition.counters.get(WAITING, 0)
        )
        yield GaugeMetricFamily("eigenscan_status", "1 ok, 2 waiting, 3 degraded", condition.status)


class _Times(Collector):
    """A histogram of seconds for each channel; prometheus_client's own takes several times as long."""

    def __init__(self, name: str, about: str, bounds: Sequence[float]) -> None:
        self._name, self._about, self._bounds = name, about, bounds
        self._counts: dict[str, list[int]] = {}
        self._sums: dict[str, float] = {}

    def observe(self, channel: str, seconds: float) -> None:
        counts = self._counts.get(channel)
        if counts is None:
            counts = self._counts[channel] = [0] * (len(self._bounds) + 1)
        counts[bisect_left(self._bounds, seconds)] += 1
        self._sums[channel] = self._sums.get(channel, 0.0) + seconds

    def collect(self) -> Iterator[Metric]:
        family = HistogramMetricFamily(self._name, self._about, labels=["channel"])
        names = [*map(floatToGoString, self._bounds), "+Inf"]
        for channel, counts in list(self._counts.items()):
            buckets = list(zip(names, accumulate(counts), strict=True))
            family.add_metric([channel], buckets, self._sums.get(channel, 0.0))
        yield family


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
        self._turned: float | None = None
        self._stalled_after_s = stalled_after_s
        self._duplicate_seen_at = -math.inf
        self._registry = CollectorRegistry()
        self._registry.register(_Counters(self.condition))
        ProcessCollector(registry=self._registry)
        Info("eigenscan", "what runs here", registry=self._registry).info(
            {
                "service": service,
                "instance": instance,
                "version": version,
                "contract": str(CONTRACT_VERSION),
            }
        )
        self._handling = _Times(
            "eigenscan_handling_seconds",
            "time in the core per message",
            (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.5, 1, 10),
        )
        self._lag = _Times(
            "eigenscan_lag_seconds",
            "from a message's own stamp to the end of its handling, by this machine's clock",
            (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 60),
        )
        self._registry.register(self._handling)
        self._registry.register(self._lag)
        self._server: ThreadingHTTPServer | None = None

    def turn(self, condition: Condition) -> bool:
        """Records a step of the core and its condition; True if status or detail changed."""
        self._turned = self._clock.monotonic()
        before, self._condition = self._condition, condition
        return (before.status, before.detail) != (condition.status, condition.detail)

    def handled(self, channel: str, seconds: float) -> None:
        """Records how long the core took for a message."""
        self._handling.observe(channel, seconds)

    def dealt_with(self, channel: str, stamp_ns: int) -> None:
        """Records a message's age at the end of its handling."""
        self._lag.observe(channel, (self._clock.time_ns() - stamp_ns) * 1e-9)

    def note_duplicate(self) -> None:
        """Records that another process publishes under this one's name."""
        self._duplicate_seen_at = self._clock.monotonic()

    def busy_s(self) -> float:
        """Seconds since the core's last step; 0 while it starts."""
        return 0.0 if self._turned is None else self._clock.monotonic() - self._turned

    def condition(self) -> Condition:
        """The core's condition; degraded if it makes no step, or if another process has its name."""
        condition = self._condition
        if self._clock.monotonic() - self._duplicate_seen_at < DUPLICATE_FORGOTTEN_S:
            detail = f"another {self.service} has the name {self.instance!r} too: {DUPLICATE_HINT}"
            return Condition(Health.STATUS_DEGRADED, detail, condition.counters)
        if self.busy_s() > self._stalled_after_s:
            detail = f"no answer from the core for {self.busy_s():.0f} s"
            return Condition(Health.STATUS_DEGRADED, detail, condition.counters)
        if self.remark:
            detail = "; ".join(filter(None, (condition.detail, self.remark)))
            return Condition(condition.status, detail, condition.counters)
        return condition

    def message(self) -> Health:
        """The condition as a message of the contract."""
        condition = self.condition()
        return Health(
            timestamp=stamp(self._clock.time_ns()),
            service=self.service,
            instance=self.instance,
            status=condition.status,
            detail=condition.detail,
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

    def metrics(self) -> bytes:
        """All metrics in Prometheus' text format."""
        return generate_latest(self._registry)

    def serve(self, host: str, port: int) -> int:
        """Serves /metrics and /healthz on their own thread; returns the port. Raises SettingsError."""
        try:
            self._server = _Server((host, port), self)
        except OSError as error:
            raise SettingsError(
                f"metrics_port = {port}: cannot listen on {host}: {error.strerror}: choose another, or 0"
            ) from error
        threading.Thread(target=self._server.serve_forever, args=(0.1,), name="metrics", daemon=True).start()
        return int(self._server.server_address[1])

    def close(self) -> None:
        """Stops serving."""
        if self._server:
            self._server.shutdown()
            self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self, address: tuple[str, int], monitor: Monitor) -> None:
        self.monitor = monitor
        super().__init__(address, _Handler)

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignores probes that hang up."""


class _Handler(BaseHTTPRequestHandler):
    timeout = 5
    server: _Server

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        if path == "/metrics":
            self._reply(200, "text/plain; version=0.0.4; charset=utf-8", self.server.monitor.metrics())
        elif path == "/healthz":
            code, body = self.server.monitor.probe()
            self._reply(code, "application/json", json.dumps(body).encode())
        else:
            self._reply(404, "text/plain", b"see /metrics and /healthz\n")

    def _reply(self, code: int, kind: str, body: bytes) -> None:
        self.send_response(code)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *arguments: object) -> None:
        """Logs nothing."""
