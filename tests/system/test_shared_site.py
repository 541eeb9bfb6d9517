"""Projectors that share a site's regions, with nothing but Zenoh between them and the tracker."""

from pathlib import Path

import numpy as np
import pytest
from eigenscan.schemas.channels import HEALTH, HYPOTHESES, POSE
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate

from tests.system.house import Drive, House, reference

PARTS = 2


def ready_projectors(heard: list[Envelope]) -> bool:
    ok = {
        e.address["instance"]
        for e in heard
        if e.channel is HEALTH
        and e.address["service"] == "projector"
        and e.open(Health).status == Health.STATUS_OK
    }
    return len(ok) == PARTS


@pytest.mark.dataset
def test_two_half_projectors_localize_a_robot(drive: Drive, models: Path, house: House) -> None:
    house.start("mapbuilder", "--model", models)
    for k in range(1, PARTS + 1):
        house.start("projector", "--part", f"{k}/{PARTS}", "--instance", f"half{k}", alias=f"half{k}")
    house.start("tracker")
    house.start("scan-ingest")
    house.ear.wait_for(ready_projectors, "both projectors to have their models")
    house.replay(drive.recording, "--speed", 2)

    def localized(heard: list[Envelope]) -> list[PoseEstimate]:
        poses = [e.open(PoseEstimate) for e in heard if e.channel is POSE]
        sure = [pose for pose in poses if pose.state == STATE_LOCALIZED]
        return sure if len(sure) > 20 else []

    sure = house.ear.wait_for(localized, "a localized robot")
    stamps = np.array([nanoseconds(pose.timestamp) for pose in sure])
    away = np.hypot(*(np.array([[p.pose.x, p.pose.y] for p in sure]) - reference(stamps)).T)
    assert np.mean(away < 0.5) > 0.9

    # each answered on its own key, and only of its own regions
    said: dict[str, set[str]] = {}
    for envelope in house.ear.heard:
        if envelope.channel is HYPOTHESES:
            regions = {p.region for p in envelope.open(Hypotheses).projections}
            said.setdefault(envelope.address["projector"], set()).update(regions)
    assert sorted(said) == [f"half{k}" for k in range(1, PARTS + 1)]
    assert not said["half1"] & said["half2"]
    assert all(said.values())
