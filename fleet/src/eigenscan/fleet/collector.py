"""A site's robots and services as Prometheus' metrics."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

from eigenscan.fleet.view import FleetView
from eigenscan.runtime.health import LEVELS
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric


class SiteCollector:
    """A FleetView as Prometheus' metrics."""

    def __init__(self, view: FleetView) -> None:
        self._view = view
        self._lock = threading.Lock()

    def update(self) -> None:
        """Takes the messages since the last call; ages count from now."""
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
        for name in view.all_robots():
            robot = view.robots.get(name)
            pose, labels = robot.pose if robot is not None else None, [view.site, name]
            state.add_metric(labels, pose.state if pose is not None else 0)
            if robot is not None and pose is not None:
                confidence.add_metric(labels, pose.confidence)
                age.add_metric(labels, now - robot.received_at)
                old.add_metric(labels, float(robot.is_old(view.model_version)))
        yield from (state, confidence, age, old)

    def _services(self) -> Iterator[Metric]:
        who = ("service", "service_instance", "robot")  # "instance" is Prometheus' own
        now = time.monotonic()
        up = _gauge("service_up", "1 while it holds its liveliness token", *who)
        status = _gauge("service_status", "1 ok, 2 waiting, 3 degraded", *who)
        age = _gauge("service_health_age_seconds", "since its newest health arrived here", *who)
        clock = _gauge("service_clock_offset_seconds", "its clock before ours", *who)
        counts = CounterMetricFamily(
            "eigenscan_service_messages", "its own counters, since its start", labels=["site", *who, "what"]
        )
        levels = _gauge("service_level", "what it has now: samples that wait, regions", *who, "what")
        for service in self._view.services.values():
            labels = [self._view.site, service.name, service.instance, service.robot]
            up.add_metric(labels, float(bool(service.contracts)))
            if service.health is None:
                continue
            status.add_metric(labels, service.health.status)
            age.add_metric(labels, now - service.received_at)
            clock.add_metric(labels, service.clock_offset_s or 0.0)
            for what, count in sorted(service.health.counters.items()):
                (levels if what in LEVELS else counts).add_metric([*labels, what], count)
        yield from (up, status, age, clock, counts, levels)


def _gauge(name: str, about: str, *labels: str) -> GaugeMetricFamily:
    return GaugeMetricFamily(f"eigenscan_{name}", about, labels=["site", *labels])
