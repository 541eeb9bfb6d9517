"""What /diagnostics shows: a service's health, and whether the robot is localized."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from eigenscan.ros_bridge.cdr import DIAGNOSTICS, encode, make
from eigenscan.ros_bridge.outbound import header
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import (
    STATE_AMBIGUOUS,
    STATE_LOCALIZED,
    STATE_LOST,
    PoseEstimate,
)

OK, WARN, ERROR, STALE = range(4)
"""diagnostic_msgs/DiagnosticStatus."""
LEVELS = {Health.STATUS_OK: OK, Health.STATUS_WAITING: WARN, Health.STATUS_DEGRADED: ERROR}
STATES = {
    STATE_LOCALIZED: (OK, "localized"),
    STATE_AMBIGUOUS: (WARN, "ambiguous: not sure enough yet"),
    STATE_LOST: (ERROR, "lost: no place fits"),
}


def diagnostics(health: Health, estimate: PoseEstimate | None) -> bytes:
    """DiagnosticArray of one service; the tracker's also has the newest pose since the one before, if any."""
    level = LEVELS.get(health.status, STALE)
    counters = {name: str(count) for name, count in sorted(health.counters.items())}
    statuses = [_status(health.service, level, health.detail or "ok", health.instance, counters)]
    if health.service == "tracker":
        statuses.append(_localization(health.instance, estimate))
    return encode(make(DIAGNOSTICS, header(nanoseconds(health.timestamp), ""), statuses))


def _localization(robot: str, estimate: PoseEstimate | None) -> Any:
    if estimate is None:
        return _status("localization", STALE, "no pose", robot, {})
    level, message = STATES.get(estimate.state, (STALE, "no state"))
    values = {"confidence": f"{estimate.confidence:.4f}"}
    if estimate.floor:
        values["floor"] = estimate.floor
    if estimate.HasField("protection_radius"):
        values["protection_radius"] = f"{estimate.protection_radius:.3f}"
    return _status("localization", level, message, robot, values)


def _status(name: str, level: int, message: str, robot: str, values: Mapping[str, str]) -> Any:
    pairs = [make("diagnostic_msgs/msg/KeyValue", key, value) for key, value in values.items()]
    return make("diagnostic_msgs/msg/DiagnosticStatus", level, f"eigenscan: {name}", message, robot, pairs)
