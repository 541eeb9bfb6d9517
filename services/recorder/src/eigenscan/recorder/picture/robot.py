"""Draws the robot: its pose in the colour of its state, its scan at the pose, and its true pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import rerun as rr
from eigenscan.geometry.pose import Array, covariance_from_message, from_message, from_pose3
from eigenscan.recorder.picture.canvas import Canvas, Pace, ScanMemory, stamp_of
from eigenscan.recorder.picture.palette import SCAN, STATE_COLOURS, TRUTH, percent, state_name
from eigenscan.recorder.picture.shapes import Array32, arrows, circle, ellipse, is_place, lift, scan_points
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, STATE_LOST, PoseEstimate
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

SCAN_AGE_NS = 500_000_000
"""A scan of another lidar that is older than this is not drawn at a pose."""
ARROW_M = 1.4


@dataclass(frozen=True)
class Sighting:
    """A believed pose that scans are drawn at."""

    stamp: int
    pose: Array


class RobotPicture:
    """Draws poses and scans of all robots. A scan waits for the pose that follows from it."""

    def __init__(
        self, canvas: Canvas, pace: Pace, scans: ScanMemory, label_gap: Callable[[], float], *, brief: bool
    ) -> None:
        """`label_gap`: m from a robot to its label; `brief`: the label is its name alone."""
        self._label_gap = label_gap
        self._canvas, self._pace, self._scans, self._brief = canvas, pace, scans, brief
        self._seen: dict[str, Sighting] = {}
        self._state: dict[str, int] = {}

    def receive_scan(self, received: Envelope) -> None:
        """Draws the scan, if its pose arrived first."""
        stamp = stamp_of(received.open(Scan).timestamp)
        seen = self._seen.get(received.address["robot"])
        if seen is not None and seen.stamp == stamp:
            self._draw_scan(received.address["robot"], received.address["lidar"], seen)

    def draw_pose(self, received: Envelope) -> None:
        """The pose, its 95 % ellipse and the scans at it; a lost robot has none of them."""
        message = received.open(PoseEstimate)
        stamp, robot = stamp_of(message.timestamp), received.address["robot"]
        if stamp is None:
            return
        news = self._state.get(robot) != message.state
        if not self._pace.due(f"pose/{robot}", stamp) and not news:
            return
        self._state[robot] = message.state
        pose = self._canvas.local(from_message(message.pose))
        if message.state == STATE_LOST or not message.track_id or not is_place(pose):
            self._forget(robot, stamp)
            return
        self._draw_robot(robot, stamp, pose, message)
        if message.state == STATE_LOCALIZED:
            seen = self._seen[robot] = Sighting(stamp, pose)
            for lidar in self._scans.lidars(robot):
                self._draw_scan(robot, lidar, seen)
        else:
            self._hide_scans(robot, stamp)

    def draw_truth(self, received: Envelope) -> None:
        """Draws the true pose from a simulator or a reference."""
        message = received.open(PoseInFrame)
        stamp, robot = stamp_of(message.timestamp), received.address["robot"]
        pose = self._canvas.local(from_pose3(message.pose))
        if stamp is None or not is_place(pose) or not self._pace.due(f"truth/{robot}", stamp):
            return
        path = f"world/robots/{robot}/truth"
        self._canvas.style(path, _truth_style)
        strips, disc = _arrow(pose, 0.06)
        self._canvas.draw(stamp, path, rr.LineStrips3D(strips), rr.Points3D(disc))

    def _draw_robot(self, robot: str, stamp: int, pose: Array, message: PoseEstimate) -> None:
        colour = STATE_COLOURS.get(message.state, TRUTH)
        path = f"world/robots/{robot}/pose"
        words = [f"{robot}:", state_name(message.state), f"{percent(message.confidence)}%", message.floor]
        label = robot if self._brief else " ".join(words).rstrip()
        self._canvas.style(path, _arrow_style)
        strips, disc = _arrow(pose, 0.12)
        self._canvas.draw(
            stamp,
            path,
            rr.LineStrips3D(strips, colors=[colour]),
            rr.Points3D(disc, colors=[colour]),
        )
        self._canvas.style(f"{path}/label", _label_style)
        self._canvas.draw(
            stamp,
            f"{path}/label",
            rr.Points3D(lift(label_place(pose, self._label_gap()), 0.12), colors=[colour], labels=[label]),
        )
        covariance = covariance_from_message(message.covariance)
        if is_place(covariance):
            outline = lift(ellipse(pose, covariance), 0.08)
            path = f"{path}/within_95_percent"
            self._canvas.style(path, _ellipse_style)
            self._canvas.draw(stamp, path, rr.LineStrips3D([outline], colors=[colour]))
        self._draw_protection_level(robot, stamp, pose, message)

    def _draw_protection_level(self, robot: str, stamp: int, pose: Array, message: PoseEstimate) -> None:
        """The circle that holds the true position, but for the risk that the tracker's settings allow."""
        path = f"world/robots/{robot}/pose/protection_level"
        radius = message.protection_radius if message.HasField("protection_radius") else np.inf
        if radius > 0.0 and is_place(radius):
            self._canvas.style(path, _protection_style)
            self._canvas.draw(stamp, path, rr.LineStrips3D([lift(circle(pose, radius), 0.08)]))
        else:
            self._canvas.clear(stamp, path)

    def _draw_scan(self, robot: str, lidar: str, seen: Sighting) -> None:
        scan = self._scans.newest(robot, lidar, seen.stamp, SCAN_AGE_NS)
        if scan is not None:
            path = f"world/robots/{robot}/scan/{lidar}"
            self._canvas.style(path, _scan_style)
            self._canvas.draw(seen.stamp, path, rr.Points3D(lift(scan_points(scan, seen.pose), 0.06)))

    def _forget(self, robot: str, stamp: int) -> None:
        path = f"world/robots/{robot}/pose"
        self._canvas.clear(stamp, path)
        self._canvas.clear(stamp, f"{path}/within_95_percent")
        self._canvas.clear(stamp, f"{path}/protection_level")
        self._canvas.clear(stamp, f"{path}/label")
        self._hide_scans(robot, stamp)

    def _hide_scans(self, robot: str, stamp: int) -> None:
        self._seen.pop(robot, None)
        for lidar in self._scans.lidars(robot):
            self._canvas.clear(stamp, f"world/robots/{robot}/scan/{lidar}")


