"""A robot's clock steps while it drives, as NTP sets it at last: its services from scan to pose, as cores."""

import subprocess
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from eigenscan.eigenspace.folder import read_models
from eigenscan.geometry.gridmap import to_message, write_map
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.core import announce_models
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.schemas.channels import MAP, ODOMETRY, POSE, SCAN_RAW
from eigenscan.schemas.envelope import Core, Envelope, nanoseconds, stamp
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office

pytestmark = pytest.mark.slow

PROGRAM = Path(sys.executable).with_name("eigenscan")
SITE, STEP_AT_S, SECONDS, RIGHT_M = "site", 6.0, 12.0, 0.5
BACK_WITHIN_S = 3.0
"""Ten scans until scan-ingest believes the new time, five until the tracker does, some to find itself."""


@pytest.fixture(scope="module")
def stage() -> Stage:
    return Stage(office().render(), Scenario(seconds=SECONDS, seed=3, people=2, site=SITE))


@pytest.fixture(scope="module")
def models(stage: Stage, tmp_path_factory: pytest.TempPathFactory) -> list[Envelope]:
    folder = tmp_path_factory.mktemp("clock")
    write_map(stage.grid, folder / "map.yaml")
    command = [str(PROGRAM), "build", str(folder / "map.yaml"), "-o", str(folder / "model")]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    site = read_models(folder / "model")
    return [
        Envelope(MAP, {"site": SITE}, to_message(site.grid, site.frame_id)),
        *announce_models(site, SITE),
    ]


@dataclass
class Claim:
    """When it was made, s of the drive, and how far off, m."""

    at: float
    error: float


def drive(stage: Stage, models: list[Envelope], step_s: float) -> tuple[list[Claim], dict[str, int]]:
    """Claims, and what the services counted, of a drive in whose midst the clock steps."""
    projector = ProjectorCore(ProjectorSettings())
    for model in models:
        projector.handle(model)
    cores: list[Core] = [ScanIngestCore(ScanIngestSettings()), projector, TrackerCore(TrackerSettings())]
    pipeline, claims, off, first = Loopback(cores), list[Claim](), 0, 0
    for published in stage.messages():
        envelope = published.envelope
        if envelope.channel not in (SCAN_RAW, ODOMETRY):
            continue
        first = first or published.time
        off = int(step_s * 1e9) if published.time - first >= STEP_AT_S * 1e9 else 0
        own = nanoseconds(envelope.message.timestamp)  # type: ignore[attr-defined]
        envelope.message.timestamp.CopyFrom(stamp(own + off))  # type: ignore[attr-defined]
        for one in pipeline.receive(envelope):
            if one.channel is POSE:
                pose = one.open(PoseEstimate)
                if pose.state == STATE_LOCALIZED:
                    # what waits over the step still has the old time
                    times = [nanoseconds(pose.timestamp) - each for each in (off, 0)]
                    then = min(times, key=lambda time, now=own: abs(time - now))  # type: ignore[misc]
                    x, y, _ = stage.pose_at(then)
                    error = float(np.hypot(pose.pose.x - x, pose.pose.y - y))
                    claims.append(Claim((published.time - first) * 1e-9, error))
    counters: dict[str, int] = {}
    for core in cores:
        counters |= core.condition().counters
    return claims, counters


@pytest.mark.parametrize("step_s", [-60.0, -1.0, -0.3, 0.3, 60.0])
def test_a_clock_that_steps_costs_seconds_and_no_wrong_claim(
    stage: Stage, models: list[Envelope], step_s: float
) -> None:
    claims, counters = drive(stage, models, step_s)
    assert max(claim.error for claim in claims) < RIGHT_M
    before = [claim for claim in claims if claim.at < STEP_AT_S]
    after = [claim for claim in claims if claim.at >= STEP_AT_S]
    assert len(before) > 30
    assert after[0].at < STEP_AT_S + BACK_WITHIN_S
    assert max(b.at - a.at for a, b in pairwise(after)) < 0.5  # and stays so
    if step_s <= -60.0:
        assert counters["clock_steps"] == counters["clock_set_back"] == counters["odometry_restarted"] == 1
    elif step_s < 0.0:  # passed before it is believed
        assert counters["set_aside_out_of_order"] > 0
    elif step_s >= 60.0:
        assert counters["stamp_gaps"] == 1
