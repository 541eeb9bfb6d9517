"""/diagnostics: a service's health and the robot's state, as rqt_robot_monitor shows them."""

from __future__ import annotations

from typing import Any

import pytest
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.channels import ROS_PUBLISHED
from eigenscan.ros_bridge.core import RosBridgeCore
from eigenscan.schemas.channels import HEALTH, POSE
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.tracking_pb2 import (
    STATE_AMBIGUOUS,
    STATE_LOCALIZED,
    STATE_LOST,
    PoseEstimate,
    State,
)
from google.protobuf.wrappers_pb2 import BytesValue

from tests.services.ros_bridge.test_core import SITE, TIME, core

OK, WARN, ERROR, STALE = range(4)  # diagnostic_msgs/DiagnosticStatus


def statuses(
    bridge: RosBridgeCore, service: str = "tracker", instance: str = "r", **more: Any
) -> dict[str, Any]:
    """By name, what one health becomes."""
    health = Health(timestamp=stamp(TIME), service=service, instance=instance, **more)
    reported = Envelope(HEALTH, {"site": "s", "service": service, "instance": instance}, health)
    output = [each for each in Loopback([bridge]).receive(reported) if each.channel is ROS_PUBLISHED]
    if not output:
        return {}
    (one,) = output
    assert one.address["endpoint"] == "%diagnostics"
    body = cdr.decode(cdr.DIAGNOSTICS, one.open(BytesValue).value)
    assert (body.header.stamp.sec, body.header.stamp.nanosec) == divmod(TIME, 10**9)
    return {status.name.removeprefix("eigenscan: "): status for status in body.status}


@pytest.mark.parametrize(
    ("status", "level"),
    [(Health.STATUS_OK, OK), (Health.STATUS_WAITING, WARN), (Health.STATUS_DEGRADED, ERROR), (0, STALE)],
)
def test_health_is_a_level_a_message_and_counters(status: Health.Status, level: int) -> None:
    found = statuses(core(), "scan-ingest", status=status, detail="no scans", counters={"heard_scan_raw": 7})
    assert found.keys() == {"scan-ingest"}
    shown = found["scan-ingest"]
    assert (shown.level, shown.message, shown.hardware_id) == (level, "no scans", "r")
    assert [(pair.key, pair.value) for pair in shown.values] == [("heard_scan_raw", "7")]


@pytest.mark.parametrize(
    ("state", "level"), [(STATE_LOCALIZED, OK), (STATE_AMBIGUOUS, WARN), (STATE_LOST, ERROR)]
)
def test_the_state_comes_with_the_trackers_health(state: State, level: int) -> None:
    bridge = core()
    estimate = PoseEstimate(timestamp=stamp(TIME), state=state, confidence=0.5, floor="2nd")
    Loopback([bridge]).receive(Envelope(POSE, SITE, estimate))
    shown = statuses(bridge)["localization"]
    assert shown.level == level
    assert {pair.key: pair.value for pair in shown.values} == {"confidence": "0.5000", "floor": "2nd"}
    # no pose since: the state is not repeated
    assert statuses(bridge)["localization"].level == STALE


def test_other_robots_are_not_shown() -> None:
    assert statuses(core(), instance="r18") == {}


def test_it_can_be_switched_off() -> None:
    assert statuses(core(diagnostics="")) == {}


def test_a_robot_that_a_manager_paused_is_still_shown() -> None:
    bridge = core()
    bridge._lifecycle._state = 2
    assert statuses(bridge)["tracker"].level == STALE
