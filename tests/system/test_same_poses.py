"""The pipeline as processes over Zenoh, and `evaluate` in one process: the same poses, bit for bit."""

import csv
import subprocess
from pathlib import Path

import pytest
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import POSE, SCAN_RAW
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.workbench.evaluation.reference import nanoseconds_of

from tests.environment import PROGRAMS
from tests.system.house import AWAITS_REQUESTS, INTEL, PATIENT, SPACING, Drive, House

pytestmark = pytest.mark.slow

Published = dict[int, tuple[float, float, float, int]]


def evaluated(drive: Drive, folder: Path) -> Published:
    """What `eigenscan evaluate` states for one window over the whole recording."""
    windows, poses = folder / "windows.csv", folder / "poses.csv"
    first, last = (drive.envelopes[i].stamp for i in (0, -1))
    windows.write_text(f"start_time,end_time\n{first / 1e9:.9f},{(last + 1000) / 1e9:.9f}\n")
    subprocess.run(
        [
            *(PROGRAMS / "eigenscan", "evaluate", "--log", drive.recording, "--map", drive.map),
            *("--ground-truth", INTEL / "log.tum", "--windows", windows, "--save-poses", poses),
            *("--skip", "single-scans", "--skip", "memory", "--spacing", str(SPACING)),
        ],
        check=True,
    )
    with poses.open() as file:
        rows = list(csv.DictReader(file))
    return {
        nanoseconds_of(row["stamp"]): (
            *(float(row["x"]), float(row["y"]), float(row["heading"])),
            int(row["state"]),
        )
        for row in rows
    }


def published(estimates: list[PoseEstimate]) -> Published:
    return {nanoseconds(e.timestamp): (e.pose.x, e.pose.y, e.pose.theta, e.state) for e in estimates}


@pytest.mark.dataset
def test_processes_and_one_process_agree_pose_for_pose(drive: Drive, house: House, tmp_path: Path) -> None:
    expected = evaluated(drive, tmp_path)
    scans = sum(envelope.channel is SCAN_RAW for envelope in drive.envelopes)
    assert len(expected) > 0.9 * scans

    recording = tmp_path / "site.mcap"
    house.start("recorder", "--mcap", recording)
    house.start("mapbuilder", "--map", drive.map, "--spacing", SPACING)
    house.start("projector", *PATIENT, *AWAITS_REQUESTS)
    for service in ("tracker", "scan-ingest"):
        house.start(service, *PATIENT)
    house.until("projector", lambda health: health.status == Health.STATUS_OK, "has models")
    house.replay(drive.recording, "--speed", 2)
    house.until("scan-ingest", lambda health: health.counters["heard_scan_raw"] == scans, "hears all scans")
    house.until(
        "tracker", lambda health: health.counters["heard_hypotheses"] == scans, "hears all hypotheses"
    )
    for service in ("scan-ingest", "projector", "tracker"):
        assert not house.missed(service), service
    # the tracker publishes what it held back when it is asked to stop
    for service in ("scan-ingest", "projector", "tracker", "mapbuilder", "recorder"):
        assert house.terminate(service) == 0

    received = published(
        [r.envelope.open(PoseEstimate) for r in read(recording) if r.envelope.channel is POSE]
    )
    assert received.keys() == expected.keys()
    different = {
        stamp: (received[stamp], expected[stamp]) for stamp in expected if received[stamp] != expected[stamp]
    }
    assert not different
    assert published(house.ear.of(POSE, PoseEstimate)) == received
