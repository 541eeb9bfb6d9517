"""Serves a service's Prometheus metrics and /healthz; imported only where the settings name a port."""

from __future__ import annotations

import json
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import accumulate
from socket import AF_INET, AF_INET6
from socketserver import TCPServer

from eigenscan.runtime.health import LEVELS, WAITING, Monitor, Times
from eigenscan.schemas.channels import CONTRACT_VERSION
from prometheus_client import CollectorRegistry, Info, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import generate_latest
from prometheus_client.registry import Collector
from prometheus_client.utils import floatToGoString


class Metrics:
    """All metrics of one service."""

    def __init__(self, monitor: Monitor) -> None:
        self._registry = CollectorRegistry()
        self._registry.register(_Counters(monitor))
        ProcessCollector(registry=self._registry)
        Info("eigenscan", "what runs here", registry=self._registry).info(
            {
                "service": monitor.service,
                "instance": monitor.instance,
                "version": monitor.version,
                "contract": str(CONTRACT_VERSION),
            }
        )
        self._registry.register(_Histogram(monitor.handling))
        self._registry.register(_Histogram(monitor.lag))

    def text(self) -> bytes:
        """All of them in Prometheus' text format."""
        return generate_latest(self._registry)


class _Counters(Collector):
    def __init__(self, monitor: Monitor) -> None:
        self._monitor = monitor

    def collect(self) -> Iterator[Metric]:
        condition = self._monitor.condition()
        counts = CounterMetricFamily(
            "eigenscan_messages",
            "messages received, published, dropped and rejected since the start",
            labels=["what"],
        )
        levels = GaugeMetricFamily("eigenscan_level", "what it has now, such as regions", labels=["what"])
        for name, value in sorted(condition.counters.items()):
            if name != WAITING:
                (levels if name in LEVELS else counts).add_metric([name], value)
        yield from (counts, levels)
        yield GaugeMetricFamily(
            "eigenscan_waiting_messages", "samples in the inbox now", condition.counters.get(WAITING, 0)
        )
        yield GaugeMetricFamily("eigenscan_status", "1 ok, 2 waiting, 3 degraded", condition.status)


class _Histogram(Collector):
    def __init__(self, times: Times) -> None:
        self._times = times

    def collect(self) -> Iterator[Metric]:
        times = self._times
        family = HistogramMetricFamily(times.name, times.about, labels=["channel"])
        names = [*map(floatToGoString, times.bounds), "+Inf"]
        for channel, counts in list(times.counts.items()):
            buckets = list(zip(names, accumulate(counts), strict=True))
            family.add_metric([channel], buckets, times.sums.get(channel, 0.0))
        yield family


class Server(ThreadingHTTPServer):
    """Serves /metrics and /healthz of one service."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, address: tuple[str, int], monitor: Monitor) -> None:
        """Raises OSError if it cannot listen there."""
        self.monitor, self.metrics = monitor, Metrics(monitor)
        self.address_family = AF_INET6 if ":" in address[0] else AF_INET
        super().__init__(address, _Handler)

    def server_bind(self) -> None:
        """Only binds: HTTPServer's asks the name server for a name, and a robot without a link would wait."""
        TCPServer.server_bind(self)

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignores probes that hang up."""


class _Handler(BaseHTTPRequestHandler):
    timeout = 5
    server: Server

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        if path == "/metrics":
            self._reply(200, "text/plain; version=0.0.4; charset=utf-8", self.server.metrics.text())
        elif path == "/healthz":
            code, body = self.server.monitor.probe()
            self._reply(code, "application/json", f"{json.dumps(body)}\n".encode())
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
