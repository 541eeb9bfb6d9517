"""All services of one robot, watched until the end is asked for."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import zenoh
from eigenscan.cli.figures import Events
from eigenscan.cli.launch.screen import StatusLine
from eigenscan.cli.launch.services import Pipeline, viewer_link, wait_until_ready
from eigenscan.cli.launch.supervision import SERVICES, Supervisor
from eigenscan.fleet.view import FleetView, connect
from eigenscan.runtime.errors import FailedError, UsageError
from eigenscan.runtime.session import MEETING, open_session
from eigenscan.runtime.stop_event import StopEvent
from eigenscan.schemas.channels import ALIVE_TEMPLATE
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.group import instance_name
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.schemas.words import state_word

ASK_S = 5.0
"""Longest wait for liveliness tokens, and for the map of a site that has one, s; usually milliseconds."""

OLD_S = 2.0
"""Age beyond which a pose is not shown, s: 20 scans of a 10 Hz lidar."""

EVERY_S = 1.0
"""A pose is an event so often."""


def attend(pipeline: Pipeline, folder: Path, events: Events, *, to_stderr: bool = False) -> None:
    """Runs the services until SIGINT or SIGTERM; logs go to `folder`, events to `events`.

    Raises ChildDiedError if a service ends by itself.
    """
    try:
        _attend(pipeline, folder, events, to_stderr=to_stderr)
    except FailedError as error:
        events.write("ended", folder=str(folder), reason=str(error))
        raise
    events.write("ended", folder=str(folder), reason="asked to end")


def _attend(pipeline: Pipeline, folder: Path, events: Events, *, to_stderr: bool) -> None:
    stop = StopEvent()
    with ExitStack() as stack:
        stack.callback(stop.close)
        stack.enter_context(stop.on_signals())
        line = stack.enter_context(StatusLine(to_stderr))
        session = _open(pipeline)
        view = stack.enter_context(FleetView(session, pipeline.site))
        running, own = _running(session, pipeline), instance_name(pipeline.robot)
        _refuse_second(running, own, pipeline)
        _refuse_other_map(running, view, pipeline)
        supervisor = stack.enter_context(Supervisor(folder / "logs"))
        pipeline.start(supervisor)
        if not wait_until_ready(supervisor, pipeline.services, view, line, stop, own):
            return
        line.keep(
            f"ready: listening for robot {pipeline.robot!r} of site {pipeline.site!r} at {_where(pipeline)}; "
            "Ctrl-C ends all"
        )
        link = viewer_link(supervisor)
        if link:
            line.keep(f"watch it here: {link}")
        events.write("ready", site=pipeline.site, robot=pipeline.robot, viewer=link, folder=str(folder))
        pose_events = _PoseEvents(events)
        newest: PoseEstimate | None = None
        received_at = 0.0
        while not stop.stopping:
            supervisor.check()
            for pose in view.update(pipeline.robot):
                newest, received_at = pose, time.monotonic()
                pose_events.receive(pose)
            robot = view.robots.get(pipeline.robot)
            advised = robot.advised if robot is not None else ""
            line.show(pose_text(newest, time.monotonic() - received_at, _lacking(view, own), advised))
            stop.wait(0.2)
        line.keep(f"ended; recording and logs are in {folder}")


def _open(pipeline: Pipeline) -> zenoh.Session:
    """The session of this command; a router for the others where other machines may join."""
    if pipeline.listen:
        return open_session(None, "router", pipeline.listen)
    return connect(pipeline.zenoh)


def _where(pipeline: Pipeline) -> str:
    """The address for drivers, as text."""
    return str(pipeline.zenoh) if pipeline.zenoh else ", ".join([MEETING, *pipeline.listen])


def _running(session: zenoh.Session, pipeline: Pipeline) -> list[tuple[str, str]]:
    """Names and instances of the services that run on its site, of those that a pipeline starts."""
    tokens = ALIVE_TEMPLATE.format(site=pipeline.site, service="*", instance="*", contract="*")
    replies = session.liveliness().get(tokens, timeout=ASK_S)
    keys = [str(reply.ok.key_expr).split("/") for reply in replies if reply.ok]
    own = SERVICES.keys() & pipeline.services
    return sorted((key[2], key[3]) for key in keys if key[2] in own)


def _refuse_second(running: Sequence[tuple[str, str]], own: str, pipeline: Pipeline) -> None:
    """Two pipelines under one robot's name would publish two poses. Raises UsageError."""
    names = [name for name, instance in running if instance == own]
    if names:
        raise UsageError(
            f"--robot {pipeline.robot}: its {', '.join(names)} already run on site {pipeline.site!r}: "
            "end it, or choose another --robot or --site"
        )


def _refuse_other_map(running: Sequence[tuple[str, str]], view: FleetView, pipeline: Pipeline) -> None:
    """A site has one map: another one would replace it under its other robots. Raises UsageError."""
    others = [instance for name, instance in running if name == "mapbuilder"]
    if not others or not view.until(lambda: bool(view.map_version), ASK_S):
        return
    if pipeline.map_version != view.map_version:
        raise UsageError(
            f"--site {pipeline.site}: its mapbuilder {others[0]!r} publishes another map: "
            "give that one, or choose another --site"
        )


class _PoseEvents:
    """Poses as events: each change of state, and one pose a second."""

    def __init__(self, events: Events) -> None:
        self._events, self._state, self._due = events, -1, 0.0

    def receive(self, pose: PoseEstimate) -> None:
        """Writes the pose if it is due."""
        changed, now = pose.state != self._state, time.monotonic()
        if not changed and now < self._due:
            return
        self._state, self._due = pose.state, now + EVERY_S
        self._events.write(
            "state" if changed else "pose",
            stamp_ns=nanoseconds(pose.timestamp),
            state=state_word(pose.state),
            confidence=pose.confidence,
            x=pose.pose.x,
            y=pose.pose.y,
            heading_deg=math.degrees(pose.pose.theta),
        )


def _lacking(view: FleetView, instance: str) -> list[str]:
    """The faults that services of an instance report."""
    return [
        f"{each.name}: {each.health.detail}"
        for _, each in sorted(view.services.items())
        if each.instance == instance
        and each.health
        and each.health.status != Health.STATUS_OK
        and each.health.detail
    ]


def pose_text(pose: PoseEstimate | None, age_s: float, lacking: Sequence[str], advised: str = "") -> str:
    """The newest pose as text, unless `age_s` is too large, and what the robot is `advised`.

    Without a pose, what is missing.
    """
    if pose is None:
        return f"no pose yet ({'; '.join(lacking)})" if lacking else "no pose yet"
    if age_s > OLD_S:
        return f"no pose for {age_s:.0f} s (then {state_word(pose.state)}): do scans still come?"
    at = pose.pose
    return (
        f"{state_word(pose.state)}  confidence {pose.confidence:.2f}  "
        f"x {at.x:.2f} m  y {at.y:.2f} m  heading {math.degrees(at.theta):.0f}°"
        + (f"  {advised}" if advised else "")
    )
