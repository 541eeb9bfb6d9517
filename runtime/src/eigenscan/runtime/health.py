"""What a running service tells of itself: Health messages, Prometheus metrics, /healthz."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from eigenscan.schemas.envelope import Condition, stamp
from eigenscan.schemas.health_pb2 import Health
from prometheus_client import CollectorRegistry, Histogram
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.exposition import generate_latest
from prometheus_client.registry import Collector

STALLED_AFTER_S = 10.0
"""A loop that has not turned for this long makes /healthz fail."""


class _Counters(Collector):
    def __init__(self, read: Callable[[], Condition]) -> None:
        self._read = read

    def collect(self) -> Iterator[Metric]:
        condition = self._read()
        counts = CounterMetricFamily(
            "eigenscan_messages", "messages taken, said and set aside", labels=["what"]
        )
        for name, value in sorted(condition.counters.items()):
            counts.add_metric([name], value)
        yield counts
        status = GaugeMetricFamily("eigenscan_status", "1 ok, 2 waiting, 3 degraded")
        status.add_metric([], condition.status)
        yield status


class Monitor:
    """Keeps a service's condition; read from any thread."""

    def __init__(self, service: str, instance: str, version: str) -> None:
        self.service, self.instance, self.version = service, instance, version
        self._condition = Condition(Health.STATUS_WAITING, "starting")
        self._turned = time.monotonic()
        self._registry = CollectorRegistry()
        self._registry.register(_Counters(lambda: self._condition))
        self.handling = Histogram(
            "eigenscan_handling_seconds",
            "time in the core per message",
            ["channel"],
            registry=self._registry,
            buckets=(0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.5, 1, 10),
        )
        self._server: ThreadingHTTPServer | None = None

    def turn(self, condition: Condition) -> bool:
        """Notes that the loop turned; True where the status or its detail changed."""
        self._turned = time.monotonic()
        before, self._condition = self._condition, condition
        return (before.status, before.detail) != (condition.status, condition.detail)

    def message(self) -> Health:
        """The condition as the contract says it."""
        condition = self._condition
        return Health(
            timestamp=stamp(time.time_ns()),
            service=self.service,
            instance=self.instance,
            status=condition.status,
            detail=condition.detail,
            counters=dict(condition.counters),
            package_version=self.version,
        )

    def serve(self, host: str, port: int) -> int:
        """Serves /metrics and /healthz on a thread of their own; gives the port."""
        monitor = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                if self.path.startswith("/metrics"):
                    self._reply(200, "text/plain; version=0.0.4", generate_latest(monitor._registry))
                elif self.path.startswith("/healthz"):
                    stalled = time.monotonic() - monitor._turned > STALLED_AFTER_S
                    condition = monitor._condition
                    body = {
                        "status": Health.Status.Name(condition.status),
                        "detail": condition.detail,
                        "stalled": stalled,
                    }
                    self._reply(503 if stalled else 200, "application/json", json.dumps(body).encode())
                else:
                    self._reply(404, "text/plain", b"there are /metrics and /healthz\n")

            def _reply(self, code: int, kind: str, body: bytes) -> None:
                self.send_response(code)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *arguments: object) -> None:
                """Probes are not news."""

        self._server = ThreadingHTTPServer((host, port), Handler)
        threading.Thread(target=self._server.serve_forever, name="metrics", daemon=True).start()
        return int(self._server.server_address[1])

    def close(self) -> None:
        """Stops serving."""
        if self._server:
            self._server.shutdown()
            self._server.server_close()
