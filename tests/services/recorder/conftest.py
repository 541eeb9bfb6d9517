"""Recorder processes on loopback TCP, apart from all other traffic: a port and a site name per test."""

from __future__ import annotations

import json
import queue
import re
import signal
import subprocess
import sys
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.recording import Record, read
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import HEALTH, POSE
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.wire import decode

from tests.network import PATIENT_QUEUE, free_port

PATIENCE_S = 240.0


@dataclass
class Recorder:
    """A recorder process, and a bus of the test's own that is linked to it."""

    process: subprocess.Popen[str]
    bus: Bus
    site: str
    inbox: Inbox
    log: Path
    health: queue.Queue[Health] = field(default_factory=queue.Queue)

    def await_health(self, wanted: Callable[[Health], bool]) -> Health:
        """The first health message that is as wanted; fails after PATIENCE_S."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            arrival = self.inbox.take(0.2)
            if arrival is not None:
                health = decode(HEALTH, arrival.payload)
                assert isinstance(health, Health)
                if health.service == "recorder" and wanted(health):
                    return health
        pytest.fail(f"no such health; log:\n{self.log.read_text()}")

    def await_written(self, published: Sequence[Envelope]) -> Health:
        """Until all of these are in the file; of its own health there is more in it."""
        wanted = Counter(envelope.channel.name for envelope in published if envelope.channel is not HEALTH)

        def has_all(health: Health) -> bool:
            received = {name: health.counters.get(f"heard_{name}", 0) for name in wanted}
            return all(received[name] >= count for name, count in wanted.items())

        return self.await_health(has_all)

    def await_on_disk(self, path: Path, count: int, send: Callable[[], object]) -> list[Record]:
        """Publishes until so many messages of POSE can be read while the recorder is at work; gives them."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            send()
            found = [record for record in read(path) if record.envelope.channel is POSE]
            if len(found) >= count:
                return found
            assert time.monotonic() < deadline, f"{len(found)} on disk; log:\n{self.log.read_text()}"

    def stop(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(PATIENCE_S)

    def viewer(self) -> str:
        """The link that it printed."""
        found = re.search(r"^viewer: (\S+)$", self.log.read_text(), re.MULTILINE)
        assert found, self.log.read_text()
        return found.group(1)


@pytest.fixture
def start_recorder(tmp_path: Path) -> Iterator[Callable[..., Recorder]]:
    """Starts a recorder with the given flags, and waits until it is received. All end with the test."""
    started: list[Recorder] = []

    def start(*flags: str) -> Recorder:
        port, number = free_port(), len(started)
        alone = {
            "mode": "peer",
            "scouting": {"multicast": {"enabled": False}},
            "transport": {"link": {"tx": {"queue": PATIENT_QUEUE}}},
        }
        hub, leaf = tmp_path / f"hub{number}.json5", tmp_path / f"leaf{number}.json5"
        hub.write_text(json.dumps(alone | {"listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}))
        leaf.write_text(json.dumps(alone | {"connect": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}))
        site, log = f"test-{uuid.uuid4().hex[:12]}", tmp_path / f"recorder{number}.log"
        command = [sys.executable, "-m", "eigenscan.recorder.node", "--site", site, "--zenoh", str(hub)]
        with log.open("w") as output:
            process = subprocess.Popen(
                [*command, "--log-format", "json", *flags], stdout=output, stderr=output, text=True
            )
        bus = Bus(open_session(leaf, "peer"))
        recorder = Recorder(process, bus, site, Inbox(), log)
        started.append(recorder)
        bus.listen([HEALTH], {"site": site}, recorder.inbox)
        recorder.await_health(lambda health: health.status == Health.STATUS_OK)
        return recorder

    yield start
    for recorder in started:
        recorder.bus.close()
        if recorder.process.poll() is None:
            recorder.process.kill()
            recorder.process.wait()
