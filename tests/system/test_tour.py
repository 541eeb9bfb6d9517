"""A short tour: processes over Zenoh show right poses, and the recording replays to the same bits."""

import csv
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from eigenscan.cli.main import app
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import POSE, SCAN_RAW
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from typer.testing import CliRunner

from tests.environment import PROGRAMS
from tests.system.house import AWAITS_REQUESTS, PATIENT, Drive, House, reference

SERVICES = ("scan-ingest", "projector", "tracker")
SHORT_S = 8
SPEED = 2
RIGHT_M = 0.5

Truth = Callable[[np.ndarray], np.ndarray]
"""Positions (n, 2) at stamps (n,), ns."""


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Drive, Truth]:
    """A simulated robot's drive through the demo's building."""
    folder = tmp_path_factory.mktemp("simulated")
    files = ("-o", "drive.mcap", "--truth", "drive.tum", "--save-map", "map.yaml")
    subprocess.run(
        [PROGRAMS / "eigenscan", "simulate", "--seconds", str(SHORT_S), *files], cwd=folder, check=True
    )
    with (folder / "drive.tum").open() as file:
        rows = np.array([row[:3] for row in csv.reader(file, delimiter=" ")], dtype=float)

    def truth(stamps: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(stamps * 1e-9, rows[:, 0], rows[:, i]) for i in (1, 2)])

    envelopes = [record.envelope for record in read(folder / "drive.mcap")]
    return Drive(folder / "drive.mcap", folder / "map.yaml", envelopes), truth


def test_a_simulated_robot(simulated: tuple[Drive, Truth], house: House, tmp_path: Path) -> None:
    drive, truth = simulated
    tour(drive, truth, ("--map", drive.map, "--step", 1), house, tmp_path)


@pytest.mark.dataset
def test_a_real_log(drive: Drive, models: Path, house: House, tmp_path: Path) -> None:
    tour(drive, reference, ("--model", models), house, tmp_path)


def tour(drive: Drive, truth: Truth, site: tuple[object, ...], house: House, folder: Path) -> None:
    recording = folder / "site.mcap"
    house.start("recorder", "--mcap", recording)
    house.start("mapbuilder", *site)
    house.start("projector", "--published", 20, *PATIENT, *AWAITS_REQUESTS)
    # nor may odometry count as missing where it is only late
    house.start("tracker", "--trust", 0.9, "--patience", 5)
    house.start("scan-ingest", *PATIENT)
    house.until("projector", lambda health: health.status == Health.STATUS_OK, "has models")
    house.replay(drive.recording, "--to", SHORT_S, "--speed", SPEED)
    end = drive.envelopes[0].stamp + SHORT_S * 10**9
    scans = sum(envelope.channel is SCAN_RAW and envelope.stamp <= end for envelope in drive.envelopes)
    house.until("tracker", lambda health: health.counters["heard_hypotheses"] >= scans, "hears them all")
    for service in (*SERVICES, "mapbuilder", "recorder"):
        assert house.terminate(service) == 0

    poses = house.ear.of(POSE, PoseEstimate)
    claims = [pose for pose in poses if pose.state == STATE_LOCALIZED]
    assert len(poses) > 0.9 * scans
    assert len(claims) > 0.4 * scans
    true = truth(np.array([nanoseconds(claim.timestamp) for claim in claims]))
    away = np.hypot(*(np.array([[claim.pose.x, claim.pose.y] for claim in claims]) - true).T)
    assert away.max() < RIGHT_M

    for service in (*SERVICES, "pipeline"):
        ended = CliRunner().invoke(app, ["replay", str(recording), "--service", service, "--compare"])
        assert ended.exit_code == 0, ended.output
        assert "settings as recorded" in ended.output
        assert "default settings" not in ended.output
    # that the settings came from the recording is what made it the same
    ended = CliRunner().invoke(
        app, ["replay", str(recording), "--service", "tracker", "--compare", "--set", "trust=0.3"]
    )
    assert ended.exit_code == 1, ended.output
    assert "first difference: " in ended.output
