"""Starts the services of a pipeline with their settings, and waits for them."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from eigenscan.cli.launch.screen import StatusLine
from eigenscan.cli.launch.supervision import NODES, SERVICES, Supervisor
from eigenscan.cli.launch.together import BETWEEN, TOGETHER, TOGETHER_MODULE
from eigenscan.fleet.view import FleetView
from eigenscan.runtime.errors import FailedError
from eigenscan.runtime.stop_event import StopEvent
from eigenscan.schemas.group import instance_name
from eigenscan.schemas.health_pb2 import Health

READY_S = 600.0
"""Longest wait at the start, s: large maps take minutes, and so does compiling on a busy or small machine."""

FOXGLOVE_PORT = 8765
"""The one that Foxglove offers first."""

AWAIT_MODEL = ("mapbuilder", "projector")
"""The services that work once they have the model; the others wait for scans only."""


@dataclass(frozen=True)
class Pipeline:
    """Flags of one robot's services."""

    site: str
    robot: str
    model_flags: Sequence[str]  # the mapbuilder's: --map FILE or --model FOLDER
    zenoh: Path | None
    mcap: Path
    rrd: Path | None
    viewer: bool
    ros2_flags: Sequence[str] | None = None  # the ROS bridge's; None: without one
    listen: Sequence[str] = ()  # endpoints for other machines
    flags: Mapping[str, Sequence[str]] = field(default_factory=dict)  # flags of single services, by name
    together: bool = False  # all services in one process
    foxglove: bool = False  # serve Foxglove too
    map_version: str = ""  # what the mapbuilder will publish
    without: Sequence[str] = ()  # services that other programs stand in for

    def start(self, supervisor: Supervisor) -> None:
        """Starts all services, the recorder first, so that it receives everything."""
        # a settings file may be of a machine whose services have another name
        shared = ["--site", self.site, "--robot", self.robot, "--instance", instance_name(self.robot)]
        if self.zenoh:
            shared += ["--zenoh", str(self.zenoh)]
        recorder = ["--mcap", str(self.mcap)]
        if self.rrd:
            recorder += ["--rrd", str(self.rrd)]
        if self.viewer:
            recorder += ["--viewer-port", "0", "--data-port", "0"]
        if self.foxglove:
            recorder += ["--foxglove-port", str(FOXGLOVE_PORT)]
        own = {"recorder": recorder, "mapbuilder": list(self.model_flags)}
        if self.ros2_flags is not None:
            own["ros-bridge"] = list(self.ros2_flags)
        flags = {name: [*shared, *own.get(name, []), *self.flags.get(name, ())] for name in self.services}
        if self.together:
            groups = [word for name, given in flags.items() for word in (BETWEEN, name, *given)]
            supervisor.start(TOGETHER, TOGETHER_MODULE, groups[1:])
            return
        for name in sorted(flags, key=lambda name: name != "recorder"):
            supervisor.start(name, NODES[name], flags[name])

    @property
    def services(self) -> list[str]:
        """Names of the services that it starts."""
        started = [name for name in NODES if name in SERVICES or self.ros2_flags is not None]
        return [name for name in started if name not in self.without]


def lacking(view: FleetView, services: Iterable[str], instance: str | None = None) -> list[str]:
    """What `services` still wait for: missing names, and what each health reports as missing.

    `instance`: of these alone, where others run on the site.
    """
    found = []
    for service in services:
        health = view.health(service, instance)
        if health is None:
            found.append(service)
        elif service in AWAIT_MODEL and health.status == Health.STATUS_WAITING:
            found.append(f"{service} ({health.detail})")
    return found


def wait_until_ready(
    supervisor: Supervisor,
    services: Iterable[str],
    view: FleetView,
    line: StatusLine,
    stop: StopEvent,
    instance: str | None = None,
) -> bool:
    """Waits until each of `services` is alive and has its model; False if the end was requested.

    Raises ChildDiedError, or FailedError after READY_S.
    """
    deadline = time.monotonic() + READY_S
    while not stop.stopping:
        supervisor.check()
        view.update()
        missing = lacking(view, services, instance)
        if not missing:
            return True
        if time.monotonic() > deadline:
            raise FailedError(f"not ready after {READY_S:.0f} s: still waiting for {', '.join(missing)}")
        line.show(f"starting, on the first run for a minute: waiting for {', '.join(missing)}")
        stop.wait(0.1)
    return False


def viewer_link(supervisor: Supervisor) -> str | None:
    """The link that the recorder printed, if it serves a viewer."""
    child = supervisor.children.get("recorder") or supervisor.children[TOGETHER]
    return child.output.link
