"""The services as processes on a router of their own, and what they publish."""

import csv
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
import zenoh
from eigenscan.schemas.channels import HEALTH, find
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.wire import decode

from tests import environment
from tests.environment import DATASETS, PROGRAMS

T = TypeVar("T")

INTEL = DATASETS / "intel"
BEGIN_S, LENGTH_S = 1_000_000_180.0, 30.0
SPACING = 0.5
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
PATIENCE_S = 240.0
"""What a step may take on a machine that is busy; nothing is judged by time unless stated."""
PATIENT = ("--behind-after", "inf")
"""A busy machine must not lose what a test compares."""
AWAITS_REQUESTS = ("--request-within", "inf")
"""The same of a projector: the tracker's requests come late there."""
MISSED = ("dropped", "request_missing")
"""Counters of what a busy machine loses."""


@dataclass(frozen=True)
class Drive:
    """A stretch of a real log as a recording."""

    recording: Path
    map: Path
    envelopes: list[Envelope]


def reference(stamps: np.ndarray) -> np.ndarray:
    """Positions (n, 2) of the log's reference at stamps (n,), ns."""
    with (INTEL / "log.tum").open() as file:
        rows = np.array([row[:3] for row in csv.reader(file, delimiter=" ") if row], dtype=float)
    return np.column_stack([np.interp(stamps * 1e-9, rows[:, 0], rows[:, i]) for i in (1, 2)])


def eventually(what: Callable[[], T], about: str, seen: object = "") -> T:
    """What `what` gives, as soon as it is true; `seen` is reported where it never is."""
    end = time.monotonic() + PATIENCE_S
    while not (result := what()):
        assert time.monotonic() < end, f"waited {PATIENCE_S:.0f} s in vain for {about}; {seen}"
        time.sleep(0.1)
    return result


@dataclass
class Ear:
    """Everything of a site that its own keys carry, in order of arrival."""

    received: list[Envelope] = field(default_factory=list)
    news: threading.Condition = field(default_factory=threading.Condition)

    def on_sample(self, sample: zenoh.Sample) -> None:
        found = find(str(sample.key_expr))
        if found is None:
            return
        try:
            message = decode(found[0], sample.payload.to_bytes(), str(sample.encoding))
        except ValueError:
            return
        with self.news:
            self.received.append(Envelope(found[0], found[1], message))
            self.news.notify_all()

    def wait_for(self, what: Callable[[list[Envelope]], T], about: str) -> T:
        """What `what` makes of all that was received, as soon as it is true."""
        with self.news:
            result = self.news.wait_for(lambda: what(self.received), PATIENCE_S)
        assert result, f"waited {PATIENCE_S:.0f} s in vain for {about}"
        return result

    def of(self, channel: object, message: type[T]) -> list[T]:
        """The messages of one channel so far."""
        with self.news:
            return [
                e.message for e in self.received if e.channel is channel and isinstance(e.message, message)
            ]

    def health(self, service: str) -> Health | None:
        """The newest word of a service on itself."""
        with self.news:
            return next(
                (
                    e.open(Health)
                    for e in reversed(self.received)
                    if e.channel is HEALTH and e.address["service"] == service
                ),
                None,
            )


@dataclass
class House:
    """A site with a router in this process; services are started into it one by one."""

    site: str
    config: Path
    session: zenoh.Session
    ear: Ear
    logs: Path
    running: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def start(self, service: str, *flags: object, alias: str = "") -> None:
        """Starts a service and waits until it reports how it is; `alias` names one of several."""
        before = self._words(service)
        with (self.logs / f"{service}.log").open("ab") as log:
            self.running[alias or service] = subprocess.Popen(
                self._command(f"eigenscan-{service}", flags=flags),
                stdout=log,
                stderr=log,
                env=environment.clean() | ONE_THREAD,
            )
        self.ear.wait_for(lambda _: self._words(service) > before, f"{service} to speak\n{self.log(service)}")

    def _command(self, *program: object, flags: Iterable[object] = ()) -> list[str]:
        """A program in the house, `flags` after the house's own: of two the latter counts."""
        own = ("--site", self.site, "--zenoh", self.config)
        return [str(PROGRAMS / str(program[0])), *map(str, (*program[1:], *own, *flags))]

    def _words(self, service: str) -> int:
        return sum(e.channel is HEALTH and e.address["service"] == service for e in self.ear.received)

    def missed(self, service: str) -> dict[str, int]:
        """Counters of what a service lost on a busy machine, as of its last word on itself."""
        health = self.ear.health(service)
        assert health, service
        return {name: n for name, n in health.counters.items() if n and name.startswith(MISSED)}

    def until(self, service: str, holds: Callable[[Health], bool], about: str) -> Health:
        """The first word of a service on itself that `holds`."""

        def check(_: list[Envelope]) -> Health | None:
            health = self.ear.health(service)
            return health if health is not None and holds(health) else None

        found = self.ear.wait_for(check, f"{service}: {about}")
        assert found is not None
        return found

    def terminate(self, service: str) -> int:
        """Ends a service as an operating system does; its exit code."""
        process = self.running.pop(service)
        process.send_signal(signal.SIGTERM)
        return process.wait(PATIENCE_S)

    def kill(self, service: str) -> None:
        """Ends a service without warning."""
        process = self.running.pop(service)
        process.kill()
        process.wait(PATIENCE_S)

    def log(self, service: str) -> str:
        return (self.logs / f"{service}.log").read_text(errors="replace")[-2000:]

    def replay(self, recording: Path, *flags: object) -> None:
        """Plays a recording into the site, from its start to its end."""
        done = subprocess.run(
            self._command("eigenscan", "play", recording, flags=flags),
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
