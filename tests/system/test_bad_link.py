"""A robot behind a bad radio: slow, cut off, back again; site and robot each as a machine of its own."""

import json
import math
import time
from collections.abc import Iterator
from itertools import pairwise

import pytest
from eigenscan.cli.fleet.status import rows
from eigenscan.fleet.view import FleetView
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import MODEL, MODEL_SET, POSE
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate

from tests.network import free_port
from tests.system.bad_link import BadLink
from tests.system.house import Ear, House
from tests.system.robot import Robot

pytestmark = pytest.mark.slow

LEASE_S = 10.0
"""Zenoh's: after so long in silence each side takes the other for gone."""
GAP_S = 3.0
WRONG_M, WRONG_RAD = 0.5, math.radians(10.0)


@pytest.fixture
def link(house: House) -> Iterator[BadLink]:
    """Between the house, which is the site, and a robot."""
    (endpoint,) = json.loads(house.config.read_text())["connect"]["endpoints"]
    link = BadLink(int(endpoint.rpartition(":")[2]))
    yield link
    link.close()


class Machine:
    """The robot's own computer: a router that its services and its ear meet at, and one way out."""

    def __init__(self, house: House, link: BadLink) -> None:
        self.house, port = house, free_port()
        alone = json.loads(house.config.read_text())
        # no way to the site but the radio: no other link, no memory in common
        alone["transport"]["shared_memory"] = {"enabled": False}
        alone["scouting"] = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
        out = {"endpoints": [f"tcp/127.0.0.1:{link.port}"], "timeout_ms": -1, "exit_on_failure": False}
        router = alone | {"mode": "peer", "listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]}, "connect": out}
        self.router, self.config = house.logs / "robot-router.json5", house.logs / "robot.json5"
        self.router.write_text(json.dumps(router))
        inside = alone | {"connect": {"endpoints": [f"tcp/127.0.0.1:{port}"], "timeout_ms": 10_000}}
        self.config.write_text(json.dumps(inside))
        house.start("router", "--zenoh", self.router, "--instance", "robot")
        self.session, self.ear = open_session(self.config), Ear()
        self.session.declare_subscriber(f"{house.site}/**", self.ear.on_sample)
        self.start("projector", "--keep", house.logs / "kept")
        self.start("tracker")
        self.start("scan-ingest")

    def start(self, service: str, *flags: object) -> None:
        """Starts a service on the robot, and receives it there: the site may be cut off."""
        outside, self.house.ear = self.house.ear, self.ear
        try:
            self.house.start(service, "--zenoh", self.config, *flags)
        finally:
            self.house.ear = outside


def claims(ear: Ear, since: int = 0) -> list[PoseEstimate]:
    """Poses to act on with stamps from `since`, ns."""
    return [
        pose
        for pose in ear.of(POSE, PoseEstimate)
        if pose.state == STATE_LOCALIZED and nanoseconds(pose.timestamp) >= since
    ]


def more_claims(ear: Ear, count: int, about: str) -> None:
    """Waits for some with stamps from now on."""
    since = time.time_ns()
    ear.wait_for(lambda _: len(claims(ear, since)) >= count, about)


def size_of(published: list[Envelope]) -> int:
    return sum(envelope.message.ByteSize() for envelope in published if envelope.channel is MODEL)


def test_a_robot_without_its_site_goes_on_and_catches_up(house: House, link: BadLink) -> None:
    machine = Machine(house, link)
    robot = Robot(house.site, machine.config)
    map_file = robot.write_map(house.logs)
    house.start("mapbuilder", "--map", map_file, "--step", "1.0")
    with FleetView(open_session(house.config), house.site) as view, robot:
        more_claims(house.ear, 5, "poses at the site")
        (first,) = {message.version for message in house.ear.of(MODEL_SET, ModelSet)}

        link.delay_s = 0.1
        more_claims(house.ear, 10, "poses at the site over a slow link")
        link.delay_s = 0.0

        cut = time.time_ns()
        link.cut()
        view.until(lambda: False, 0.5)  # what was under way
        house.kill("projector")
        machine.start("projector", "--keep", house.logs / "kept")
        more_claims(machine.ear, 5, "poses on the robot after a restart without the site")
        back = time.time_ns()
        house.kill("mapbuilder")
        before = len(house.ear.received)
        house.start("mapbuilder", "--map", map_file, "--step", "1.0", "--spacing", "0.6")
        silence = cut + int((LEASE_S + 2.0) * 1e9)
        machine.ear.wait_for(lambda _: claims(machine.ear, silence), "poses on the robot, long into the cut")
        assert {pose.model_version for pose in claims(machine.ear)} == {first}
        view.update()
        (row,) = rows(view)
        assert row["pose_age_s"] > LEASE_S / 2

        link.down_bytes = 0
        link.mend()
        machine.ear.wait_for(
            lambda _: any(pose.model_version != first for pose in claims(machine.ear, back)), "the new models"
        )
        more_claims(house.ear, 5, "poses at the site again")
        new = size_of(house.ear.received[before:])
        assert new < link.down_bytes < 2 * new, "each model came once"

        link.cut()
        time.sleep(LEASE_S + 2.0)
        link.down_bytes = 0
        link.mend()
        more_claims(house.ear, 30, "poses at the site after a second cut")
        assert link.down_bytes < new / 4, "what it had did not come again"
    machine.session.close()
    check(robot, claims(machine.ear), (cut, back))


def check(robot: Robot, made: list[PoseEstimate], restart: tuple[int, int]) -> None:
    """No wrong claim, and no long gap but for the projector's restart."""
    assert len(made) > 50
    for pose in made:
        x, y, heading = robot.stage.pose_at(nanoseconds(pose.timestamp))
        assert math.hypot(pose.pose.x - x, pose.pose.y - y) < WRONG_M
        assert abs(math.remainder(pose.pose.theta - heading, math.tau)) < WRONG_RAD
    stamps = sorted(nanoseconds(pose.timestamp) for pose in made)
    began, ended = restart
    gaps = [(b - a) * 1e-9 for a, b in pairwise(stamps) if not (a < ended and b > began)]
    assert max(gaps) < GAP_S
