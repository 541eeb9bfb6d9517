"""`eigenscan run`: one's own map and robot in one command."""

import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from uuid import uuid4

import psutil
import pytest
from eigenscan.cli.launch.attend import _refuse_other_map, pose_text
from eigenscan.cli.launch.network import open_hub
from eigenscan.cli.launch.services import Pipeline, lacking
from eigenscan.fleet.view import FleetView
from eigenscan.geometry.gridmap import write_map
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.errors import UsageError
from eigenscan.schemas.channels import POSE
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.workbench.simulation.live import publish
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office

pytestmark = pytest.mark.slow

EIGENSCAN = [sys.executable, "-m", "eigenscan.cli.main"]


@pytest.mark.parametrize("way", [[], ["--together"]], ids=["separate", "together"])
def test_a_robot_of_ones_own_gets_its_pose_and_ctrl_c_ends_all(way: list[str], tmp_path: Path) -> None:
    grid = office().render()
    write_map(grid, tmp_path / "map.yaml")
    site = f"test-{uuid4().hex}"
    stage = Stage(grid, Scenario(seconds=6.0, people=0, site=site, robot="r17"))
    session, zenoh = open_hub(tmp_path / "net")
    (tmp_path / "site.toml").write_text('instance = "site"')  # of the site's server
    command = [*EIGENSCAN, "run", "--map", str(tmp_path / "map.yaml"), "--robot", "r17", "--site", site,
               "--settings", str(tmp_path / "site.toml"),
               "--zenoh", str(zenoh), "--no-viewer", "--out", str(tmp_path / "out"), *way]  # fmt: skip
    launch = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    with FleetView(session, site) as view, launch as process:
        deadline = time.monotonic() + 480.0
        while lacking(view, ["scan-ingest", "projector", "tracker", "mapbuilder", "recorder"]):
            assert time.monotonic() < deadline
            assert process.poll() is None
            view.update()
            time.sleep(0.05)
        other = PoseEstimate(state=STATE_LOCALIZED, confidence=1.0, pose=Pose2(x=1234.0))
        view.publish(Envelope(POSE, {"site": site, "robot": "r18"}, other))
        stage.epoch = time.time_ns()
        publish(stage.messages(), view.publish)
        poses: list[PoseEstimate] = []
        while time.monotonic() < deadline and not any(pose.state == STATE_LOCALIZED for pose in poses):
            poses += view.update("r17")
            time.sleep(0.05)
        children = psutil.Process(process.pid).children(recursive=True)
        assert len(children) == (1 if way else 5)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=240)
    assert any(pose.state == STATE_LOCALIZED for pose in poses)
    assert process.returncode == 0
    assert "ready" in output
    assert "1234" not in output  # the pose of another robot on the site
    assert not [child for child in children if child.is_running() and child.status() != "zombie"]
    assert list((tmp_path / "out/mcap").glob("*.mcap"))


@pytest.mark.parametrize("way", [[], ["--together"]], ids=["separate", "together"])
def test_nothing_that_it_starts_is_reached_from_another_machine(way: list[str], tmp_path: Path) -> None:
    """Once there were six listeners on all interfaces, and multicast."""
    write_map(office().render(), tmp_path / "map.yaml")
    flags = ["--site", f"test-{uuid4().hex}", "--out", str(tmp_path / "out"), "--json", "-", *way]
    command = [*EIGENSCAN, "run", str(tmp_path / "map.yaml"), *flags]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            line = next(each for each in process.stdout if '"ready"' in each)
            tree = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
            sockets = [one for member in tree for one in member.net_connections("inet")]
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=240)
    assert line
    # a connection has an address at its other end; all else takes what comes from anywhere
    open_to = {one.laddr.ip for one in sockets if not one.raddr}
    assert open_to
    assert open_to <= {"127.0.0.1", "::1"}


def test_an_open_endpoint_must_be_asked_for_in_words(tmp_path: Path) -> None:
    write_map(office().render(), tmp_path / "map.yaml")
    _expect_one_line(
        tmp_path, ["--map", str(tmp_path / "map.yaml"), "--listen", "tcp/0.0.0.0:7447"], "--insecure"
    )


