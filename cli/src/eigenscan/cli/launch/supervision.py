"""The services as child processes: started, watched, and always ended."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from eigenscan.cli.launch.output import Output
from eigenscan.runtime.errors import FailedError
from eigenscan.runtime.receive_watchdog import EXIT_DEAF

SERVICES = {
    "scan-ingest": "eigenscan.ingest.node",
    "projector": "eigenscan.projector.node",
    "tracker": "eigenscan.tracker.node",
    "mapbuilder": "eigenscan.mapbuilder.node",
    "recorder": "eigenscan.recorder.node",
}
"""Name of each service and the module that runs it."""
ROS_BRIDGE = "eigenscan.ros_bridge.node"
"""The module of the one that only robots with ROS 2 need."""
NODES = {**SERVICES, "ros-bridge": ROS_BRIDGE}

STOP_SETTING, STOP_S = "EIGENSCAN_STOP_S", 2.0
"""Time that a child may take to end, s; after twice that it is killed."""


class ChildDiedError(FailedError):
    """A service ended by itself; the message has its name, exit code and last log lines."""


@dataclass(frozen=True)
class Child:
    """A running service and what it writes."""

    name: str
    process: subprocess.Popen[bytes]
    output: Output
    module: str
    flags: Sequence[str]


class Supervisor:
    """Child processes of this one. Use `with`: at its end all have ended."""

    def __init__(self, logs: Path) -> None:
        logs.mkdir(parents=True, exist_ok=True)
        self._logs = logs
        self.children: dict[str, Child] = {}

    def __enter__(self) -> Supervisor:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, name: str, module: str, flags: Sequence[str]) -> None:
        """Starts the service `name` from its node `module`."""
        output = Output(self._logs / f"{name}.log", appends=name in self.children)
        process = subprocess.Popen(
            [sys.executable, "-m", "eigenscan.cli.launch.child", str(os.getpid()), module, *flags],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            # Ctrl-C is for this process, which then ends its children in order
            start_new_session=True,
            env=_environment(),
        )
        assert process.stdout is not None
        output.follow(process.stdout)
        self.children[name] = Child(name, process, output, module, flags)

    def check(self) -> None:
        """Raises ChildDiedError if a child has ended by itself; restarts one that its watchdog ended."""
        for child in [*self.children.values()]:
            code = child.process.poll()
            if code == EXIT_DEAF:
                self.start(child.name, child.module, child.flags)
            elif code is not None:
                child.output.close()
                how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
                raise ChildDiedError(f"{child.name} {how}; its last log lines:\n{child.output.last_lines()}")

    def stop(self, keep: Sequence[str] = ()) -> None:
        """Ends all children but those in `keep`, the recorder last: it receives the others' last messages."""
        ending = [name for name in self.children if name not in keep]
        self._end([name for name in ending if name != "recorder"])
        self._end([name for name in ending if name == "recorder"])

    def _end(self, names: Sequence[str]) -> None:
        ending = [self.children.pop(name) for name in names]
        for child in ending:
            child.process.terminate()
        deadline = time.monotonic() + 2.0 * _stop_s()
        for child in ending:
            try:
                child.process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.process.kill()
                child.process.wait()
            child.output.close()


def _stop_s() -> float:
    """The setting as the children read it; they report a bad value themselves."""
    with contextlib.suppress(ValueError):
        return float(os.environ.get(STOP_SETTING) or STOP_S)
    return STOP_S


def _environment() -> Mapping[str, str]:
    """This process's, but for linear algebra on one thread: five services share the cores."""
    return {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", **os.environ}
