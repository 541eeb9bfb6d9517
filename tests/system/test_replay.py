"""`eigenscan replay`: what was recorded is published again, unchanged and in order."""

import subprocess
from pathlib import Path

import pytest
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.wire import encode

from tests.environment import PROGRAMS
from tests.system.house import Drive, House

pytestmark = pytest.mark.slow


@pytest.mark.dataset
def test_a_stretch_of_a_recording_is_published_as_it_was(drive: Drive, house: House) -> None:
    start = drive.envelopes[0].stamp
    wanted = [e for e in drive.envelopes if 2.0 <= (e.stamp - start) * 1e-9 <= 8.0]
    assert len(wanted) > 20
    house.replay(drive.recording, "--from", 2, "--to", 8, "--speed", 20)
    house.ear.wait_for(lambda received: len(received) >= len(wanted), "all that was recorded")
    for channel in (SCAN_RAW, ODOMETRY):
        received = [encode(e.message) for e in house.ear.received if e.channel is channel]
        assert received == [encode(e.message) for e in wanted if e.channel is channel]
    assert {e.address["site"] for e in house.ear.received} == {house.site}


@pytest.mark.dataset
def test_only_the_channels_asked_for_are_published(drive: Drive, house: House) -> None:
    house.replay(drive.recording, "--to", 3, "--speed", 20, "--only", "odometry", "--robot", "r9")
    house.ear.wait_for(lambda received: len(received) >= 10, "odometry")
    assert {(e.channel.name, e.address["robot"]) for e in house.ear.received} == {("odometry", "r9")}


@pytest.mark.dataset
@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["--only", "nothing"], "--only nothing: choose one of scan_raw"),
        (["--from", "5", "--to", "4"], "--to 4: must be after --from 5"),
        (["--from", "5000"], "nothing between --from and --to"),
    ],
)
def test_what_cannot_be_played_is_one_line_and_exit_code_2(
    drive: Drive, flags: list[str], named: str
) -> None:
    command = [str(PROGRAMS / "eigenscan"), "play", str(drive.recording), *flags]
    out = subprocess.run(command, capture_output=True, text=True, check=False)
    assert out.returncode == 2
    assert out.stderr.startswith("eigenscan play: ")
    assert named in out.stderr
    assert len(out.stderr.splitlines()) == 1


def test_a_file_that_is_no_recording_is_named(tmp_path: Path) -> None:
    file = tmp_path / "drive.mcap"
    file.write_bytes(b"not an mcap")
    command = [str(PROGRAMS / "eigenscan"), "replay", str(file)]
    out = subprocess.run(command, capture_output=True, text=True, check=False)
    assert out.returncode == 2
    assert "drive.mcap" in out.stderr
