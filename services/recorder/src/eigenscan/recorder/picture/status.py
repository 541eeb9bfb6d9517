"""The status board: for each robot one line in the colour of its state, readable from across the room."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import rerun as rr
from eigenscan.recorder.picture.canvas import REPEAT_NS, Canvas, stamp_of
from eigenscan.recorder.picture.palette import SILENT, STATE_COLOURS, Colour, state_name
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from PIL import Image, ImageDraw, ImageFont

LINE_PX = (1000, 46)
REFRESH_NS = 2_000_000_000
SILENT_NS = 3_000_000_000
"""A robot that says no pose for so long is silent."""
SILENCE = "SILENT"
WELL = state_name(STATE_LOCALIZED)
ADVICE = {
    "LOCALIZED": "act on the pose",
    "AMBIGUOUS": "several places fit: see the tracks",
    "LOST": "do not act on any pose",
    "UNKNOWN": "no state",
    SILENCE: "no pose comes any more: is its tracker running?",
}


@dataclass(frozen=True)
class Line:
    """What the board says of one robot."""

    colour: Colour
    title: str
    detail: str


class StatusBoard:
    """Draws the board whenever it changes, a state at once, figures every 2 s; and the events."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self._lines: dict[str, Line] = {}
        self._states: dict[str, str] = {}
        self._told_at: dict[str, int] = {}
        self._drawn_at = 0
        self._drawn: list[Line] = []
        self._now = 0
        self._heard_at: dict[str, int] = {}

    def hear_pose(self, heard: Envelope) -> None:
        """Updates the robot's line."""
        message, robot = heard.open(PoseEstimate), heard.address["robot"]
        stamp = stamp_of(message.timestamp)
        if stamp is None:
            return
        self._heard_at[robot] = self._now
        self._tell(stamp, robot, state_name(message.state), _line(robot, message))

    def hear_health(self, heard: Envelope) -> None:
        """Takes the services' clock: while it goes on, a robot without poses is silent, not well."""
        stamp = stamp_of(heard.open(Health).timestamp)
        self._now = max(self._now, stamp or 0)
        for robot, heard_at in self._heard_at.items():
            if heard_at and self._now - heard_at > SILENT_NS:
                self._heard_at[robot] = 0
                self._tell(
                    self._canvas.newest, robot, SILENCE, Line(SILENT, f"{robot}: {SILENCE}", ADVICE[SILENCE])
                )

    def _tell(self, stamp: int, robot: str, name: str, line: Line) -> None:
        self._lines[robot] = line
        before = self._states.get(robot)
        if before != name:
            self._announce(stamp, robot, name, before)
        if before != name or abs(stamp - self._told_at.get(robot, 0)) >= REPEAT_NS:
            self._told_at[robot] = stamp
            self._canvas.draw(stamp, f"state/{robot}", rr.StateChange(state=name))
        lines = list(self._lines.values())
        due = REFRESH_NS if lines != self._drawn else REPEAT_NS
        if before != name or abs(stamp - self._drawn_at) >= due:
            self._drawn, self._drawn_at = lines, stamp
            self._canvas.draw(stamp, "status", _board(lines))

    def _announce(self, stamp: int, robot: str, name: str, before: str | None) -> None:
        """State changes go to the events."""
        self._states[robot] = name
        self._canvas.style(f"state/{robot}", _state_styles)
        level = rr.TextLogLevel.INFO if name == WELL else rr.TextLogLevel.WARN
        text = f"{robot}: {name}" if before is None else f"{robot}: {before} -> {name}"
        self._canvas.draw(stamp, f"events/{robot}", rr.TextLog(text, level=level))


def _state_styles() -> tuple[rr.StateConfiguration]:
    colours = {state_name(state): colour for state, colour in STATE_COLOURS.items()} | {SILENCE: SILENT}
    return (rr.StateConfiguration(values=list(colours), colors=list(colours.values())),)


def _line(robot: str, message: PoseEstimate) -> Line:
    name = state_name(message.state)
    colour = STATE_COLOURS.get(message.state, SILENT)
    if not message.track_id or math.isnan(message.confidence):
        return Line(colour, f"{robot}: {name}", ADVICE[name])
    percent = 5 * round(20 * min(max(message.confidence, 0.0), 1.0))
    return Line(colour, f"{robot}: {name}   {percent} % sure", ADVICE[name])


def _board(lines: list[Line]) -> rr.Image:
    """One coloured bar a robot. Not compressed: a viewer shows nothing while it unpacks an image."""
    width, height = LINE_PX
    image = Image.new("RGB", (width, height * len(lines)))
    pen = ImageDraw.Draw(image)
    title, detail = ImageFont.load_default(26), ImageFont.load_default(16)
    for row, line in enumerate(lines):
        top = row * height
        pen.rectangle((0, top, width, top + height - 3), fill=line.colour)
        pen.text((14, top + 22), line.title, font=title, fill="white", anchor="lm")
        pen.text((width - 14, top + 22), line.detail, font=detail, fill="white", anchor="rm")
    return rr.Image(np.asarray(image))
