"""The status board: for each robot one line in the colour of its state, readable from across the room."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import rerun as rr
from eigenscan.recorder.picture.canvas import Canvas, stamp_of
from eigenscan.recorder.picture.palette import SILENT, STATE_COLOURS, Colour, state_name
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, STATE_UNSPECIFIED, PoseEstimate, State
from PIL import Image, ImageDraw, ImageFont

LINE_PX = (1000, 46)
REFRESH_NS = 2_000_000_000
ADVICE = {
    "LOCALIZED": "act on the pose",
    "AMBIGUOUS": "several places fit: see the tracks",
    "LOST": "do not act on any pose",
    "UNKNOWN": "no state",
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
        self._states: dict[str, State] = {}
        self._drawn_at = 0

    def hear_pose(self, heard: Envelope) -> None:
        """Updates the robot's line."""
        message, robot = heard.open(PoseEstimate), heard.address["robot"]
        stamp = stamp_of(message.timestamp)
        if stamp is None:
            return
        line = _line(robot, message)
        changed = self._states.get(robot) != message.state
        if changed:
            self._announce(stamp, robot, message)
        if changed or (self._lines.get(robot) != line and abs(stamp - self._drawn_at) >= REFRESH_NS):
            self._lines[robot] = line
            self._drawn_at = stamp
            self._canvas.draw(stamp, "status", _board(list(self._lines.values())))

    def _announce(self, stamp: int, robot: str, message: PoseEstimate) -> None:
        """State changes go to the timeline of states and to the events."""
        before = self._states.get(robot)
        self._states[robot] = message.state
        name = state_name(message.state)
        path = f"state/{robot}"
        if before is None:
            self._canvas.fix(path, _state_styles())
        self._canvas.draw(stamp, path, rr.StateChange(state=name))
        came_from = "" if before is None else f"{state_name(before)} -> "
        level = rr.TextLogLevel.INFO if message.state == STATE_LOCALIZED else rr.TextLogLevel.WARN
        self._canvas.draw(stamp, f"events/{robot}", rr.TextLog(f"{robot}: {came_from}{name}", level=level))


def _state_styles() -> rr.StateConfiguration:
    known = [state for state in STATE_COLOURS if state != STATE_UNSPECIFIED]
    return rr.StateConfiguration(
        values=[state_name(state) for state in known],
        colors=[STATE_COLOURS[state] for state in known],
    )


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
