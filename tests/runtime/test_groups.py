"""One process that serves several robots, over real Zenoh."""

import json
from collections.abc import Callable
from typing import Any

from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.schemas.channels import HEALTH, SCAN, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.schemas.wire import decode

from tests.runtime.conftest import PATIENCE_S


def _ask(bus: Bus, net: Any, robot: str) -> None:
    address = {"site": net.site, "robot": robot, "lidar": "front"}
    bus.publish(Envelope(SCAN_RAW, address, RawScan(frame_id=robot)))


def _answers(inbox: Inbox, count: int) -> dict[str, int]:
    """Robots of the next answers, and how many scans had been answered before each; keys have no order."""
    robots: dict[str, int] = {}
    while len(robots) < count:
        arrival = inbox.take(PATIENCE_S)
        assert arrival is not None, f"{robots}, and no more"
        scan = decode(SCAN, arrival.payload, arrival.encoding)
        assert isinstance(scan, Scan)
        robots[scan.frame_id] = scan.sequence
    return robots


def test_a_group_is_served_and_nobody_else_and_new_robots_from_their_first_word(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    bus, inbox = buses(), Inbox()
    bus.listen([SCAN], {"site": net.site}, inbox)
    service = start("--robot", "a-*,b-7", config=net.leaf)
    service.log("ready")
    for robot in ("a-1", "b-7"):
        assert bus.wait_for_listener(
            SCAN_RAW.key({"site": net.site, "robot": robot, "lidar": "front"}), PATIENCE_S
        )
    for robot in ("a-1", "c-1", "b-70", "xa-1", "b-7", "a-new"):
        _ask(bus, net, robot)
    assert set(_answers(inbox, 3)) == {"a-1", "b-7", "a-new"}
    _ask(bus, net, "a-1")
    # what was received twice, or of others, would have been counted
    assert _answers(inbox, 1) == {"a-1": 3}


def test_groups_have_names_of_their_own_and_one_name_twice_is_noticed(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    bus, inbox = buses(), Inbox()
    bus.listen([HEALTH], {"site": net.site}, inbox)
    for group in ("a-*", "b-*"):
        start("--robot", group, config=net.leaf).log("ready")
    received: dict[str, Health] = {}

    def listen_until(holds: Callable[[], bool]) -> None:
        while not holds():
            arrival = inbox.take(PATIENCE_S)
            assert arrival is not None, f"heard of {sorted(received)}"
            health = decode(HEALTH, arrival.payload, arrival.encoding)
            assert isinstance(health, Health)
            received[health.instance] = health

    listen_until(lambda: len(received) == 2 and all(json.loads(h.settings) for h in received.values()))
    assert {name: json.loads(health.settings)["robot"] for name, health in received.items()} == {
        "a-+": "a-*",
        "b-+": "b-*",
    }
    start("--robot", "b-*", config=net.leaf)
    listen_until(lambda: received["b-+"].status == Health.STATUS_DEGRADED)
    assert "another tiny has the name 'b-+' too" in received["b-+"].detail
    assert received["a-+"].status != Health.STATUS_DEGRADED
