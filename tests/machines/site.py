"""A site and its robots as `eigenscan fleet certify` makes them: a machine each, with all its services."""

import shutil
import signal
import struct
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh
from eigenscan.fleet.configuration import INSTALLED, PORT
from eigenscan.geometry.gridmap import write_map
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import HEALTH, POSE, TRUTH, find
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.workbench.conformance.generation import wing
from eigenscan.workbench.simulation.lidar import Lidar
from eigenscan.workbench.simulation.live import publish
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office

from tests import environment
from tests.environment import PROGRAMS
from tests.machines.air import Air, Space, door
from tests.network import patient

SITE = "hospital"
SERVICES = {
    "site": ("router", "mapbuilder", "recorder"),
    "robot": ("router", "scan-ingest", "projector", "tracker"),
}
PATIENCE_S = 300.0
"""What a step may take on a machine that is busy."""
SCANS_HZ = 5.0
SETTINGS = "\n[mapbuilder]\nstep = 1.0\n"
"""Beside those that certify writes: a small model, made quickly."""


@dataclass(frozen=True)
class Received:
    """A pose and when it came, monotonic, s."""

    at: float
    pose: PoseEstimate

    @property
    def stamp(self) -> int:
        return nanoseconds(self.pose.timestamp)

    @property
    def is_claim(self) -> bool:
        return self.pose.state == STATE_LOCALIZED


class Ear:
    """The poses of each robot, and the newest health of each service, as one machine receives them."""

    def __init__(self, session: zenoh.Session) -> None:
        self.poses: dict[str, list[Received]] = {}
        self.health: dict[tuple[str, str], tuple[float, Health]] = {}
        self.status: list[tuple[float, str, str, int, str]] = []
        """When which service of which instance was how, and why: each change."""
        self._news = threading.Condition()
        self._declared = [
            session.declare_subscriber(channel.selector({"site": SITE}), self._on_sample)
            for channel in (POSE, HEALTH)
        ]

    def _on_sample(self, sample: Any) -> None:
        now, found = time.monotonic(), find(str(sample.key_expr))
        if found is None:
            return
        channel, address = found
        with self._news:
            if channel is POSE:
                pose = PoseEstimate.FromString(sample.payload.to_bytes())
                self.poses.setdefault(address["robot"], []).append(Received(now, pose))
            else:
                health = Health.FromString(sample.payload.to_bytes())
                name = address["service"], address["instance"]
                if name not in self.health or self.health[name][1].status != health.status:
                    self.status.append((now, *name, health.status, health.detail))
                self.health[name] = now, health
            self._news.notify_all()

    def wait_for(self, holds: Any, about: str, limit_s: float = PATIENCE_S) -> None:
        with self._news:
            assert self._news.wait_for(holds, limit_s), f"waited {limit_s:.0f} s in vain for {about}"

    def claims_since(self, robot: str, moment: float) -> int:
        """How many came since then."""
        published = self.poses.get(robot, [])
        return sum(
            1 for received in reversed(published[-100:]) if received.at >= moment and received.is_claim
        )


