"""A cupboard moves, and robots drive by: processes, a killed mapbuilder, an operator who accepts."""

import itertools
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from eigenscan.eigenspace.folder import read_models, write_models
from eigenscan.eigenspace.versions import kept_in
from eigenscan.geometry.circle import TURN
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import HYPOTHESES, MODEL, MODEL_SET, POSE, SCAN
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.model_pb2 import ModelSet, RegionModel
from eigenscan.schemas.scan_pb2 import Scan

from tests.environment import PROGRAMS
from tests.services.mapbuilder.keeping.patrol import KNOWN, MOVED, VISIT_S, Patrol
from tests.system.house import House

pytestmark = pytest.mark.slow

AT_ONCE = 100
"""Messages, so that the inbox holds them."""
LIVE_S, LIVE_AT_ONCE = 0.1, 20


@pytest.fixture
def model(tmp_path: Path) -> Path:
    write_models(build_site(KNOWN, Plan(step=TURN / 360)), tmp_path / "model")
    return tmp_path / "model"


def patrol(house: House, number: int) -> list[Envelope]:
    """What is published of the drive number `number`, each in a visit of its own."""
    return list(Patrol(number).messages(MOVED, number * VISIT_S, site=house.site))


def count_of(house: House, version: str) -> int:
    """Answers from the models of that version."""
    return sum(answer.model_version == version for answer in house.ear.of(HYPOTHESES, Hypotheses))


def drive(house: House, scans: list[int], stop: threading.Event) -> None:
    """At the pace of a lidar, until asked to stop; `scans`: the stamps of what was published."""
    with Bus(open_session(house.config)) as bus:
        for number in itertools.count(6):
            for envelope in Patrol(number).messages(MOVED, number * VISIT_S, site=house.site):
                if stop.is_set():
                    return
                bus.publish(envelope)
                if envelope.channel is SCAN:
                    scans.append(nanoseconds(envelope.open(Scan).timestamp))
                    time.sleep(LIVE_S)
                    # never more of them than the projector's inbox holds
                    while len(scans) - len(house.ear.of(HYPOTHESES, Hypotheses)) > LIVE_AT_ONCE:
                        if stop.wait(LIVE_S):
                            return


def _has_received(poses: int) -> Callable[[Health], bool]:
    return lambda health: health.counters["heard_pose"] >= poses


def report(house: House, messages: list[Envelope], received: int) -> int:
    """As fast as the mapbuilder receives, after so many poses; gives how many it has then."""
    with Bus(open_session(house.config)) as bus:
        for first in range(0, len(messages), AT_ONCE):
            part = messages[first : first + AT_ONCE]
            for envelope in part:
                bus.publish(envelope)
            received += sum(envelope.channel is POSE for envelope in part)
            house.until("mapbuilder", _has_received(received), "has received all")
    return received


def test_a_moved_cupboard_is_proposed_accepted_and_used_and_no_scan_is_lost(
    house: House, model: Path
) -> None:
    before = read_models(model).to_message()
    house.start("mapbuilder", "--model", model)
    report(house, patrol(house, 1), report(house, patrol(house, 0), 0))
    # of the visit that runs only what was saved is kept; the one before must be
    house.kill("mapbuilder")
    house.start("mapbuilder", "--model", model)
    received = 0
    for number in range(2, 6):
        received = report(house, patrol(house, number), received)
    health = house.until("mapbuilder", lambda health: "proposed as" in health.detail, "proposes a version")
    assert health.status == Health.STATUS_OK
    assert f"eigenscan models accept {model}" in health.detail
    assert read_models(model).to_message() == before  # nothing is edited behind anybody's back
    (proposal,) = kept_in(model).iterdir()
    assert (proposal / "change.png").stat().st_size > 1000

    house.start("projector", "--robot", "r1")
    house.until("projector", lambda health: health.status == Health.STATUS_OK, "has models")
    reported = len(house.ear.of(MODEL, RegionModel))
    scans, stop = list[int](), threading.Event()
    robot = threading.Thread(target=drive, args=(house, scans, stop))
    robot.start()
    try:
        house.ear.wait_for(lambda _: len(house.ear.of(HYPOTHESES, Hypotheses)) > 10, "hypotheses")
        accept = [str(PROGRAMS / "eigenscan"), "models", "accept", str(model)]
        assert subprocess.run(accept, check=False, capture_output=True).returncode == 0
        after = read_models(model).to_message()
        house.ear.wait_for(lambda _: count_of(house, after.version) > 10, "answers from the new models")
    finally:
        stop.set()
        robot.join()
    house.ear.wait_for(lambda _: len(house.ear.of(HYPOTHESES, Hypotheses)) >= len(scans), "all answers")
    answers = house.ear.of(HYPOTHESES, Hypotheses)
    assert [nanoseconds(answer.timestamp) for answer in answers] == scans
    versions = [answer.model_version for answer in answers]
    assert sorted(set(versions), key=versions.index) == [before.version, after.version]
    assert versions == sorted(versions, key=[before.version, after.version].index)
    sets = house.ear.of(MODEL_SET, ModelSet)
    assert [one.version for one in sets][-1] == after.version
    old = {entry.version for entry in before.entries}
    fresh = {entry.version for entry in after.entries} - old
    assert {one.version for one in house.ear.of(MODEL, RegionModel)[reported:]} == fresh
    assert 0 < len(fresh) < len(after.entries)
