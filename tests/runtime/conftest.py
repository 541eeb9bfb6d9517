"""Zenoh on loopback TCP, apart from all other traffic: a port and a site name per test."""

import json
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import zenoh
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import open_session

from tests import environment
from tests.network import PATIENT_QUEUE, free_port

PATIENCE_S = 120
"""What a step may take on a machine that is busy."""
TINY = Path(__file__).with_name("tiny_service.py")


@dataclass(frozen=True)
class Net:
    """Configuration files of one hub and of peers that find each other through it."""

    site: str
    hub: Path
    leaf: Path

    def open(self, path: Path | None = None) -> zenoh.Session:
        return open_session(path or self.leaf)


@pytest.fixture
def net(tmp_path: Path) -> Net:
    hub, leaf = tmp_path / "hub.json5", tmp_path / "leaf.json5"
    port = free_port()
    alone = {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}},
        # a busy machine must not lose what the test counts
        "transport": {"link": {"tx": {"queue": PATIENT_QUEUE}}},
    }
    hub.write_text(json.dumps(alone | {"listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}))
    leaf.write_text(
        json.dumps(
            alone
            | {
                "listen": {"endpoints": ["tcp/127.0.0.1:0"]},
                "connect": {"endpoints": [f"tcp/127.0.0.1:{port}"]},
            }
        )
    )
    return Net(f"test-{uuid.uuid4().hex[:12]}", hub, leaf)


@pytest.fixture
def buses(net: Net) -> Iterator[Callable[[], Bus]]:
    """Opens buses: the first is the hub. All are closed at the end."""
    opened: list[Bus] = []

    def opener() -> Bus:
        opened.append(Bus(net.open(net.leaf if opened else net.hub)))
        return opened[-1]

    yield opener
    for bus in reversed(opened):
        bus.close()


@dataclass
class Started:
    """A running service and the lines that it logs."""

    process: subprocess.Popen[str]

    def log(self, event: str) -> dict[str, object]:
        """The next logged entry of that name; fails where the service ends first."""
        assert self.process.stderr
        for line in self.process.stderr:
            entry = json.loads(line) if line.startswith("{") else {"event": line.strip()}
            if entry["event"] == event:
                return dict(entry)
        raise AssertionError(f"no {event!r} before the service ended with {self.process.wait()}")


@pytest.fixture
def start(net: Net) -> Iterator[Callable[..., Started]]:
    """Starts the tiny service as a process; it is killed at the end where it still runs."""
    running: list[subprocess.Popen[str]] = []

    def starter(*arguments: object, config: Path | None = None, program: Path = TINY) -> Started:
        command = [sys.executable, program, "--site", net.site, "--zenoh", config or net.hub]
        process = subprocess.Popen(
            [*map(str, command), "--log-format", "json", *map(str, arguments)],
            stderr=subprocess.PIPE, text=True, env=environment.clean(),
        )  # fmt: skip
        running.append(process)
        return Started(process)

    yield starter
    for process in running:
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=PATIENCE_S)