@dataclass
class Machine:
    """A computer: its address, what is in its /etc/eigenscan, and the services that run on it."""

    name: str
    space: Space
    folder: Path
    address: str
    environment: dict[str, str]
    running: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    ear: Ear = field(init=False)
    port: int = field(init=False)
    """Of this machine's router, through a door."""

    @property
    def kind(self) -> str:
        return "site" if self.name == "site" else "robot"

    def session(self) -> zenoh.Session:
        """One that a program on this machine would open: a service of a robot, the operator at the site."""
        own = "operator" if self.name == "site" else "service"
        text = (self.folder / f"{own}.json5").read_text().replace(self.address, "localhost")
        config = self.folder / f"{own}-outside.json5"
        config.write_text(text.replace(f":{PORT}", f":{self.port}"))
        return open_session(config)

    def start(self, service: str) -> None:
        """Starts a service; does not wait for it."""
        with (self.folder / f"{service}.log").open("ab") as log:
            self.running[service] = subprocess.Popen(
                self.space.command(PROGRAMS / f"eigenscan-{service}"),
                stdout=log, stderr=log, env=environment.clean() | self.environment, cwd=self.folder,
            )  # fmt: skip
        if service == "router":
            threading.Thread(target=self._keep_up, args=(self.running[service],), daemon=True).start()

    def _keep_up(self, router: subprocess.Popen[bytes]) -> None:
        """As systemd would: a router that ends by itself is started again."""
        if router.wait() == 0 and self.running.get("router") is router:
            self.start("router")

    def end(self, service: str, how: int) -> None:
        """Ends a service by a signal, and waits until it is gone."""
        process = self.running.pop(service)
        process.send_signal(how)
        process.wait(PATIENCE_S)

    def await_word(self, service: str, since: float) -> None:
        """Waits until a service shows that it works, from a moment on."""
        name = service, self.name

        def works() -> bool:
            at, health = self.ear.health.get(name, (0.0, Health()))
            return at > since and health.status == Health.STATUS_OK

        self.ear.wait_for(works, f"{self.name}'s {service}: {self.log(service)}")

    def log(self, service: str) -> str:
        path = self.folder / f"{service}.log"
        return path.read_text(errors="replace")[-3000:] if path.exists() else ""

    def close(self) -> None:
        ended, self.running = self.running, {}
        for process in ended.values():
            process.kill()
            process.wait(PATIENCE_S)


