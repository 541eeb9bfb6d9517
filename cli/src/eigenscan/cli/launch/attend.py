"""All services of one robot, watched until the end is asked for."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from eigenscan.cli.launch.screen import StatusLine, state_name
from eigenscan.cli.launch.services import Pipeline, viewer_link, wait_until_ready
from eigenscan.cli.launch.supervision import Supervisor
from eigenscan.cli.launch.witness import Witness
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import open_session
from eigenscan.runtime.wake import Wake
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import PoseEstimate


def attend(pipeline: Pipeline, folder: Path) -> None:
    """Runs the services until SIGINT or SIGTERM; logs go to `folder`.

    Raises ChildDiedError where one of them ends by itself.
    """
    wake = Wake()
    with ExitStack() as stack:
        stack.enter_context(wake.on_signals())
        line = stack.enter_context(StatusLine())
        bus = stack.enter_context(Bus(open_session(pipeline.zenoh)))
        witness = Witness(bus, pipeline.site)
        supervisor = stack.enter_context(Supervisor(folder / "logs"))
        pipeline.start(supervisor)
        if not wait_until_ready(supervisor, witness, line, wake):
            return
        line.say(f"ready: listening for robot {pipeline.robot!r} of site {pipeline.site!r}; Ctrl-C ends all")
        if link := viewer_link(supervisor):
            line.say(f"watch it here: {link}")
        newest: PoseEstimate | None = None
        while not wake.stopping:
            supervisor.check()
            for pose in witness.listen():
                newest = pose
            line.show(_text(newest, witness))
            wake.wait(0.2)
        line.say(f"ended; recording and logs are in {folder}")


def _text(pose: PoseEstimate | None, witness: Witness) -> str:
    if pose is None:
        lacking = [
            f"{name}: {health.detail}"
            for name, health in sorted(witness.health.items())
            if health.status != Health.STATUS_OK and health.detail
        ]
        return f"no pose yet ({'; '.join(lacking)})" if lacking else "no pose yet"
    at = pose.pose
    return (
        f"{state_name(pose.state)}  confidence {pose.confidence:.2f}  "
        f"x {at.x:.2f} m  y {at.y:.2f} m  heading {at.theta:.2f} rad"
    )
