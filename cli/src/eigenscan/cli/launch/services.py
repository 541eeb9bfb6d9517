"""The services as one pipeline: started with what they need, and awaited."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from eigenscan.cli.launch.screen import StatusLine
from eigenscan.cli.launch.supervision import ROS_BRIDGE, SERVICES, Supervisor
from eigenscan.fleet.view import FleetView
from eigenscan.runtime.errors import FailedError
from eigenscan.runtime.stop_event import StopEvent
from eigenscan.schemas.health_pb2 import Health

READY_S = 180.0
"""What building the models of a large map may take at the start."""

AWAIT_MODEL = ("mapbuilder", "projector")
"""The services that work once they have the model; the others wait for scans only."""


@dataclass(frozen=True)
class Pipeline:
    """What the services of one robot are told."""

    site: str
    robot: str
    model_flags: Sequence[str]  # the mapbuilder's: --map FILE or --model FOLDER
    zenoh: Path | None
    mcap: Path
    rrd: Path | None
    viewer: bool
    ros2_flags: Sequence[str] | None = None  # the ROS bridge's; None: without one
    listen: Sequence[str] = ()  # endpoints for other machines
    told: Mapping[str, Sequence[str]] = field(default_factory=dict)  # flags of single services, by name

    def start(self, supervisor: Supervisor) -> None:
        """Starts all services, the recorder first, so that it receives everything."""
        shared = ["--site", self.site, "--robot", self.robot]
        if self.zenoh:
            shared += ["--zenoh", str(self.zenoh)]
        recorder = ["--mcap", str(self.mcap)]
        if self.rrd:
            recorder += ["--rrd", str(self.rrd)]
        if self.viewer:
            recorder += ["--viewer-port", "0", "--data-port", "0"]
        flags = {"recorder": recorder, "mapbuilder": list(self.model_flags)}
        for name in sorted(SERVICES, key=lambda name: name != "recorder"):
            told = self.told.get(name, ())
            supervisor.start(name, SERVICES[name], [*shared, *flags.get(name, []), *told])
        if self.ros2_flags is not None:
            told = self.told.get("ros-bridge", ())
            supervisor.start("ros-bridge", ROS_BRIDGE, [*shared, *self.ros2_flags, *told])


def lacking(view: FleetView, services: Iterable[str]) -> list[str]:
    """What is still to come before `services` work: names, with what they say they lack."""
    found = []
    for service in services:
        health = view.health(service)
        if health is None:
            found.append(service)
        elif service in AWAIT_MODEL and health.status == Health.STATUS_WAITING:
            found.append(f"{service} ({health.detail})")
    return found


def wait_until_ready(supervisor: Supervisor, view: FleetView, line: StatusLine, stop: StopEvent) -> bool:
    """Waits until every service is there and has its model; False where the end was asked for.

    Raises ChildDiedError, or FailedError where it takes longer than READY_S.
    """
    deadline = time.monotonic() + READY_S
    while not stop.stopping:
        supervisor.check()
        view.update()
        missing = lacking(view, supervisor.children)
        if not missing:
            return True
        if time.monotonic() > deadline:
            raise FailedError(f"not ready after {READY_S:.0f} s: still waiting for {', '.join(missing)}")
        line.show(f"starting, on the first run for a minute: waiting for {', '.join(missing)}")
        stop.wait(0.1)
    return False


def viewer_link(supervisor: Supervisor) -> str | None:
    """The link that the recorder printed, if it serves a viewer."""
    log = supervisor.children["recorder"].log.read_text(encoding="utf-8", errors="replace")
    lines = [line for line in log.splitlines() if line.startswith("viewer: ")]
    return lines[-1].removeprefix("viewer: ").strip() if lines else None
