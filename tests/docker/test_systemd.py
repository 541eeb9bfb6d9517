"""A robot and a site kept up by systemd, with the units as they are: a container each, systemd in it."""

import json
import shutil
import subprocess
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.docker.conftest import MARKS
from tests.environment import PATIENT, ROOT
from tests.fleet.conftest import run

SITE, ROBOT = "hospital", "r17"
UNITS = {
    "site": ("router", "mapbuilder", "recorder"),
    "robot": ("router", "scan-ingest", "projector", "tracker", "recorder"),
}
RIGHTS = ("SYS_ADMIN", "NET_ADMIN", "SYS_PTRACE")
"""What systemd itself needs to shut services in; they get none of it."""
PATIENCE_S = 600.0

pytestmark = MARKS


def docker(*arguments: object, check: bool = True) -> str:
    done = subprocess.run(
        ["docker", *map(str, arguments)], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0 or not check, f"{arguments}: {done.stdout}{done.stderr}"
    return done.stdout


@dataclass(frozen=True)
class Computer:
    """A machine with systemd."""

    container: str
    kind: str

    def run(self, *words: object, check: bool = True) -> str:
        return docker("exec", self.container, *words, check=check)

    def show(self, unit: str, *names: str) -> dict[str, str]:
        """What systemd states of a service."""
        shown = self.run("systemctl", "show", f"eigenscan@{unit}", f"--property={','.join(names)}")
        return dict(line.split("=", 1) for line in shown.splitlines())

    def journal(self) -> str:
        return self.run("journalctl", "--no-pager", "--lines=400", check=False)

    def until(self, condition: Callable[[], object], what: str) -> None:
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, f"{what}\n{self.journal()}"
            time.sleep(0.5)

    def is_ready(self, unit: str) -> bool:
        reported = self.run("journalctl", "--no-pager", f"--unit=eigenscan@{unit}", "--output=cat")
        return '"event": "ready"' in reported


@pytest.fixture(scope="module")
def computers(images: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Computer]]:
    folder, name = tmp_path_factory.mktemp("systemd"), f"eigenscan-systemd-{uuid.uuid4().hex[:6]}"
    done = run("certify", "--site", SITE, "--address", "site", "--robot", ROBOT, "-o", folder / "fleet")
    assert done.exit_code == 0, done.output
    parts = {"site": folder / "fleet/site", "robot": folder / f"fleet/robots/{ROBOT}"}
    shutil.copytree(ROOT / "deploy/maps", parts["site"] / "maps")
    shutil.copytree(folder / "fleet/operator", parts["site"], dirs_exist_ok=True)
    recipe = Path(__file__).with_name("systemd.dockerfile")
    docker("build", "-q", "--build-arg", f"IMAGES={images}", "-t", name, "-f", recipe, recipe.parent)
    docker("network", "create", name)
    made = {kind: Computer(f"{name}-{kind}", kind) for kind in UNITS}
    try:
        for kind, computer in made.items():
            begin(computer, name, parts[kind])
        yield made
    finally:
        for computer in made.values():
            print(computer.journal()[-10000:])
            docker("rm", "-f", computer.container, check=False)
        docker("network", "rm", name, check=False)
        docker("rmi", "-f", name, check=False)


def begin(computer: Computer, network: str, part: Path) -> None:
    """A container on `network`, and in it what docs/fleet.md states."""
    rights = [f"--cap-add={right}" for right in RIGHTS]
    free = ["--security-opt=seccomp=unconfined", "--security-opt=apparmor=unconfined"]
    cgroups = ["--cgroupns=host", "--volume=/sys/fs/cgroup:/sys/fs/cgroup", "--env=container=docker"]
    disks = [f"--tmpfs={path}" for path in ("/run", "/run/lock", "/tmp")]
    docker(
        "run", "-d", "--name", computer.container, f"--network={network}", f"--network-alias={computer.kind}",
        *rights, *free, *cgroups, *disks, network,
    )  # fmt: skip
    computer.until(
        lambda: (
            computer.run("systemctl", "is-system-running", check=False).strip() in ("running", "degraded")
        ),
        "systemd is up",
    )
    docker("cp", part, f"{computer.container}:/etc/eigenscan")
    docker("cp", ROOT / "deploy/systemd", f"{computer.container}:/root/systemd")
    computer.run("chown", "-R", "0:0", "/etc/eigenscan")  # as from sudo cp
    computer.run("systemd-sysusers", "/root/systemd/eigenscan.sysusers")
    computer.run("systemd-tmpfiles", "--create", "/root/systemd/eigenscan.tmpfiles")
    computer.run("sh", "-c", "cp -r /root/systemd/eigenscan@* /root/systemd/*.target /etc/systemd/system")
    # a busy machine may need more than two seconds to end a service
    more = [f"Environment={name}={value}" for name, value in PATIENT.items()]
    reported = "\\n".join(["[Service]", *more, "TimeoutStopSec=120"])
    extra = "/etc/systemd/system/eigenscan@.service.d"
    computer.run("sh", "-c", f"mkdir -p {extra} && printf '{reported}\\n' > {extra}/patient.conf")
    computer.run("systemctl", "daemon-reload")
    computer.run("systemctl", "enable", "--now", f"eigenscan-{computer.kind}.target")


