"""A stranger's driver, by docs/contract.md alone, gets its robot's pose from `eigenscan run`.

Zenoh's binding and protobuf's runtime are all that it has: no package of ours, messages by protoc, the code
as it stands on the page. A program in Rust does the same from the same page (`pytest -m rust`); its build
takes minutes and a registry of crates, which a bare machine of the tests has not.
"""

from __future__ import annotations

import json
import math
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO
from uuid import uuid4

import google.protobuf
import grpc_tools
import numpy as np
import pytest
import zenoh
from eigenscan.cli.launch.network import open_hub
from eigenscan.geometry.gridmap import write_map
from eigenscan.geometry.pose import Array, from_pose3
from eigenscan.runtime.session import MEETING
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from grpc_tools import protoc

from tests import environment
from tests.environment import ROOT

pytestmark = pytest.mark.slow

PAGE, PROTO, RUST = ROOT / "docs/contract.md", ROOT / "schemas/proto", ROOT / "examples/driver-rust"
ROBOT, SECONDS = "r17", 60.0
PATIENCE_S = 240.0
MY_ROBOT = """
import json, time

measured = [json.loads(line) for line in open("drive.jsonl")]
LIDAR = measured.pop(0)

def measurements():
    begin = time.time_ns()
    for kind, after_ns, value in measured:
        time.sleep(max(begin + after_ns - time.time_ns(), 0) * 1e-9)
        yield kind, begin + after_ns, value
"""


class Site:
    """`eigenscan run` with the office's map, and a simulated drive through it as a file of measurements."""

    def __init__(self, folder: Path) -> None:
        self.name, self.folder = f"test-{uuid4().hex[:8]}", folder
        self.session, config = open_hub(folder / "net")
        (self.endpoint,) = json.loads(config.read_text())["connect"]["endpoints"]
        grid = office().render()
        write_map(grid, folder / "map.yaml")
        self._stage = Stage(grid, Scenario(seconds=SECONDS, people=0, site=self.name, robot=ROBOT))
        flags = ["--map", folder / "map.yaml", "--robot", ROBOT, "--site", self.name, "--zenoh", config]
        command = [
            sys.executable,
            "-m",
            "eigenscan.cli.main",
            "run",
            *flags,
            "--no-viewer",
            "-o",
            folder / "run",
        ]
        self.process = subprocess.Popen(list(map(str, command)), stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        assert any(line.startswith("ready") for line in self.process.stdout)

    def write_drive(self, path: Path) -> None:
        """A line for the lidar, then one for each measurement: kind, ns since the start, value."""
        lines: list[object] = []
        timeline = list(self._stage.messages())
        for timed in timeline:
            after = timed.time - timeline[0].time
            if timed.envelope.channel is SCAN_RAW:
                raw = timed.envelope.open(RawScan)
                names = ("angle_min", "angle_increment", "range_min", "range_max")
                lidar = {name: getattr(raw, name) for name in names}
                lidar["mount"] = {axis: getattr(raw.mount, axis) for axis in ("x", "y", "theta")}
                assert not raw.upside_down
                lines.append(["scan", after, list(raw.ranges)])
            elif timed.envelope.channel is ODOMETRY:
                lines.append(["odometry", after, from_pose3(timed.envelope.open(Odometry).pose).tolist()])
        path.write_text("\n".join(json.dumps(line) for line in [lidar, *lines]))

    def truth(self, after_s: float) -> Array:
        """Where the robot is so long after the start."""
        return self._stage.pose_at(next(iter(self._stage.messages())).time + int(after_s * 1e9))

    def close(self) -> None:
        self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=PATIENCE_S)
        self.session.close()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    site = Site(tmp_path_factory.mktemp("stranger"))
    yield site
    site.close()


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """A folder with what a stranger has installed, and what protoc made of the .proto files."""
    folder = tmp_path / "bare"
    (folder / "google").mkdir(parents=True)
    for package in (Path(zenoh.__file__).parent, Path(google.protobuf.__file__).parent):
        within = folder / "google" if package.name == "protobuf" else folder
        (within / package.name).symlink_to(package)
    upb = Path(google.protobuf.__file__).parents[1] / "_upb"
    if upb.exists():
        (folder / "google/_upb").symlink_to(upb)
    names = sorted(str(path.relative_to(PROTO)) for path in PROTO.rglob("*.proto"))
    google_files = Path(grpc_tools.__file__).with_name("_proto")  # which protoc as a program finds by itself
    assert protoc.main(["protoc", f"-I{PROTO}", f"-I{google_files}", f"--python_out={folder}", *names]) == 0
    return folder


