"""All services in one process publish what they publish in processes of their own, byte for byte."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import (
    HYPOTHESES,
    OBSTACLES,
    POSE,
    SCAN,
    SCAN_MOTION,
    SCAN_RAW,
    TRACKS,
    Channel,
)
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.wire import encode

from tests import environment
from tests.system.house import AWAITS_REQUESTS, ONE_THREAD, PATIENCE_S, PATIENT, Drive, House

pytestmark = pytest.mark.slow

COMPARED = (SCAN, SCAN_MOTION, HYPOTHESES, OBSTACLES, POSE, TRACKS)
QUICK = ("scan-ingest", "projector", "tracker")


def output(recording: Path) -> dict[Channel, list[bytes]]:
    """What the services published, in order."""
    found: dict[Channel, list[bytes]] = {channel: [] for channel in COMPARED}
    for record in read(recording):
        if record.envelope.channel in found:
            found[record.envelope.channel].append(encode(record.envelope.message))
    return found


def play(house: House, drive: Drive) -> None:
    """The drive, until the last of it is answered."""
    scans = sum(envelope.channel is SCAN_RAW for envelope in drive.envelopes)
    house.until("projector", lambda health: health.status == Health.STATUS_OK, "has models")
    house.replay(drive.recording, "--speed", 2)
    house.until(
        "tracker", lambda health: health.counters["heard_hypotheses"] == scans, "hears all hypotheses"
    )
    for service in QUICK:
        assert not house.missed(service), service


@pytest.mark.dataset
def test_together_and_separate_publish_the_same_bytes(
    drive: Drive, models: Path, house: House, tmp_path: Path
) -> None:
    one, many = tmp_path / "one.mcap", tmp_path / "many.mcap"
    common = ["--site", house.site, "--zenoh", house.config, *PATIENT]
    words = [
        *("scan-ingest,tracker", *common), "--", *("projector", *common, *AWAITS_REQUESTS),
        "--", *("mapbuilder", *common, "--model", models),
        "--", *("recorder", *common, "--robot", "*", "--mcap", one),
    ]  # fmt: skip
    with (tmp_path / "together.log").open("wb") as log:
        house.running["together"] = subprocess.Popen(
            [sys.executable, "-m", "eigenscan.cli.launch.together", *map(str, words)],
            stdout=log, stderr=log, env=environment.clean() | ONE_THREAD,
        )  # fmt: skip
    play(house, drive)
    house.running["together"].send_signal(signal.SIGTERM)
    assert house.running.pop("together").wait(PATIENCE_S) == 0, (tmp_path / "together.log").read_text()
    house.ear.received.clear()

    house.start("recorder", "--mcap", many, "--robot", "*")
    house.start("mapbuilder", "--model", models)
    for service in QUICK:
        house.start(service, *PATIENT, *(AWAITS_REQUESTS if service == "projector" else ()))
    play(house, drive)
    for service in (*QUICK, "mapbuilder", "recorder"):
        assert house.terminate(service) == 0

    together, separate = output(one), output(many)
    assert len(separate[POSE]) > 100
    for channel in COMPARED:
        assert together[channel] == separate[channel], channel.name