class Driver:
    """A simulated robot's lidar and odometry: publishes what they measure, and knows the truth."""

    def __init__(self, machine: Machine, stage: Stage, offset_s: float) -> None:
        self.stage, self.machine = stage, machine
        self.offset_ns = int(offset_s * 1e9)
        self._stop = threading.Event()
        self._bus = Bus(machine.session())
        self._thread = threading.Thread(target=self._drive, name=f"driver {machine.name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def _drive(self) -> None:
        self.stage.epoch = time.time_ns() + self.offset_ns
        publish(self.stage.messages(), self._publish, 1.0, self._stop)

    def _publish(self, envelope: Envelope) -> None:
        if envelope.channel is not TRUTH:
            self._bus.publish(envelope)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._bus.close()


@dataclass
class Fleet:
    """All machines, and the air between them."""

    air: Air
    machines: dict[str, Machine]
    drivers: dict[str, Driver]
    recordings: Path

    @property
    def site(self) -> Machine:
        return self.machines["site"]

    @property
    def robots(self) -> Sequence[str]:
        return list(self.drivers)

    def await_claims(
        self, robots: Sequence[str], since: float, count: int = 3, at_site: bool = False
    ) -> None:
        """Waits until each robot claims to be localized again."""
        for robot in robots:
            machine = self.machines["site" if at_site else robot]
            machine.ear.wait_for(
                lambda: machine.ear.claims_since(robot, since) >= count,  # noqa: B023
                f"{robot} to be localized, heard at {machine.name}",
            )


def build_clock(folder: Path) -> Path:
    """The library that shifts a clock."""
    library = folder / "clock.so"
    compiler = shutil.which("cc")
    assert compiler, "a robot with a wrong clock needs a C compiler: apt-get install gcc libc6-dev"
    source = Path(__file__).with_name("clock.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
    return library


def stages(robots: Sequence[str], seconds: float) -> list[Stage]:
    """Robots that drive through one wing of an office, each its own way."""
    return [
        Stage(
            wing(office()).render(),
            Scenario(
                seconds=seconds, seed=5, number=number, people=1, site=SITE, robot=robot,
                lidar=Lidar(beams=181, rate=SCANS_HZ),
            ),
        )
        for number, robot in enumerate(robots)
    ]  # fmt: skip


@contextmanager
def fleet(
    folder: Path,
    robots: Sequence[str],
    seconds: float,
    clocks: dict[str, float],
    recordings: Path,
    hold_back_floods: bool = True,
) -> Iterator[Fleet]:
    """A site and its robots at work, every robot localized; `clocks`: s by which a robot's is off."""
    certified = folder / "fleet"
    words = ["fleet", "certify", "--site", SITE, "--address", "10.99.0.1", "-o", str(certified)]
    for robot in robots:
        words += ["--robot", robot]
    subprocess.run([PROGRAMS / "eigenscan", *words], check=True, stdout=subprocess.DEVNULL)
    if not hold_back_floods:
        wishes = certified / "fleet.toml"
        wishes.write_text(wishes.read_text().replace("hold_back_floods = true", "hold_back_floods = false"))
        configure = ["fleet", "configure", "-o", str(certified)]
        subprocess.run([PROGRAMS / "eigenscan", *configure], check=True, stdout=subprocess.DEVNULL)
    driven = stages(robots, seconds)
    with ExitStack() as stack:
        air = Air()
        stack.callback(air.close)
        machines = {}
        for name in ("site", *robots):
            space = Space()
            stack.callback(space.close)
            part = certified / ("site" if name == "site" else f"robots/{name}")
            machine = Machine(name, space, part, air.join(name, space), {})
            stack.callback(machine.close)
            machine.environment |= _install(machine, certified, recordings, clocks.get(name, 0.0))
            machine.port = stack.enter_context(door(space, PORT))
            machines[name] = machine
        (certified / "site/maps").mkdir()
        write_map(driven[0].grid, certified / "site/maps/map.yaml")
        air.start()
        for machine in machines.values():
            for service in SERVICES[machine.kind]:
                machine.start(service)
        drivers = {}
        for machine in machines.values():
            session = machine.session()
            stack.callback(session.close)
            machine.ear = Ear(session)
        for robot, stage in zip(robots, driven, strict=True):
            drivers[robot] = Driver(machines[robot], stage, clocks.get(robot, 0.0))
            stack.callback(drivers[robot].close)
            drivers[robot].start()
        made = Fleet(air, machines, drivers, recordings)
        made.await_claims(robots, time.monotonic(), 10)
        made.await_claims(robots, time.monotonic(), at_site=True)
        yield made


def _install(machine: Machine, certified: Path, recordings: Path, offset_s: float) -> dict[str, str]:
    """Puts a machine's part of the fleet's folder in its place; gives the environment of its services."""
    own, cache = machine.folder, machine.folder / "var"
    cache.mkdir()
    if machine.name == "site":
        for path in (certified / "operator").iterdir():
            shutil.copy(path, own)
    for path in own.glob("*.json5"):
        text = path.read_text().replace(INSTALLED, str(own))
        # within a machine nothing may be lost; what waits for the air is, as the contract has it
        leaves = machine.kind == "robot" and path.name == "router.json5"
        path.write_text(text if leaves else patient(text))
    settings = own / "eigenscan.toml"
    text = settings.read_text().replace(INSTALLED, str(own)).replace("/var/cache/eigenscan", str(cache))
    text = text.replace("/var/lib/eigenscan/recordings", str(recordings)).replace(
        "viewer_port", "# viewer_port"
    )
    settings.write_text(text.replace("[mapbuilder]\n", SETTINGS.lstrip() if machine.name == "site" else ""))
    environment = {
        "EIGENSCAN_CONFIG": str(settings),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "EIGENSCAN_TRACKER_LAST_POSE": str(cache / "pose"),
    }
    if offset_s:
        clock = own / "clock"
        clock.write_bytes(struct.pack("q", int(offset_s * 1e9)))
        library = build_clock(own)
        environment |= {"LD_PRELOAD": str(library), "EIGENSCAN_TEST_CLOCK": str(clock)}
    return environment


TERM, KILL = signal.SIGTERM, signal.SIGKILL
