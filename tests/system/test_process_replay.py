"""What processes said over Zenoh is what their cores say again from the recording."""

from pathlib import Path

import pytest
from eigenscan.cli.main import app
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.health_pb2 import Health
from typer.testing import CliRunner

from tests.system.house import Drive, House

SERVICES = ("scan-ingest", "projector", "tracker")
SHORT_S = 12


@pytest.mark.dataset
def test_a_recorded_site_replays_to_the_same_bits(
    drive: Drive, models: Path, house: House, tmp_path: Path
) -> None:
    recording = tmp_path / "site.mcap"
    house.start("recorder", "--mcap", recording)
    house.start("mapbuilder", "--model", models)
    patient = ("--behind-after", "inf")  # a busy machine must not lose what the test counts
    house.start("projector", "--published", 20, *patient)
    # nor may odometry count as missing where it is only late
    house.start("tracker", "--trust", 0.4, "--patience", 5)
    house.start("scan-ingest", *patient)
    house.until("projector", lambda health: health.status == Health.STATUS_OK, "has models")
    house.replay(drive.recording, "--to", SHORT_S)
    end = drive.envelopes[0].stamp + SHORT_S * 10**9
    scans = sum(envelope.channel is SCAN_RAW and envelope.stamp <= end for envelope in drive.envelopes)
    house.until("tracker", lambda health: health.counters["heard_hypotheses"] >= scans, "hears them all")
    for service in (*SERVICES, "mapbuilder", "recorder"):
        assert house.terminate(service) == 0

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
