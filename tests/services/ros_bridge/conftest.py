"""A Zenoh router as a robot has it, the bridge as a process, and a robot that is an independent program.

The robot is zenoh-ros2-sdk: its keys, tokens, attachments and type hashes are its own work.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

import pytest
import zenoh
import zenoh_ros2_sdk.message_registry
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.service_types import NO_FIELDS, SERVICES
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import CHANNELS, HEALTH, Channel
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.wire import decode
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber

from tests.network import PATIENT_QUEUE, free_port

T = TypeVar("T")

PATIENCE_S = 240.0
"""What a step may take on a machine that is busy."""
ALONE = {
    "scouting": {"multicast": {"enabled": False}},
    "transport": {"link": {"tx": {"queue": PATIENT_QUEUE}}},
}


DOMAINS = count(1, 2)
"""Each robot's, and the next one's for its neighbour."""


def eventually(what: Callable[[], T | None], about: str) -> T:
    """What `what` gives, as soon as it is true."""
    deadline = time.monotonic() + PATIENCE_S
    while not (result := what()):
        assert time.monotonic() < deadline, f"waited {PATIENCE_S:.0f} s in vain for {about}"
        time.sleep(0.02)
    return result


def fields(message: Any) -> dict[str, Any]:
    """The fields of a message, as the SDK's publisher takes them."""
    return {name: value for name, value in vars(message).items() if name != "__msgtype__"}


@dataclass(frozen=True)
class Network:
    """A router's port, and the configuration of the pipeline's own services behind it."""

    port: int
    leaf: Path

    @property
    def endpoint(self) -> str:
        return f"tcp/127.0.0.1:{self.port}"

    @property
    def environment(self) -> dict[str, str]:
        """For the processes: linear algebra on one thread, five share the cores."""
        return {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@pytest.fixture(scope="session")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Network]:
    patience = PATIENT_QUEUE["congestion_control"]["drop"]["wait_before_drop"]
    # the SDK's own sessions are as patient
    sdk = f"transport/link/tx/queue/congestion_control/drop/wait_before_drop={patience}"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ZENOH_CONFIG_OVERRIDE", sdk)
        yield from _network(tmp_path_factory)


def _network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Network]:
    network = Network(free_port(), tmp_path_factory.mktemp("zenoh") / "leaf.json5")
    listening = {"listen": {"endpoints": ["tcp/127.0.0.1:0"]}, "connect": {"endpoints": [network.endpoint]}}
    network.leaf.write_text(json.dumps(ALONE | {"mode": "peer"} | listening))
    router = ALONE | {"mode": "router", "listen": {"endpoints": [network.endpoint]}}
    with zenoh.open(zenoh.Config.from_json5(json.dumps(router))):
        yield network


@dataclass
class Ear:
    """All that the site publishes, in order of arrival."""

    bus: Bus
    inbox: Inbox = field(default_factory=lambda: Inbox(64))
    received: list[Envelope] = field(default_factory=list)

    @classmethod
    @contextmanager
    def on(cls, network: Network, site: str) -> Iterator["Ear"]:
        with Bus(open_session(network.leaf)) as bus:
            ear = cls(bus)
            bus.listen_all(CHANNELS, f"{site}/**", ear.inbox)
            yield ear

    def of(self, channel: Channel, kind: type[T]) -> list[T]:
        """The messages of one channel so far."""
        while (arrival := self.inbox.take(0.0)) is not None:
            address = arrival.channel.parse(arrival.key)
            assert address is not None
            message = decode(arrival.channel, arrival.payload, arrival.encoding)
            self.received.append(Envelope(arrival.channel, address, message))
        return [e.message for e in self.received if e.channel is channel and isinstance(e.message, kind)]

    def health(self) -> Health | None:
        """The bridge's newest."""
        return next((h for h in reversed(self.of(HEALTH, Health)) if h.service == "ros-bridge"), None)


