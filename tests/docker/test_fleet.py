"""Two robots and a site by deploy/fleet.yml, on a Docker network: a container each stands for a machine."""

import json
import os
import shutil
import time
import uuid
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
import zenoh
from eigenscan.fleet.configuration import INSTALLED, PORT
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import CHANNELS, POSE, SCAN, find
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate

from tests.docker.conftest import BASE, MARKS, compose, docker, until
from tests.environment import ROOT
from tests.fleet.conftest import run
from tests.network import free_port

SITE, ROBOTS = "hospital", ("r17", "r18")
SERVICES = {
    "site": ("site-router", "mapbuilder", "recorder"),
    "robot": ("robot-router", "scan-ingest", "projector", "tracker", "robot-recorder"),
}
USER = 10001
PATIENCE_S = 600.0
"""What a step may take on a machine that is busy."""
QUIET_S = 3.0

pytestmark = MARKS


@dataclass
class Fleet:
    """Machines that are containers, and the services on each of them."""

    name: str
    images: str
    folder: Path
    port: int
    """Of the site's router, on this machine: for an operator."""

    def part(self, machine: str) -> Path:
        return self.folder / ("site" if machine == "site" else f"robots/{machine}")

    def kind(self, machine: str) -> str:
        return "site" if machine == "site" else "robot"

    def machine(self, name: str) -> str:
        return f"{self.name}-{name}"

    def begin(self, machine: str) -> None:
        ports = ["-p", f"127.0.0.1:{self.port}:{PORT}"] if machine == "site" else []
        docker(
            "run", "-d", "--init", "--name", self.machine(machine), "--network", self.name,
            "--network-alias", machine, *ports, BASE, "sleep", "infinity",
        )  # fmt: skip
        self.compose(machine, "up", "-d")

    def compose(self, machine: str, *arguments: str) -> str:
        environment = {
            "EIGENSCAN_IMAGES": self.images,
            "EIGENSCAN_FOLDER": str(self.part(machine)),
            "EIGENSCAN_NETWORK": f"container:{self.machine(machine)}",
        }
        project = ("-p", self.machine(machine), "--profile", self.kind(machine))
        return compose(*project, *arguments, environment=environment, files=("deploy/fleet.yml",))

    def container(self, machine: str, service: str) -> str:
        labels = {"project": self.machine(machine), "service": service}
        chosen = [
            w for name, value in labels.items() for w in ("-f", f"label=com.docker.compose.{name}={value}")
        ]
        return docker("ps", "-aq", *chosen).strip()

    def inspect(self, machine: str, service: str) -> dict[str, dict[str, object]]:
        (found,) = json.loads(docker("inspect", self.container(machine, service)))
        return dict(found)

    def drive(self, robot: str) -> None:
        """A simulated lidar and odometry, where a robot has its drivers."""
        docker(
            "run", "-d", "--name", f"{self.name}-{robot}-driver",
            "--network", f"container:{self.machine(robot)}",
            "--read-only", "--tmpfs", "/tmp", "--tmpfs", f"/var/cache/eigenscan:uid={USER}",
            "-v", f"{ROOT}/deploy/maps:/maps:ro", "-v", f"{self.part(robot)}/service.json5:/service.json5:ro",
            f"{self.images}/simulator", "--map=/maps/map.yaml", "--seconds=3000", "--zenoh=/service.json5",
            f"--site={SITE}", f"--robot={robot}",
        )  # fmt: skip

    def poses(self, robot: str) -> float:
        """How many the tracker of a robot has published."""
        return float(docker("exec", self.container(robot, "tracker"), "python", "-c", COUNT_POSES))

    def log(self) -> str:
        names = docker("ps", "-a", "--filter", f"name={self.name}", "--format", "{{.Names}}").split()
        return "\n".join(f"== {name}\n{docker('logs', name, check=False)}" for name in names)

    def own(self, user: int) -> None:
        """Gives the machines' parts of the folder to `user`."""
        mount = f"{self.folder}:/fleet"
        docker("run", "--rm", "-v", mount, BASE, "chown", "-R", user, "/fleet/site", "/fleet/robots")

    def end(self) -> None:
        for machine in ("site", *ROBOTS):
            docker("rm", "-f", f"{self.name}-{machine}-driver", check=False)
            self.compose(machine, "down", "-v", "-t", "5")
            docker("rm", "-f", self.machine(machine), check=False)
        docker("network", "rm", self.name, check=False)
        self.own(os.getuid())


