"""`eigenscan fleet metrics`: what robots and services say over Zenoh, for Prometheus, from one place."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from eigenscan.schemas.channels import DEFAULT_SITE

if TYPE_CHECKING:
    from eigenscan.fleet.view import FleetView
    from prometheus_client.core import GaugeMetricFamily, Metric

UPDATE_S = 0.2


def metrics(
    site: Annotated[str, typer.Option(help="name of the site")] = DEFAULT_SITE,
    zenoh: Annotated[Path | None, typer.Option(help="Zenoh configuration, JSON5")] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="serve /metrics here; 0 chooses one")] = 9200,
    host: Annotated[str, typer.Option(help="address to serve on")] = "127.0.0.1",
) -> None:
    """Serve the state of all robots and services of a site to Prometheus. Ctrl-C ends it.

    The robots need no open port, and nothing more crosses the air: it listens to poses and healths, which
    leave the robots anyway. deploy/prometheus and deploy/grafana have the alerts and a dashboard for it.

    \b
    Examples:
      eigenscan fleet metrics --site hospital --zenoh deploy/site.json5
      eigenscan fleet metrics --site hospital --port 9300 --host 0.0.0.0
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.cli.fleet.connection import connect
    from eigenscan.fleet.view import FleetView
    from eigenscan.runtime.errors import UsageError
    from eigenscan.runtime.wake import Wake
    from prometheus_client import CollectorRegistry, start_http_server

    wake = Wake()
    with wake.on_signals(), FleetView(connect(zenoh), site) as view:
        registry = CollectorRegistry()
        collector = SiteCollector(view)
        registry.register(collector)
        try:
            server, _ = start_http_server(port, host, registry)
        except OSError as error:
            raise UsageError(f"--port {port}: cannot listen on {host}: {error.strerror}") from error
        typer.echo(f"http://{host}:{server.server_port}/metrics")
        while not wake.stopping:
            wake.wait(UPDATE_S)
            collector.update()
        server.shutdown()


class SiteCollector:
    """A FleetView as Prometheus' metrics."""

    def __init__(self, view: FleetView) -> None:
        self._view = view
        self._lock = threading.Lock()

    def update(self) -> None:
        """Takes in what was heard: ages count from then."""
        with self._lock:
            self._view.update()

    def collect(self) -> Iterator[Metric]:
        """All metrics, of this moment."""
        with self._lock:
            return iter([*self._robots(), *self._services()])

    def _robots(self) -> Iterator[Metric]:
        view, now = self._view, time.monotonic()
        state = _gauge("robot_state", "0 unknown, 1 lost, 2 ambiguous, 3 localized", "robot")
        confidence = _gauge("robot_confidence", "of the newest pose", "robot")
        age = _gauge("robot_pose_age_seconds", "since the newest pose arrived here", "robot")
        old = _gauge(
            "robot_model_old", "1 where the newest pose is by an older model than the site's", "robot"
        )
        for name in view.robot_names():
            robot = view.robots.get(name)
            pose = robot.pose if robot is not None else None
            state.add_metric([name], pose.state if pose is not None else 0)
            if robot is not None and pose is not None:
                confidence.add_metric([name], pose.confidence)
                age.add_metric([name], now - robot.heard_at)
                newest = view.model_version
                old.add_metric([name], float(bool(newest) and pose.model_version != newest))
        yield from (state, confidence, age, old)

    def _services(self) -> Iterator[Metric]:
        from prometheus_client.core import CounterMetricFamily

        who = ("service", "service_instance", "robot")  # "instance" is Prometheus' own
        now = time.monotonic()
        up = _gauge("service_up", "1 while it holds its liveliness token", *who)
        status = _gauge("service_status", "1 ok, 2 waiting, 3 degraded", *who)
        age = _gauge("service_health_age_seconds", "since its newest health arrived here", *who)
        clock = _gauge("service_clock_offset_seconds", "its clock before ours", *who)
        counts = CounterMetricFamily(
            "eigenscan_service_messages", "its own counters, since its start", labels=[*who, "what"]
        )
        for service in self._view.services.values():
            labels = [service.name, service.instance, service.robot]
            up.add_metric(labels, float(bool(service.contracts)))
            if service.health is None:
                continue
            status.add_metric(labels, service.health.status)
            age.add_metric(labels, now - service.heard_at)
            clock.add_metric(labels, service.clock_offset_s or 0.0)
            for what, count in sorted(service.health.counters.items()):
                counts.add_metric([*labels, what], count)
        yield from (up, status, age, clock, counts)


def _gauge(name: str, about: str, *labels: str) -> GaugeMetricFamily:
    from prometheus_client.core import GaugeMetricFamily

    return GaugeMetricFamily(f"eigenscan_{name}", about, labels=labels)
