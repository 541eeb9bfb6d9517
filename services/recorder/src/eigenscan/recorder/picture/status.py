"""The status board: for each robot one line in the colour of its state, readable from across the room."""

from __future__ import annotations

import math

import rerun as rr
from eigenscan.recorder.picture.board import MOST_BARS, Line, draw_board, shown
from eigenscan.recorder.picture.canvas import REPEAT_NS, Canvas, stamp_of
from eigenscan.recorder.picture.palette import SILENT, STATE_COLOURS, Colour, percent, state_name
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import LidarKind
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.schemas.words import status_word

REFRESH_NS = 2_000_000_000
ROBOT_NS = 2_500_000
"""Least interval between boards of many robots, ns for each: drawing one takes 0.4 ms or more."""
SILENT_NS = 3_000_000_000
"""Time without a pose after which a robot is shown as silent, ns; or as waiting, if it never had one."""
SILENCE = "SILENT"
WAITING = "WAITING"
WELL = state_name(STATE_LOCALIZED)
ADVICE = {
    "LOCALIZED": "act on the pose",
    "UNKNOWN": "no state",
    "AMBIGUOUS": "not sure enough yet: see the tracks",
    "LOST": "do not act on any pose",
    WAITING: "scans arrive, but no pose: run eigenscan doctor",
    SILENCE: "no pose comes any more: is its tracker running?",
}
"""Of each state, the more urgent the later."""


class StatusBoard:
    """Draws the board whenever it changes, figures every 2 s, a state at once; and the events."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self._lines: dict[str, Line] = {}
        self._states: dict[str, str] = {}
        self._repeated_at: dict[str, int] = {}
        self._looked_at = self._drawn_at = 0
        self._news = False
        self._drawn: list[Line] = []
        self._now = 0
        self._received_at: dict[str, int] = {}
        self._first_scan: dict[str, int] = {}

    def receive_scan(self, received: Envelope) -> None:
        """A robot with scans but without any pose is shown too: the board must not stay empty."""
        stamp, robot = stamp_of(received.open(Scan).timestamp), received.address["robot"]
        if stamp is not None and robot not in self._lines:
            first = self._first_scan.setdefault(robot, stamp)
            if stamp - first > SILENT_NS:
                self._update(stamp, _described(robot, WAITING, SILENT))

    def receive_pose(self, received: Envelope) -> None:
        """Updates the robot's line."""
        message, robot = received.open(PoseEstimate), received.address["robot"]
        stamp = stamp_of(message.timestamp)
        if stamp is None:
            return
        self._received_at[robot] = received.arrived or self._now
        self._update(stamp, _line(robot, message))

    def receive_health(self, received: Envelope) -> None:
        """Goes by the arrival of health: while that goes on, a robot without poses is silent, not well.

        Where no arrival is known, it goes by the services' clock.
        """
        stamp = stamp_of(received.open(Health).timestamp)
        self._now = received.arrived or max(self._now, stamp or 0)
        for robot, received_at in self._received_at.items():
            if received_at > self._now:  # the clock was set back
                self._received_at[robot] = self._now
            elif received_at and self._now - received_at > SILENT_NS:
                self._received_at[robot] = 0
                self._update(self._canvas.newest, _described(robot, SILENCE, SILENT))

    def _update(self, stamp: int, line: Line) -> None:
        robot, name = line.robot, line.state
        self._lines[robot] = line
        before = self._states.get(robot)
        if before != name:
            self._announce(stamp, robot, name, before)
        if before != name or abs(stamp - self._repeated_at.get(robot, 0)) >= REPEAT_NS:
            self._repeated_at[robot] = stamp
            self._canvas.draw(stamp, f"state/{robot}", rr.StateChange(state=name))
        self._news |= before != name
        self._refresh(stamp)

    def _refresh(self, stamp: int) -> None:
        wait = REFRESH_NS
        if self._news:
            wait = 0 if len(self._lines) <= MOST_BARS else len(self._lines) * ROBOT_NS
        if abs(stamp - self._looked_at) < wait:
            return
        self._looked_at, self._news = stamp, False
        lines = shown(list(self._lines.values()))
        if lines != self._drawn or abs(stamp - self._drawn_at) >= REPEAT_NS:
            self._drawn, self._drawn_at = lines, stamp
            # not compressed: a viewer shows nothing while it unpacks an image
            self._canvas.draw(stamp, "status", rr.Image(draw_board(lines)))

    def _announce(self, stamp: int, robot: str, name: str, before: str | None) -> None:
        """State changes go to the events."""
        self._states[robot] = name
        self._canvas.style(f"state/{robot}", _state_styles)
        level = rr.TextLogLevel.INFO if name == WELL else rr.TextLogLevel.WARN
        text = f"{robot}: {name}" if before is None else f"{robot}: {before} -> {name}"
        self._canvas.draw(stamp, f"events/{robot}", rr.TextLog(text, level=level))


