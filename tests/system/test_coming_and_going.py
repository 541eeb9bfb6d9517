"""A hundred robots come to a site and go: what it opened and remembered for them goes with them."""

import os
import time
from itertools import islice
from pathlib import Path

import psutil
import pytest
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import ALIVE_TEMPLATE, ODOMETRY, SCAN, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, stamp

from tests.system.house import PATIENCE_S, House, eventually
from tests.system.robot import Robot

pytestmark = pytest.mark.slow

FIRST, ALL = 20, 100
FEW_FILES = 5
"""A service opens some files and sockets by itself now and then."""
MORE_MB = 30.0
"""Of memory that a process may take for ALL - FIRST robots that are gone: 7 are usual, and on a busy machine
some 15 of compiled code may be loaded late. What a robot's models took would be hundreds."""
SERVICES = ("scan-ingest", "projector", "tracker", "recorder")


def visit(house: House, name: str, published: list[Envelope]) -> None:
    """A robot with a session of its own that publishes a little and leaves."""
    bus = Bus(open_session(house.config))
    bus.announce(house.site, "driver", name)
    raw = SCAN_RAW.key({"site": house.site, "robot": name, "lidar": "front"})
    assert bus.wait_for_listener(raw, PATIENCE_S)
    for envelope in published:
        envelope.message.timestamp.CopyFrom(stamp(time.time_ns()))  # type: ignore[attr-defined]
        bus.publish(Envelope(envelope.channel, {**envelope.address, "robot": name}, envelope.message))
    house.ear.wait_for(
        lambda received: any(
            e.channel is SCAN and e.address["robot"] == name for e in reversed(received[-200:])
        ),
        f"a scan of {name}",
    )
    bus.close()


def test_robots_that_are_gone_cost_nothing(house: House, tmp_path: Path) -> None:
    robot = Robot(house.site, house.config)
    house.start("mapbuilder", "--map", robot.write_map(house.logs), "--step", "1.0")
    house.start("recorder", "--mcap", tmp_path / "all.mcap")
    for service in ("scan-ingest", "projector", "tracker"):
        house.start(service, "--robot", "*")
    house.until("projector", lambda health: health.status == 1, "has its models")
    published = [
        timed.envelope
        for timed in islice(robot.stage.messages(), 40)
        if timed.envelope.channel in (SCAN_RAW, ODOMETRY)
    ]
    assert sum(envelope.channel is SCAN_RAW for envelope in published) >= 2
    processes = {name: psutil.Process(house.running[name].pid) for name in SERVICES}

    def held() -> dict[str, tuple[int, float]]:
        """Open files, and memory in MB; this process has the router."""
        house.until("tracker", lambda health: health.counters.get("waiting", 0) == 0, "has heard all")
        every = processes | {"router": psutil.Process(os.getpid())}
        return {name: (one.num_fds(), one.memory_info().rss / 1e6) for name, one in every.items()}

    for number in range(FIRST):
        visit(house, f"r{number}", published)
    before = held()
    for number in range(FIRST, ALL):
        visit(house, f"r{number}", published)
    after = held()
    # all of them were served
    lidars = house.until("scan-ingest", lambda health: health.counters["lidars"] >= ALL, "all lidars")
    assert lidars.counters["lidars"] == ALL
    for name in SERVICES:
        assert after[name][1] - before[name][1] < MORE_MB, f"{name}: {before} to {after}"
    # a session's last sockets and its token may go a moment after it
    drivers = ALIVE_TEMPLATE.format(site=house.site, service="driver", instance="*", contract="*")
    eventually(
        lambda: not [reply.ok for reply in house.session.liveliness().get(drivers) if reply.ok],
        "the end of the robots' tokens",
    )
    eventually(
        lambda: all(files - before[name][0] <= FEW_FILES for name, (files, _) in held().items()),
        f"the end of the robots' files; {before} before",
    )