@pytest.mark.parametrize("kind", UNITS)
def test_every_service_starts_once_and_without_rights(computers: dict[str, Computer], kind: str) -> None:
    computer = computers[kind]
    users = set()
    for unit in UNITS[kind]:
        computer.until(lambda: computer.is_ready(unit), f"{unit} is ready")  # noqa: B023
        shown = computer.show(unit, "ActiveState", "NRestarts", "MainPID")
        assert shown["ActiveState"] == "active", computer.journal()
        assert shown["NRestarts"] == "0", computer.journal()
        status = computer.run("cat", f"/proc/{shown['MainPID']}/status")
        reported = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
        (own,) = set(reported["Uid"].split())
        users.add(own)
        assert int(reported["CapEff"], 16) == int(reported["CapBnd"], 16) == 0, unit
        assert reported["NoNewPrivs"] == "1", unit
        assert reported["Seccomp"] == "2", unit
        # its own view of the files: nothing but its own folders can be written
        mounts = computer.run("cat", f"/proc/{shown['MainPID']}/mounts").splitlines()
        root = next(line.split() for line in mounts if line.split()[1] == "/")
        assert "ro" in root[3].split(","), unit
    assert len(users - {"0"}) == len(UNITS[kind])


def test_the_site_receives_a_robot_that_systemd_keeps_up(computers: dict[str, Computer]) -> None:
    site, robot = computers["site"], computers["robot"]
    docker("cp", ROOT / "deploy/maps", f"{robot.container}:/root/maps")
    simulated = ["simulate", "--live", "--map=/root/maps/map.yaml", "--seconds=3000", f"--site={SITE}"]
    where = ["--zenoh=/etc/eigenscan/service.json5", f"--robot={ROBOT}"]
    docker("exec", "-d", robot.container, "/opt/eigenscan/bin/eigenscan", *simulated, *where)
    site.until(lambda: state_of(site).get("state") == "localized", "the robot is localized")
    assert state_of(site)["services"] == {"scan-ingest": "ok", "projector": "ok", "tracker": "ok"}
    recordings = site.run("sh", "-c", "find /var/lib/eigenscan/recordings -name '*.mcap' -size +0")
    assert recordings


def state_of(site: Computer) -> dict[str, Any]:
    """The robot's row of `eigenscan fleet status`."""
    reported = site.run(
        "/opt/eigenscan/bin/eigenscan", "fleet", "status", f"--site={SITE}",
        "--zenoh=/etc/eigenscan/operator.json5", "--json=-",
    )  # fmt: skip
    return next((dict(row) for row in json.loads(reported)["robots"] if row["robot"] == ROBOT), {})


def test_what_is_killed_is_started_again_and_begins_where_it_was(computers: dict[str, Computer]) -> None:
    site, robot = computers["site"], computers["robot"]
    for unit in UNITS["robot"]:
        before = robot.show(unit, "MainPID")["MainPID"]
        robot.run("systemctl", "kill", "--signal=KILL", f"eigenscan@{unit}")
        back = {"NRestarts": "1", "ActiveState": "active"}
        robot.until(lambda: robot.show(unit, *back) == back, f"{unit} is back")  # noqa: B023
        assert robot.show(unit, "MainPID")["MainPID"] != before
    site.until(lambda: state_of(site).get("state") == "localized", "the robot is localized again")
    kept = robot.run("find", "/var/lib/eigenscan", "-type", "f")
    assert "/var/lib/eigenscan/models/" in kept
    assert "/var/lib/eigenscan/pose/" in kept


@pytest.mark.parametrize("kind", UNITS)
def test_the_target_ends_all_of_them_in_good_order(computers: dict[str, Computer], kind: str) -> None:
    computer = computers[kind]
    computer.run("systemctl", "stop", f"eigenscan-{kind}.target")
    for unit in UNITS[kind]:
        ended = {"ActiveState": "inactive", "Result": "success"}
        computer.until(lambda: computer.show(unit, *ended) == ended, f"{unit} has ended well")  # noqa: B023