@contextmanager
def pipeline(
    network: Network, out: Path, dialect: str, ros_router: str, *flags: object, **environment: str
) -> Iterator[Ear]:
    """`eigenscan run` with the bridge, once the projector has its model; gives what it reports."""
    site = f"test-{uuid.uuid4().hex[:12]}"
    command = [sys.executable, "-m", "eigenscan.cli.main", "run", "--site", site, "--zenoh", network.leaf]
    command += ["--no-viewer", "--out", out, "--ros2", dialect, "--ros2-router", ros_router, *flags]

    def ready(ear: Ear) -> bool:
        newest = {health.service: health.status for health in ear.of(HEALTH, Health)}
        return {"ros-bridge", "tracker"} <= newest.keys() and newest.get("projector") == Health.STATUS_OK

    with Ear.on(network, site) as ear:
        with subprocess.Popen(list(map(str, command)), env=network.environment | environment) as process:
            try:
                eventually(lambda: process.poll() is not None or ready(ear), "the pipeline")
                assert process.poll() is None
                yield ear
            finally:
                process.send_signal(signal.SIGINT)
        assert process.returncode == 0


@dataclass(frozen=True)
class Bridge:
    """The bridge as a process, and the site that it is on."""

    site: str
    process: subprocess.Popen[bytes]
    ear: Ear

    def counter(self, name: str) -> int:
        health = self.ear.health()
        return health.counters.get(name, 0) if health else 0


@pytest.fixture
def start(network: Network) -> Iterator[Callable[..., Bridge]]:
    """Starts a bridge with these flags; waits until it is there."""
    started: list[Bridge] = []
    stack = ExitStack()

    def start(*flags: str, ros_router: str = network.endpoint) -> Bridge:
        site = f"test-{uuid.uuid4().hex[:12]}"
        ear = stack.enter_context(Ear.on(network, site))
        command = [
            sys.executable,
            "-m",
            "eigenscan.ros_bridge.node",
            "--site",
            site,
            "--zenoh",
            str(network.leaf),
        ]
        process = subprocess.Popen([*command, "--ros-router", ros_router, *flags])
        bridge = Bridge(site, process, ear)
        started.append(bridge)
        eventually(ear.health, "the bridge's health")
        return bridge

    with stack:
        yield start
        for bridge in started:
            bridge.process.terminate()
            assert bridge.process.wait(PATIENCE_S) == 0


@dataclass
class Robot:
    """A ROS 2 robot on the SDK, with a domain of its own."""

    port: int
    domain: int
    received: dict[str, list[Any]] = field(default_factory=dict)
    _open: list[Any] = field(default_factory=list)
    _news: threading.Lock = field(default_factory=threading.Lock)

    def publisher(self, topic: str, kind: str, **more: Any) -> ROS2Publisher:
        publisher = ROS2Publisher(topic, kind, domain_id=self.domain, router_port=self.port, **more)
        self._open.append(publisher)
        return publisher

    def subscribe(self, topic: str, kind: str, **more: Any) -> list[Any]:
        """The messages that come, as they come."""
        received = self.received.setdefault(topic, [])
        self._open.append(
            ROS2Subscriber(topic, kind, received.append, domain_id=self.domain, router_port=self.port, **more)
        )
        return received

    def close(self) -> None:
        for one in self._open:
            one.close()


@pytest.fixture(scope="session")
def definitions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The definitions that the SDK would fetch from the network, and takes its hashes from."""
    folder = tmp_path_factory.mktemp("messages")
    store = cdr._store()
    for name in store.fielddefs:
        package, kind, message = name.split("/")
        path = folder / package / kind / f"{message}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        # the message's own part; those that it refers to follow behind a line of equal signs
        path.write_text(store.generate_msgdef(name, ros_version=2)[0].split("=" * 80)[0])
    for name, parts in SERVICES.items():
        request, response = (text or NO_FIELDS for text in parts)
        (folder / f"{name}.srv").write_text(f"{request}\n---\n{response}\n")
    zenoh_ros2_sdk.message_registry.get_registry(str(folder))
    return folder


@pytest.fixture
def robot(network: Network, definitions: Path) -> Iterator[Robot]:
    robot = Robot(network.port, domain=next(DOMAINS))
    yield robot
    robot.close()
