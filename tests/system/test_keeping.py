"""A cupboard moves, and robots drive by: processes, a killed mapbuilder, an operator who accepts."""

import subprocess
import threading
import time
from pathlib import Path

import pytest
from eigenscan.eigenspace.folder import read_models, write_models
from eigenscan.eigenspace.versions import kept_in
from eigenscan.geometry.circle import TURN
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import HYPOTHESES, MODEL, MODEL_SET, SCAN
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.model_pb2 import ModelSet, RegionModel
from eigenscan.schemas.scan_pb2 import Scan

from tests.mapbuilder.keeping.patrol import KNOWN, MOVED, VISIT_S, Patrol
from tests.system.house import PROGRAMS, House

AT_ONCE_S = 0.01
LIVE_S, LIVE = 0.1, 200
"""s between two scans; scans and poses."""


@pytest.fixture
def model(tmp_path: Path) -> Path:
    write_models(build_site(KNOWN, Plan(step=TURN / 360)), tmp_path / "model")
    return tmp_path / "model"


def patrol(house: House, number: int) -> list[Envelope]:
    """What is said of the drive number `number`, each in a visit of its own."""
    return list(Patrol(number).messages(MOVED, number * VISIT_S, site=house.site))


def say(house: House, messages: list[Envelope], every_s: float) -> None:
    with Bus(open_session(house.config)) as bus:
        for envelope in messages:
            bus.say(envelope)
            if envelope.channel is SCAN:
                time.sleep(every_s)


def counted(house: House, more_than: int = 0) -> int:
    """Looks that the mapbuilder counted, once they are more than that and no more come."""
    seen = [-1]

    def settled(health: Health) -> bool:
        count = health.counters["looks_counted"]
        same, seen[0] = count == seen[0], count
        return count > more_than and same

    return house.until("mapbuilder", settled, "has counted looks").counters["looks_counted"]


def test_a_moved_cupboard_is_proposed_accepted_and_used_and_no_scan_is_lost(
    house: House, model: Path
) -> None:
    before = read_models(model).to_message()
    house.start("mapbuilder", "--model", model)
    say(house, patrol(house, 0), AT_ONCE_S)
    first = counted(house)
    say(house, patrol(house, 1), AT_ONCE_S)
    counted(house, first)
    # of the visit that runs only what was saved is kept; the one before must be
    house.kill("mapbuilder")
    house.start("mapbuilder", "--model", model)
    for number in range(2, 6):
        say(house, patrol(house, number), AT_ONCE_S)
    health = house.until("mapbuilder", lambda health: "proposed as" in health.detail, "proposes a version")
    assert health.status == Health.STATUS_OK
    assert f"eigenscan models accept {model}" in health.detail
    assert read_models(model).to_message() == before  # nothing is edited behind anybody's back
    (proposal,) = kept_in(model).iterdir()
    assert (proposal / "change.png").stat().st_size > 1000

    house.start("projector", "--robot", "r1")
    house.until("projector", lambda health: health.status == Health.STATUS_OK, "has models")
    told = len(house.ear.of(MODEL, RegionModel))
    drive = patrol(house, 6)[:LIVE]
    robot = threading.Thread(target=say, args=(house, drive, LIVE_S))
    robot.start()
    house.ear.wait_for(lambda _: len(house.ear.of(HYPOTHESES, Hypotheses)) > 10, "hypotheses")
    accept = [PROGRAMS / "eigenscan", "models", "accept", model]
    assert subprocess.run(accept, check=False, capture_output=True).returncode == 0
    robot.join()
    after = read_models(model).to_message()

    scans = [nanoseconds(one.open(Scan).timestamp) for one in drive if one.channel is SCAN]
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
    assert {one.version for one in house.ear.of(MODEL, RegionModel)[told:]} == fresh
    assert 0 < len(fresh) < len(after.entries)