def _state_styles() -> tuple[rr.StateConfiguration]:
    colours = {state_name(state): colour for state, colour in STATE_COLOURS.items()}
    colours |= {SILENCE: SILENT, WAITING: SILENT}
    return (rr.StateConfiguration(values=list(colours), colors=list(colours.values())),)


def _line(robot: str, message: PoseEstimate) -> Line:
    name = state_name(message.state)
    sureness = ""
    if message.track_id and not math.isnan(message.confidence):
        sureness = f"over {percent(message.confidence, 5)} % sure"
        if message.floor:
            sureness += f", {message.floor}"
    return _described(robot, name, STATE_COLOURS.get(message.state, SILENT), sureness)


def _described(robot: str, name: str, colour: Colour, sureness: str = "") -> Line:
    return Line(robot, name, list(ADVICE).index(name), colour, sureness, ADVICE[name])


LEVELS = {
    Health.STATUS_OK: rr.TextLogLevel.INFO,
    Health.STATUS_WAITING: rr.TextLogLevel.WARN,
    Health.STATUS_DEGRADED: rr.TextLogLevel.ERROR,
}


class Events:
    """Draws changes of health at the time of the newest data: the log may be of another day."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self._last: dict[tuple[str, str], tuple[int, str]] = {}

    def receive_health(self, received: Envelope) -> None:
        """One line where status or detail changed."""
        message = received.open(Health)
        who = received.address["service"], received.address["instance"]
        now = message.status, _steady(message.detail)
        if not self._canvas.newest or self._last.get(who) == now:
            return
        self._last[who] = now
        text = f"{'/'.join(who)}: {status_word(message.status).upper()} {message.detail}".rstrip()
        level = LEVELS.get(message.status, rr.TextLogLevel.WARN)
        self._canvas.draw(self._canvas.newest, f"events/{who[0]}", rr.TextLog(text, level=level))

    def receive_kind(self, received: Envelope) -> None:
        """One line for each lidar that the site has no eigenspaces for."""
        kind, address = received.open(LidarKind), received.address
        what = f"{kind.beams} beams at 2 degrees, ranges up to {kind.cap:g} m: asks for eigenspaces"
        self._add_once("lidar_kinds", f"{address['robot']}/{address['lidar']}: {what}")

    def receive_space(self, received: Envelope) -> None:
        """One line for each kind of lidar that there are other eigenspaces for."""
        self._add_once("spaces", f"eigenspaces for lidars {received.address['kind']}")

    def _add_once(self, path: str, text: str) -> None:
        if self._canvas.newest and self._last.get((path, text)) is None:
            self._last[path, text] = (0, text)
            self._canvas.draw(self._canvas.newest, f"events/{path}", rr.TextLog(text))


def _steady(detail: str) -> str:
    """The detail without its figures, which change all the time."""
    return "".join(letter for letter in detail if not letter.isdigit())
