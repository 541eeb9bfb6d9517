"""Projectors that share a site's regions or its robots, with nothing but Zenoh between the services."""

from pathlib import Path

import numpy as np
import pytest
from eigenscan.schemas.channels import HEALTH, HYPOTHESES, POSE
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate

from tests.system.house import Drive, House, reference

pytestmark = pytest.mark.slow

PARTS = 2


GROUPS = ("r-001,r-002", "*-003,*4")


def ready_projectors(received: list[Envelope]) -> bool:
    ok = {
        e.address["instance"]
        for e in received
        if e.channel is HEALTH
        and e.address["service"] == "projector"
        and e.open(Health).status == Health.STATUS_OK
    }
    return len(ok) == PARTS


@pytest.mark.dataset
def test_two_half_projectors_localize_a_robot(drive: Drive, models: Path, house: House) -> None:
    house.start("mapbuilder", "--model", models)
    for k in range(1, PARTS + 1):
        house.start("projector", "--part", f"{k}/{PARTS}", alias=f"half{k}")
    house.start("tracker")
    house.start("scan-ingest")
    house.ear.wait_for(ready_projectors, "both projectors to have their models")
    house.replay(drive.recording, "--speed", 2)

    def localized(received: list[Envelope]) -> list[PoseEstimate]:
        poses = [e.open(PoseEstimate) for e in received if e.channel is POSE]
        sure = [pose for pose in poses if pose.state == STATE_LOCALIZED]
        return sure if len(sure) > 20 else []

    sure = house.ear.wait_for(localized, "a localized robot")
    stamps = np.array([nanoseconds(pose.timestamp) for pose in sure])
    away = np.hypot(*(np.array([[p.pose.x, p.pose.y] for p in sure]) - reference(stamps)).T)
    assert np.mean(away < 0.5) > 0.9

    # each answered on its own key, and only of its own regions
    published: dict[str, set[str]] = {}
    for envelope in house.ear.received:
        if envelope.channel is HYPOTHESES:
            regions = {p.region for p in envelope.open(Hypotheses).projections}
            published.setdefault(envelope.address["projector"], set()).update(regions)
    assert sorted(published) == ["robot-1of2", "robot-2of2"]
    assert not published["robot-1of2"] & published["robot-2of2"]
    assert all(published.values())


@pytest.mark.dataset
def test_each_group_of_robots_has_services_of_its_own(drive: Drive, models: Path, house: House) -> None:
    house.start("mapbuilder", "--model", models)
    for group in GROUPS:
        for service in ("projector", "tracker", "scan-ingest"):
            house.start(service, "--robot", group, alias=f"{service} {group}")
    house.ear.wait_for(ready_projectors, "both projectors to have their models")
    house.replay(drive.recording, "--robots", 4, "--stamps", "now", "--to", 6)

    def localized(received: list[Envelope]) -> bool:
        sure = {
            e.address["robot"]
            for e in received
            if e.channel is POSE and e.open(PoseEstimate).state == STATE_LOCALIZED
        }
        return sure == {f"r-00{n}" for n in (1, 2, 3, 4)}

    house.ear.wait_for(localized, "four localized robots")
    answered = {
        (e.address["robot"], e.address["projector"]) for e in house.ear.received if e.channel is HYPOTHESES
    }
    assert answered == {
        ("r-001", "r-001,r-002"),
        ("r-002", "r-001,r-002"),
        ("r-003", "+-003,+4"),
        ("r-004", "+-003,+4"),
    }
    # one tracker a robot: nobody publishes a pose twice
    poses = [
        (e.address["robot"], nanoseconds(e.open(PoseEstimate).timestamp))
        for e in house.ear.received
        if e.channel is POSE
    ]
    assert len(poses) == len(set(poses))
