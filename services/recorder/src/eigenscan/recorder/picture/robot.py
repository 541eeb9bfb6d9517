"""The robot: its pose in the colour of its state, its scan where the pose puts it, and its true pose."""

from __future__ import annotations

from collections import defaultdict, deque
from dataclasses import dataclass

import numpy as np
import rerun as rr
from eigenscan.geometry.pose import covariance_from_message, from_message, from_pose3
from eigenscan.recorder.picture.canvas import Canvas, stamp_of
from eigenscan.recorder.picture.pace import Pace
from eigenscan.recorder.picture.palette import SCAN, STATE_COLOURS, TRUTH, Colour, state_name
from eigenscan.recorder.picture.shapes import Array, arrows, ellipse, lift, scan_points
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

SCANS_KEPT = 16
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

    def __init__(self, canvas: Canvas, pace: Pace) -> None:
        self._canvas, self._pace = canvas, pace
        self._scans: dict[tuple[str, str], deque[tuple[int, Scan]]] = defaultdict(
            lambda: deque(maxlen=SCANS_KEPT)
        )
        self._seen: dict[str, Sighting] = {}
        self._state: dict[str, int] = {}

    def keep_scan(self, heard: Envelope) -> None:
        """Keeps the scan until its pose comes; draws it where the pose came first."""
        scan = heard.open(Scan)
        stamp = stamp_of(scan.timestamp)
        robot, lidar = heard.address["robot"], heard.address["lidar"]
        if stamp is None:
            return
        self._scans[robot, lidar].append((stamp, scan))
        seen = self._seen.get(robot)
        if seen is not None and seen.stamp == stamp:
            self._draw_scan(robot, lidar, seen)

    def draw_pose(self, heard: Envelope) -> None:
        """The pose, its 95 % ellipse and the scans at it; a lost robot has none of them."""
        message = heard.open(PoseEstimate)
        stamp, robot = stamp_of(message.timestamp), heard.address["robot"]
        if stamp is None:
            return
        news = self._state.get(robot) != message.state
        if not self._pace.due(f"pose/{robot}", stamp) and not news:
            return
        self._state[robot] = message.state
        pose = from_message(message.pose)
        if not message.track_id or not np.all(np.isfinite(pose)):
            self._forget(robot, stamp)
            return
        self._draw_robot(robot, stamp, pose, message)
        if message.state == STATE_LOCALIZED:
            seen = self._seen[robot] = Sighting(stamp, pose)
            for owner, lidar in list(self._scans):
                if owner == robot:
                    self._draw_scan(robot, lidar, seen)
        else:
            self._hide_scans(robot, stamp)

    def draw_truth(self, heard: Envelope) -> None:
        """The true pose, where a simulator or a reference says it."""
        message = heard.open(PoseInFrame)
        stamp, robot = stamp_of(message.timestamp), heard.address["robot"]
        pose = from_pose3(message.pose)
        if stamp is None or not np.all(np.isfinite(pose)) or not self._pace.due(f"truth/{robot}", stamp):
            return
        self._canvas.draw(
            stamp, f"world/robots/{robot}/truth", *_arrow(pose, TRUTH, 0.06, ARROW_M, label="truth")
        )

    def _draw_robot(self, robot: str, stamp: int, pose: Array, message: PoseEstimate) -> None:
        colour = STATE_COLOURS.get(message.state, TRUTH)
        path = f"world/robots/{robot}/pose"
        label = f"{robot}: {state_name(message.state)} {message.confidence:.0%}"
        self._canvas.draw(stamp, path, *_arrow(pose, colour, 0.12, ARROW_M, label))
        covariance = covariance_from_message(message.covariance)
        if np.all(np.isfinite(covariance)):
            outline = lift(ellipse(pose, covariance), 0.08)
            self._canvas.draw(
                stamp,
                f"{path}/within_95_percent",
                rr.LineStrips3D([outline], colors=[colour], radii=rr.Radius.ui_points(1.5)),
            )

    def _draw_scan(self, robot: str, lidar: str, seen: Sighting) -> None:
        fitting = [
            scan
            for stamp, scan in self._scans[robot, lidar]
            if seen.stamp - SCAN_AGE_NS <= stamp <= seen.stamp
        ]
        if fitting:
            self._canvas.draw(
                seen.stamp,
                f"world/robots/{robot}/scan/{lidar}",
                rr.Points3D(
                    lift(scan_points(fitting[-1], seen.pose), 0.06),
                    colors=[SCAN],
                    radii=rr.Radius.ui_points(2.0),
                ),
            )

    def _forget(self, robot: str, stamp: int) -> None:
        path = f"world/robots/{robot}/pose"
        self._canvas.clear(stamp, path)
        self._canvas.clear(stamp, f"{path}/within_95_percent")
        self._hide_scans(robot, stamp)

    def _hide_scans(self, robot: str, stamp: int) -> None:
        self._seen.pop(robot, None)
        for owner, lidar in list(self._scans):
            if owner == robot:
                self._canvas.clear(stamp, f"world/robots/{robot}/scan/{lidar}")


def _arrow(
    pose: Array, colour: Colour, height: float, length: float, label: str
) -> tuple[rr.LineStrips3D, rr.Points3D]:
    """A disc with an arrow along the heading, and a label."""
    return (
        rr.LineStrips3D(arrows(pose, length, height), colors=[colour], radii=rr.Radius.ui_points(3.0)),
        rr.Points3D(
            lift(pose[:2], height),
            colors=[colour],
            radii=rr.Radius.ui_points(8.0),
            labels=[label],
            show_labels=True,
        ),
    )