@pytest.mark.parametrize(
    ("flags", "part"),
    [
        (["--insecure"], "--listen"),
        (["--ros2-router", "tcp/10.0.0.9:7447"], "--ros2"),
        (["--set", "tracker.instance=a"], "tracker.instance: is the same for all services: give --robot"),
        (["--set", "projector.site=a"], "projector.site: is the same for all services: give --site"),
    ],
)
def test_what_would_have_no_effect_or_part_the_services_is_refused(
    tmp_path: Path, flags: list[str], part: str
) -> None:
    write_map(office().render(), tmp_path / "map.yaml")
    _expect_one_line(tmp_path, ["--map", str(tmp_path / "map.yaml"), *flags], part)


def test_a_name_that_is_no_part_of_a_key_starts_nothing(tmp_path: Path) -> None:
    write_map(office().render(), tmp_path / "map.yaml")
    _expect_one_line(tmp_path, ["--map", str(tmp_path / "map.yaml"), "--robot", "r 17"], "--robot 'r 17'")


@pytest.mark.parametrize(
    ("running", "published", "refused"),
    [
        ([("mapbuilder", "r17"), ("tracker", "r17")], "other", True),
        ([("mapbuilder", "r17")], "own", False),
        ([("mapbuilder", "r17")], "", False),  # it builds its first models
        ([("tracker", "r17")], "other", False),  # from a mapbuilder that is gone
        ([], "", False),
    ],
)
def test_a_site_has_one_map(running: list[tuple[str, str]], published: str, refused: bool) -> None:
    """A second `run` with another map once replaced that of a robot, which stayed localized."""
    grid = office().render()
    own = build_site(grid, Plan()).to_message().map_version
    assert own == grid.version
    view: Any = SimpleNamespace(map_version=own if published == "own" else published)
    view.until = lambda holds, _seconds: holds()
    pipeline = Pipeline("s", "r18", [], None, Path(), None, viewer=False, map_version=grid.version)
    words = r"--site s: its mapbuilder 'r17' publishes another map: give that one, or choose another --site"
    with pytest.raises(UsageError, match=words) if refused else nullcontext():
        _refuse_other_map(running, view, pipeline)


def test_an_old_pose_is_not_reported_as_where_the_robot_is() -> None:
    pose = PoseEstimate(state=STATE_LOCALIZED, confidence=1.0)
    assert "localized  confidence 1.00" in pose_text(pose, 0.1, [])
    assert pose_text(pose, 60.0, []).startswith("no pose for 60 s")


def test_a_second_run_of_one_robot_is_refused_at_once(tmp_path: Path) -> None:
    write_map(office().render(), tmp_path / "map.yaml")
    session, zenoh = open_hub(tmp_path / "net")
    with Bus(session) as bus:
        bus.announce("depot", "tracker", "r17")
        flags = ["--map", str(tmp_path / "map.yaml"), "--site", "depot", "--zenoh", str(zenoh)]
        _expect_one_line(tmp_path, [*flags, "--robot", "r17"], "tracker already run")


def test_a_folder_that_is_no_model(tmp_path: Path) -> None:
    (tmp_path / "model").mkdir()
    _expect_one_line(tmp_path, ["--map", str(tmp_path / "model")], str(tmp_path / "model"))


def test_a_site_that_is_no_chunk_of_a_key(tmp_path: Path) -> None:
    write_map(office().render(), tmp_path / "map.yaml")
    _, zenoh = open_hub(tmp_path / "net")
    _expect_one_line(
        tmp_path, ["--map", str(tmp_path / "map.yaml"), "--zenoh", str(zenoh), "--site", "a/b"], "a/b"
    )


def _expect_one_line(folder: Path, flags: list[str], part: str) -> None:
    command = [*EIGENSCAN, "run", *flags, "--no-viewer", "--out", str(folder / "out")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert result.returncode == 2, result.stderr
    assert result.stderr.count("\n") == 1, result.stderr
    assert part in result.stderr
    assert not (folder / "out").exists()