def label_place(pose: Array, gap: float) -> Array:
    """Place (2,) of the label of a robot at `pose` (3,), `gap` m beside its arrow.

    A label is wide and low, so only places above and below are free of the arrow at any heading.
    """
    away = -gap if np.sin(pose[2]) >= 0.0 else gap
    return np.array([pose[0], pose[1] + away])


def _arrow(pose: Array, height: float) -> tuple[Array32, Array32]:
    """Strips and disc of an arrow along the heading."""
    return arrows(pose, ARROW_M, height), lift(pose[:2], height)


def _arrow_style() -> tuple[rr.LineStrips3D, rr.Points3D]:
    return (
        rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(3.0)),
        rr.Points3D.from_fields(radii=rr.Radius.ui_points(8.0)),
    )


def _label_style() -> tuple[rr.Points3D]:
    return (rr.Points3D.from_fields(radii=0.0, show_labels=True),)


def _truth_style() -> tuple[rr.LineStrips3D, rr.Points3D]:
    return (
        rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(3.0), colors=[TRUTH]),
        rr.Points3D.from_fields(radii=rr.Radius.ui_points(8.0), colors=[TRUTH]),
    )


def _ellipse_style() -> tuple[rr.LineStrips3D]:
    return (rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(1.5)),)


def _protection_style() -> tuple[rr.LineStrips3D]:
    return (rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(0.75), colors=[TRUTH]),)


def _scan_style() -> tuple[rr.Points3D]:
    return (rr.Points3D.from_fields(colors=[SCAN], radii=rr.Radius.ui_points(2.0)),)
