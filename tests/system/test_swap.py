"""Another projector in the place of ours, written against the contract alone: the robot still knows."""

import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import pytest
from eigenscan.geometry.gridmap import write_map
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import HEALTH, HYPOTHESES, POSE, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.workbench.conformance.generation import wing
from eigenscan.workbench.simulation.lidar import Lidar
from eigenscan.workbench.simulation.live import publish
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office

from tests.environment import ROOT
from tests.system.house import ONE_THREAD, PATIENCE_S, House

pytestmark = pytest.mark.slow

EXAMPLE = ROOT / "examples/exhaustive-projector/exhaustive_projector.py"
RATE_HZ = 5.0
ANSWER_WITHIN_S = 60.0
"""How long the next scan waits for an answer to the last one: more only where that is lost."""
WRONG_M, WRONG_RAD = 0.5, math.radians(10.0)
LARGEST_GAP_NS = 200_000_000


@pytest.fixture(params=[16.0])
def stage(house: House, request: pytest.FixtureRequest) -> Stage:
    """A robot in the house's site, and our services but for a projector."""
    stage = Stage(
        wing(office()).render(),
        Scenario(
            seconds=request.param, seed=5, people=1, lidar=Lidar(beams=181, rate=RATE_HZ), site=house.site
        ),
    )
    write_map(stage.grid, house.logs / "map.yaml")
    house.start("mapbuilder", "--map", house.logs / "map.yaml", "--step", 1.0)
    for service in ("tracker", "scan-ingest"):
        house.start(service)
    return stage


@contextmanager
def example(house: House, instance: str) -> Iterator[subprocess.Popen[bytes]]:
    """The projector of examples/, ready."""
    own = {"ZENOH": str(house.config), "SITE": house.site, "ROBOT": "robot", "INSTANCE": instance}
    environment = os.environ | ONE_THREAD | {f"EIGENSCAN_{name}": value for name, value in own.items()}
    with (house.logs / "example.log").open("ab") as log:
        process = subprocess.Popen([sys.executable, EXAMPLE], stdout=log, stderr=log, env=environment)
    try:
        house.ear.wait_for(
            lambda received: any(is_ready(one, instance) for one in received),
            f"the example\n{house.log('example')}",
        )
        yield process
    finally:
        process.kill()
        process.wait(PATIENCE_S)


def is_ready(one: Envelope, instance: str) -> bool:
    mine = one.channel is HEALTH and one.address["instance"] == instance
    return mine and one.open(Health).status == Health.STATUS_OK


def drive(house: House, stage: Stage, stop: threading.Event | None = None) -> threading.Thread:
    """The robot's messages at the pace of a clock, in the background, until `stop` is set.

    A scan waits until the one before it is answered: the example compares each with the whole map, and a busy
    machine must not decide which of them it leaves out.
    """
    bus = Bus(open_session(house.config))
    last = 0

    def is_answered(received: list[Envelope]) -> bool:
        return any(one.channel is HYPOTHESES and one.stamp >= last for one in reversed(received))

    def in_turn(envelope: Envelope) -> None:
        nonlocal last
        if envelope.channel is SCAN_RAW:
            if last:
                with house.ear.news:
                    house.ear.news.wait_for(lambda: is_answered(house.ear.received), ANSWER_WITHIN_S)
            last = envelope.stamp
        bus.publish(envelope)

    def run() -> None:
        with bus:
            publish(stage.messages(), in_turn, stop=stop)
            time.sleep(1.0)  # what waits in the session leaves it

    thread = threading.Thread(target=run)
    thread.start()
    return thread


def claims(house: House) -> list[PoseEstimate]:
    return [pose for pose in house.ear.of(POSE, PoseEstimate) if pose.state == STATE_LOCALIZED]


def wrong(poses: list[PoseEstimate], stage: Stage) -> list[str]:
    """Claimed poses that are not the true one, in words."""
    found = []
    for pose in poses:
        x, y, theta = stage.pose_at(nanoseconds(pose.timestamp)).tolist()
        away = math.hypot(pose.pose.x - x, pose.pose.y - y)
        turned = abs(math.remainder(pose.pose.theta - theta, math.tau))
        if away > WRONG_M or turned > WRONG_RAD:
            found.append(
                f"{away:.2f} m, {math.degrees(turned):.0f} deg off at {pose.timestamp.ToJsonString()}"
            )
    return found


def test_with_another_projector_the_pipeline_localizes(house: House, stage: Stage) -> None:
    with example(house, "another") as process:
        drive(house, stage).join()
        scans = len(stage.scan_ticks)
        house.ear.wait_for(lambda _: len(house.ear.of(SCAN_RAW, SCAN_RAW.message)) == scans, "all scans")
        house.ear.wait_for(lambda _: len(house.ear.of(POSE, PoseEstimate)) >= scans - 1, "poses")
        assert process.poll() is None, house.log("example")
    assert {e.address["projector"] for e in house.ear.received if e.channel is HYPOTHESES} == {"another"}
    assert not wrong(claims(house), stage)
    assert len(claims(house)) >= 0.8 * scans


@pytest.mark.parametrize("stage", [600.0], indirect=True, ids=["long"])
def test_a_rolling_swap_loses_nothing_and_claims_nothing_wrong(house: House, stage: Stage) -> None:
    house.start("projector")
    house.until("projector", lambda health: health.status == Health.STATUS_OK, "has models")
    stop = threading.Event()
    driving = drive(house, stage, stop)
    house.ear.wait_for(lambda _: len(claims(house)) >= 5, "our projector's poses")
    try:
        with example(house, "new"):
            house.ear.wait_for(
                lambda received: any(
                    e.channel is HYPOTHESES and e.address["projector"] == "new" for e in received
                ),
                "the new one's hypotheses",
            )
            assert house.terminate("projector") == 0
            alone = len(claims(house))
            house.ear.wait_for(lambda _: len(claims(house)) >= alone + 20, "poses with the new one alone")
    finally:
        stop.set()
        driving.join()
    stamps = sorted({nanoseconds(pose.timestamp) for pose in claims(house)})
    gaps = [after - before for before, after in pairwise(stamps)]
    assert max(gaps) <= LARGEST_GAP_NS
    assert not wrong(claims(house), stage)