COUNT_POSES = """
import urllib.request
for line in urllib.request.urlopen("http://127.0.0.1:9106/metrics").read().decode().splitlines():
    if line.startswith('eigenscan_messages_total{what="said_pose"}'):
        print(float(line.split()[1]))
"""


@pytest.fixture(scope="module")
def fleet(images: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    folder = tmp_path_factory.mktemp("fleet") / "fleet"
    fleet = Fleet(f"eigenscan-fleet-{uuid.uuid4().hex[:6]}", images, folder, free_port())
    robots = [word for name in ROBOTS for word in ("--robot", name)]
    done = run("certify", "--site", SITE, "--address", "site", *robots, "-o", fleet.folder)
    assert done.exit_code == 0, done.output
    shutil.copytree(ROOT / "deploy/maps", fleet.folder / "site/maps")
    docker("network", "create", fleet.name)
    try:
        fleet.own(USER)
        for machine in ("site", *ROBOTS):
            fleet.begin(machine)
        for robot in ROBOTS:
            fleet.drive(robot)
        yield fleet
    finally:
        print(fleet.log()[-20000:])
        fleet.end()


@contextmanager
def operator(fleet: Fleet) -> Iterator[zenoh.Session]:
    """The operator's session, from outside."""
    own = fleet.folder / "operator"
    text = (own / "operator.json5").read_text()
    config = fleet.folder.parent / "operator.json5"
    here = text.replace(INSTALLED, str(own)).replace(f"tls/site:{PORT}", f"tls/localhost:{fleet.port}")
    config.write_text(here)
    with open_session(config) as session:
        yield session


@pytest.fixture(scope="module")
def received(fleet: Fleet) -> Iterator[Counter[str]]:
    """How often which channel of which robot came to the operator, and claims that it is localized."""
    received: Counter[str] = Counter()

    def on_sample(sample: zenoh.Sample) -> None:
        found = find(str(sample.key_expr))
        name = found[0].name if found else str(sample.key_expr)
        received[name] += 1
        if found and found[0] is POSE:
            claim = PoseEstimate.FromString(sample.payload.to_bytes()).state == STATE_LOCALIZED
            received[f"{found[1]['robot']} pose"] += 1
            received[f"{found[1]['robot']} localized"] += claim

    with operator(fleet) as session:
        session.declare_subscriber(f"{SITE}/**", on_sample)
        yield received


def test_all_become_healthy_and_none_has_rights_it_does_not_need(fleet: Fleet) -> None:
    members = [(machine, name) for machine in ("site", *ROBOTS) for name in SERVICES[fleet.kind(machine)]]

    def state(machine: str, service: str) -> object:
        health = fleet.inspect(machine, service)["State"]["Health"]
        return health["Status"]  # type: ignore[index]

    for machine, service in members:
        where = machine, service
        until(lambda: state(*where) == "healthy", PATIENCE_S, lambda: f"{where} {fleet.log()}")  # noqa: B023
        found = fleet.inspect(machine, service)
        host = found["HostConfig"]
        assert found["Config"]["User"] == "10001:10001", service
        assert host["CapDrop"] == ["ALL"], service
        assert host["ReadonlyRootfs"] is True, service
        assert host["Privileged"] is False, service
        assert host["SecurityOpt"] == ["no-new-privileges:true"], service
        assert host["Memory"] > 0, service  # type: ignore[operator]
        assert not host["PortBindings"], service


def test_no_container_compiles_what_its_image_holds(fleet: Fleet) -> None:
    for robot in ROBOTS:
        for service in ("scan-ingest", "projector", "tracker"):
            log = docker("logs", fleet.container(robot, service))
            assert "ready" in log
            assert "compiling" not in log, log


def test_the_site_receives_where_each_robot_is(fleet: Fleet, received: Counter[str]) -> None:
    for robot in ROBOTS:
        claims = f"{robot} localized"
        until(lambda: received[claims] > 10, PATIENCE_S, lambda: f"{claims}: {received}\n{fleet.log()}")  # noqa: B023


def test_what_stays_on_the_robot_does_not_come(fleet: Fleet, received: Counter[str]) -> None:
    # a new fleet sends scans as well: the site keeps its map true by them
    crossing = {SCAN.name} | {channel.name for channel in CHANNELS if channel.qos.air_hz > 0}
    until(lambda: received["tracks"] > 3 and received["health"] > 3, PATIENCE_S, lambda: str(received))
    names = {name for name in list(received) if " " not in name}
    assert names <= crossing
    assert names >= {"pose", "tracks", "health"}


def until_quiet(received: Counter[str], what: str) -> None:
    """Waits until no more of that comes: what was under way has arrived."""
    newest, since = received[what], time.monotonic()

    def is_quiet() -> bool:
        nonlocal newest, since
        if received[what] != newest:
            newest, since = received[what], time.monotonic()
        return time.monotonic() - since > QUIET_S

    until(is_quiet, PATIENCE_S, lambda: f"{what} goes on: {received}")


def test_a_robot_that_is_cut_off_goes_on_and_comes_back(fleet: Fleet, received: Counter[str]) -> None:
    docker("network", "disconnect", fleet.name, fleet.machine("r17"))
    until_quiet(received, "r17 pose")
    before, at_site = fleet.poses("r17"), received["r17 pose"]
    until(lambda: fleet.poses("r17") > before + 20, PATIENCE_S, lambda: "no pose without the site")
    assert received["r17 pose"] == at_site
    docker("network", "connect", "--alias", "r17", fleet.name, fleet.machine("r17"))
    until(lambda: received["r17 pose"] > at_site + 10, PATIENCE_S, lambda: f"r17 is not back: {received}")


def test_a_stolen_robot_is_out_and_the_rest_come_back(fleet: Fleet, received: Counter[str]) -> None:
    fleet.own(os.getuid())
    (fleet.folder / "robots/r18").rename(fleet.folder / "robots/kept")
    shutil.copytree(fleet.folder / "robots/kept", fleet.folder / "robots/r18")
    assert run("revoke", "r18", "-o", fleet.folder).exit_code == 0
    # its own machine still has everything: it is the stolen one
    (fleet.folder / "robots/kept").rename(fleet.folder / "robots/r18")
    fleet.own(USER)
    router = fleet.container("site", "site-router")
    until(lambda: docker("inspect", "-f", "{{.RestartCount}}", router).strip() != "0", PATIENCE_S, fleet.log)
    begun = received["r17 pose"]
    until(lambda: received["r17 pose"] > begun + 10, PATIENCE_S, lambda: f"r17 is not back: {received}")
    out = received["r18 pose"]
    published, still = fleet.poses("r18"), received["r17 pose"]
    until(lambda: received["r17 pose"] > still + 30, PATIENCE_S, lambda: "r17 is gone")
    assert fleet.poses("r18") > published
    assert received["r18 pose"] == out


def test_no_secret_is_in_an_image_or_a_log(fleet: Fleet) -> None:
    for service in ("router", "tracker", "mapbuilder", "recorder", "simulator"):
        searched = "grep -rIl 'PRIVATE KEY-----' /opt/own /recordings /var/cache /etc /tmp 2>/dev/null; true"
        found = docker("run", "--rm", "--entrypoint", "sh", f"{fleet.images}/{service}", "-c", searched)
        assert not [path for path in found.split() if path.endswith((".key", ".pem", ".json5"))], found
    fleet.own(os.getuid())
    secrets = {line for path in fleet.folder.rglob("*.key") for line in path.read_text().split("\n")[1:-2]}
    fleet.own(USER)
    log = fleet.log()
    assert len(secrets) >= 10
    assert "ready" in log
    assert not [line for line in secrets if line in log]
