"""`eigenscan run`: one's own map and robot in one command."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from uuid import uuid4

import psutil
from eigenscan.cli.launch.network import open_hub
from eigenscan.cli.launch.witness import Witness
from eigenscan.cli.simulation.live import publish
from eigenscan.cli.simulation.stage import Scenario, Stage
from eigenscan.cli.simulation.world import office
from eigenscan.geometry.gridmap import write_map
from eigenscan.runtime.bus import Bus
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate

EIGENSCAN = [sys.executable, "-m", "eigenscan.cli.main"]


def test_a_robot_of_ones_own_gets_its_pose_and_ctrl_c_ends_all(tmp_path: Path) -> None:
    grid = office().render()
    write_map(grid, tmp_path / "map.yaml")
    site = f"test-{uuid4().hex}"
    stage = Stage(grid, Scenario(seconds=6.0, people=0, site=site, robot="r17"))
    session, zenoh = open_hub(tmp_path / "net")
    command = [*EIGENSCAN, "run", "--map", str(tmp_path / "map.yaml"), "--robot", "r17", "--site", site,
               "--zenoh", str(zenoh), "--no-viewer", "--out", str(tmp_path / "out")]  # fmt: skip
    with Bus(session) as bus, subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        witness = Witness(bus, site)
        deadline = time.monotonic() + 90.0
        while witness.missing(["scan-ingest", "projector", "tracker", "mapbuilder", "recorder"]):
            assert time.monotonic() < deadline
            assert process.poll() is None
            witness.listen()
            time.sleep(0.05)
        stage.epoch = time.time_ns()
        publish(stage.messages(), bus.say)
        poses: list[PoseEstimate] = []
        while time.monotonic() < deadline and not any(pose.state == STATE_LOCALIZED for pose in poses):
            poses += witness.listen()
            time.sleep(0.05)
        children = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=30)
    assert any(pose.state == STATE_LOCALIZED for pose in poses)
    assert process.returncode == 0
    assert "ready" in output
    assert not [child for child in children if child.is_running() and child.status() != "zombie"]
    assert list((tmp_path / "out/mcap").glob("*.mcap"))


def test_settings_that_a_service_refuses_are_told_in_its_words(tmp_path: Path) -> None:
    (tmp_path / "model").mkdir()
    zenoh = _lonely_network(tmp_path)
    command = [*EIGENSCAN, "run", "--map", str(tmp_path / "model"), "--site", f"test-{uuid4().hex}",
               "--zenoh", str(zenoh), "--no-viewer", "--out", str(tmp_path / "out")]  # fmt: skip
    result = subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)
    assert result.returncode == 1
    assert "mapbuilder ended with exit code" in result.stderr
    assert "Traceback" not in result.stderr


def _lonely_network(folder: Path) -> Path:
    path = folder / "zenoh.json5"
    config = {"mode": "peer", "listen": {"endpoints": ["tcp/127.0.0.1:0"]},
              "scouting": {"multicast": {"enabled": False}}}  # fmt: skip
    path.write_text(json.dumps(config))
    return path
