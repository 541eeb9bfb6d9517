"""Draws the move that a robot is advised, from where it most probably is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
from eigenscan.geometry.pose import Array, compose, from_message
from eigenscan.recorder.picture.canvas import Canvas, stamp_of
from eigenscan.recorder.picture.palette import ADVICE
from eigenscan.recorder.picture.shapes import arrows, is_place, lift
from eigenscan.schemas.advice_pb2 import Advice
from eigenscan.schemas.advice_words import HOLDS_S, words_of
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.recently_used import RecentlyUsed
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, PoseEstimate

TURN_M = 1.0
"""Length of the arrow of a turn without a drive."""


@dataclass
class _Shown:
    """The newest pose, and the stamp of the advice that is drawn."""

    pose: Array | None = None
    advised: int | None = None


class AdvicePicture:
    """An arrow as long as the move, with the words beside its tip; until the place is known."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self._robots: RecentlyUsed[str, _Shown] = RecentlyUsed()

    def receive_pose(self, received: Envelope) -> None:
        """Takes where the robot most probably is; removes advice that does not hold any more."""
        message, robot = received.open(PoseEstimate), received.address["robot"]
        stamp, pose = stamp_of(message.timestamp), self._canvas.local(from_message(message.pose))
        if stamp is None:
            return
        shown = self._robots.use(robot, _Shown)
        shown.pose = pose if message.track_id and is_place(pose) else None
        if shown.advised is None:
            return
        if message.state != STATE_AMBIGUOUS or not 0 <= stamp - shown.advised < HOLDS_S * 1e9:
            shown.advised = None
            for path in _paths(robot):
                self._canvas.clear(stamp, path)

    def draw(self, received: Envelope) -> None:
        """Draws the advice; without a move, the words alone."""
        message, robot = received.open(Advice), received.address["robot"]
        stamp, words = stamp_of(message.timestamp), words_of(message)
        shown = self._robots.use(robot, _Shown)
        if stamp is None or shown.pose is None or not words:
            return
        arrow, label = _paths(robot)
        towards = compose(shown.pose, [0.0, 0.0, message.heading])
        length = message.distance if message.distance > 0.0 else TURN_M
        if message.kind != Advice.KIND_MOVE:
            length = 0.0
        tip = compose(towards, [length, 0.0, 0.0])
        if not is_place(tip):
            return
        shown.advised = stamp
        if length:
            self._canvas.style(arrow, _arrow_style)
            self._canvas.draw(stamp, arrow, rr.LineStrips3D(_arrow(towards, length)))
        else:
            self._canvas.clear(stamp, arrow)
        self._canvas.style(label, _label_style)
        self._canvas.draw(stamp, label, rr.Points3D(lift(tip[:2], 0.14), labels=[words]))


def _arrow(pose: Array, length: float) -> list[np.ndarray]:
    """Its barbs are no longer than those of the robot's own arrow."""
    if length <= TURN_M:
        return [*arrows(pose, length, 0.14)]
    head = compose(pose, [length - TURN_M, 0.0, 0.0])
    return [lift(np.stack([pose[:2], head[:2]]), 0.14), *arrows(head, TURN_M, 0.14)]


def _paths(robot: str) -> tuple[str, str]:
    return f"world/robots/{robot}/advice", f"world/robots/{robot}/advice/label"


def _arrow_style() -> tuple[rr.LineStrips3D]:
    return (rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(3.0), colors=[ADVICE]),)


def _label_style() -> tuple[rr.Points3D]:
    return (rr.Points3D.from_fields(radii=0.0, show_labels=True, colors=[ADVICE]),)
