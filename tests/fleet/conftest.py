"""A fleet as `eigenscan fleet certify` makes it, on this machine: a port for each of its routers."""

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import zenoh
from eigenscan.cli.main import app
from eigenscan.fleet.configuration import INSTALLED, PORT
from eigenscan.runtime.session import open_session
from typer.testing import CliRunner, Result

from tests import environment
from tests.network import free_port, patient

SITE = "hospital"
ROBOTS = ("r17", "r18")
ROUTER = "from eigenscan.runtime.router import main; main()"
ZENOHD = os.environ.get("EIGENSCAN_TEST_ZENOHD")
"""Zenoh's own router, to be tried in place of ours with the same configuration: `cargo install zenohd`."""
READY_S = 120.0
"""What a step may take on a machine that is busy."""


def run(*arguments: object) -> Result:
    """`eigenscan fleet ARGUMENTS`."""
    return CliRunner().invoke(app, ["fleet", *map(str, arguments)])


def until(condition: Callable[[], bool], what: str, limit_s: float = READY_S) -> None:
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.05)


@dataclass
class Fleet:
    """The folder, what of it is installed on each machine, and the machines' routers as processes."""

    folder: Path
    machines: Path
    ports: dict[str, int] = field(default_factory=lambda: {name: free_port() for name in ("site", *ROBOTS)})
    routers: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def command(self, *arguments: object) -> Result:
        done = run(*arguments, "-o", self.folder)
        assert done.exit_code == 0, done.stderr
        return done

    def install(self, machine: str) -> Path:
        """Copies a machine's part of the folder to it; gives where."""
        whole = machine in ("site", "operator") or machine.startswith("groups/")
        source = self.folder / (machine if whole else f"robots/{machine}")
        target = self.machines / machine
        target.mkdir(parents=True, exist_ok=True)
        for path in source.iterdir():
            new = target / f"{path.name}.copied"
            if path.suffix == ".json5":
                text = path.read_text().replace(INSTALLED, str(target)).replace("[::]", "127.0.0.1")
                # the plain port is the robot's own, the other one the site's
                own = text.replace(f"tcp/127.0.0.1:{PORT}", f"tcp/127.0.0.1:{self.ports.get(machine)}")
                new.write_text(patient(own.replace(f":{PORT}", f":{self.ports['site']}")))
            else:
                shutil.copy(path, new)
            new.replace(target / path.name)
        return target

    def start(self, machine: str) -> None:
        """Starts a machine's router, as another one after it has ended."""
        config = self.machines / machine / "router.json5"
        ours = [sys.executable, "-c", ROUTER, "--zenoh", config, "--site", SITE, "--robot", machine]
        command = [ZENOHD, "--config", config] if ZENOHD else [*ours, "--end-on-change"]
        with (self.machines / f"{machine}.log").open("ab") as log:
            self.routers[machine] = subprocess.Popen(
                list(map(str, command)), stderr=log, env=environment.clean()
            )
        until(lambda: self.answers(machine), f"no router on {machine}: {self.log(machine)}")

    def restart_with_the_new_configuration(self, machine: str) -> None:
        """Ours ends by itself, and Docker or systemd starts it; Zenoh's own is ended by hand."""
        router = self.routers[machine]
        if ZENOHD:
            router.terminate()
        ended = router.wait(READY_S)
        assert ZENOHD or ended == 0, "the router did not notice its new configuration"
        self.start(machine)

    def answers(self, machine: str) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.ports[machine])) == 0

    def log(self, machine: str) -> str:
        return (self.machines / f"{machine}.log").read_text()

    def at_site(self, name: str) -> zenoh.Session:
        """A session with the certificate of a service of the site."""
        return open_session(self.machines / ("operator" if name == "operator" else "site") / f"{name}.json5")

    def past_its_router(self, robot: str) -> zenoh.Session:
        """A session with a robot's certificate straight to the site: what who stole it would open."""
        config = zenoh.Config.from_file(str(self.machines / robot / "router.json5"))
        for key, value in (
            ("mode", '"client"'),
            ("listen/endpoints", "[]"),
            ("access_control", '{"enabled": false}'),
            ("downsampling", "[]"),
        ):
            config.insert_json5(key, value)
        return zenoh.open(config)

    def on_robot(self, robot: str) -> zenoh.Session:
        return open_session(self.machines / robot / "service.json5")

    def stop(self) -> None:
        for router in self.routers.values():
            router.terminate()
        for router in self.routers.values():
            router.wait(READY_S)


def make_fleet(folder: Path) -> Fleet:
    """Certified and installed; no router runs."""
    fleet = Fleet(folder / "fleet", folder / "machines")
    robots = [argument for name in ROBOTS for argument in ("--robot", name)]
    fleet.command("certify", "--site", SITE, "--address", "localhost", *robots)
    for machine in ("site", "operator", *ROBOTS):
        fleet.install(machine)
    return fleet


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    fleet = make_fleet(tmp_path_factory.mktemp("fleet"))
    try:
        fleet.start("site")
        yield fleet
    finally:
        fleet.stop()