def await_right_pose(published: IO[str], truth: Callable[[float], Array]) -> None:
    """Reads lines of state, pose and confidence until the stranger is localized, and right."""
    began, deadline = 0.0, time.monotonic() + PATIENCE_S
    for line in published:
        assert time.monotonic() < deadline, "no claimed pose"
        began = began or time.monotonic()
        state, x, y, _, confidence = line.split()
        if state == "STATE_LOCALIZED":
            assert float(confidence) > 0.85
            # where it was is known to the second, from when the first pose came
            near = np.linspace(-3.0, 3.0, 61) + time.monotonic() - began
            ways = [truth(max(float(after), 0.0))[:2] for after in near]
            assert min(math.dist(way, (float(x), float(y))) for way in ways) < 0.5
            return
    pytest.fail("it ended without a claimed pose")


def test_the_pages_example_finds_the_robot(site: Site, bare: Path, tmp_path: Path) -> None:
    (code,) = re.findall(
        r'```python title="with a robot"\n(.*?)```', PAGE.read_text(encoding="utf-8"), re.DOTALL
    )
    for reported, here in ((MEETING, site.endpoint), ('"site", "robot"', f'"{site.name}", "{ROBOT}"')):
        assert code.count(reported) == 1
        code = code.replace(reported, here)
    (tmp_path / "driver.py").write_text(code)
    (tmp_path / "my_robot.py").write_text(MY_ROBOT)
    site.write_drive(tmp_path / "drive.jsonl")
    begin = f"import sys; sys.path[:0] = [{str(bare)!r}, '.']\n"
    python = Path(sys.base_prefix) / f"bin/python3.{sys.version_info.minor}"
    alone = subprocess.run(
        [python, "-I", "-S", "-c", begin + "import eigenscan.runtime"], capture_output=True, check=False
    )
    assert b"No module named 'eigenscan.runtime'" in alone.stderr
    with subprocess.Popen(
        [python, "-I", "-S", "-c", begin + "import runpy; runpy.run_path('driver.py')"],
        cwd=tmp_path, stdout=subprocess.PIPE, text=True, env=environment.clean(),
    ) as stranger:  # fmt: skip
        try:
            assert stranger.stdout
            await_right_pose(stranger.stdout, site.truth)
        finally:
            stranger.kill()


@pytest.mark.rust
@pytest.mark.timeout(1800)
def test_a_driver_in_rust_finds_the_robot(site: Site, tmp_path: Path) -> None:
    target = ROOT / "out/rust"
    subprocess.run(["cargo", "build", "--release", "--target-dir", target], cwd=RUST, check=True)
    site.write_drive(tmp_path / "drive.jsonl")
    reported, *measured = [json.loads(line) for line in (tmp_path / "drive.jsonl").read_text().splitlines()]
    names = ("angle_min", "angle_increment", "range_min", "range_max")
    lidar = [*(reported[name] for name in names), *reported["mount"].values()]
    with subprocess.Popen(
        [target / "release/eigenscan-driver-rust", site.name, ROBOT, site.endpoint],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as driver:  # fmt: skip
        assert driver.stdin
        assert driver.stdout

        def feed(published: IO[str]) -> None:
            begin = time.time_ns()
            with suppress(BrokenPipeError), published:
                print("lidar", *lidar, file=published, flush=True)
                for kind, after, value in measured:
                    time.sleep(max(begin + after - time.time_ns(), 0) * 1e-9)
                    print(kind, begin + after, *value, file=published, flush=True)

        feeding = threading.Thread(target=feed, args=(driver.stdin,))
        feeding.start()
        try:
            await_right_pose(driver.stdout, site.truth)
        finally:
            driver.kill()
            feeding.join()
