"""The robot's speed by odometry and by its scans, and its relocations."""

from __future__ import annotations

import math

import numpy as np
import rerun as rr
from eigenscan.geometry.pose import Array, between, covariance_from_message, from_message, from_pose3
from eigenscan.recorder.picture.canvas import Canvas, stamp_of
from eigenscan.recorder.picture.palette import HYPOTHESIS, REGION, SCAN, Colour
from eigenscan.recorder.picture.plots import Series
from eigenscan.recorder.picture.shapes import arrows, ellipse, is_place, lift
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.heading_pb2 import Heading
from eigenscan.schemas.recently_used import RecentlyUsed
from eigenscan.schemas.scan_pb2 import ScanMotion
from eigenscan.schemas.tracking_pb2 import Relocation
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

SHORTEST_S = 0.1
"""A speed is that between two poses at least so far apart: 50 Hz odometry in mm steps would be noise."""
LONGEST_S = 2.0
"""Between two poses farther apart nothing is plotted."""
RELOCATION_M = 1.8
"""Length of the arrow of a relocation: longer than the pose's own."""


class MotionPicture:
    """Plots speed (m/s, forward) and turn rate (degrees/s) of the base, by odometry and by each lidar."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self._series: RecentlyUsed[str, tuple[Series, Series]] = RecentlyUsed(_flush)
        self._before: RecentlyUsed[str, list[tuple[int, Array]]] = RecentlyUsed()
        self._headings: RecentlyUsed[str, list[tuple[int, float]]] = RecentlyUsed()

    def receive_odometry(self, received: Envelope) -> None:
        """Plots the speed since the last pose that was plotted."""
        message, robot = received.open(Odometry), received.address["robot"]
        stamp, pose = stamp_of(message.timestamp), from_pose3(message.pose)
        if stamp is None or not is_place(pose):
            return
        last = self._before.use(robot, list)
        if last and 0 <= stamp - last[0][0] < SHORTEST_S * 1e9:
            return
        if last and 0 < stamp - last[0][0] < LONGEST_S * 1e9:
            self._add(robot, "odometry", HYPOTHESIS, stamp, between(last[0][1], pose), stamp - last[0][0])
        last[:] = [(stamp, pose)]

    def receive_heading(self, received: Envelope) -> None:
        """Plots the turn rate since the last heading that was plotted."""
        message, robot = received.open(Heading), received.address["robot"]
        stamp, since = stamp_of(message.timestamp), stamp_of(message.since)
        if stamp is None or since is None or not math.isfinite(message.heading):
            return
        last = self._headings.use(robot, list)
        if last and 0 <= stamp - last[0][0] < SHORTEST_S * 1e9:
            return
        if last and since <= last[0][0] and 0 < stamp - last[0][0] < LONGEST_S * 1e9:
            turned = np.array([math.nan, math.nan, message.heading - last[0][1]])
            self._add(robot, "gyroscope", REGION, stamp, turned, stamp - last[0][0])
        last[:] = [(stamp, message.heading)]

    def receive_scan_motion(self, received: Envelope) -> None:
        """Plots the speed between two scans; a gap where they do not fit each other."""
        message, where = received.open(ScanMotion), received.address
        stamp, since = stamp_of(message.timestamp), stamp_of(message.since)
        if stamp is None or since is None or since >= stamp:
            return
        moved = from_message(message.motion) if message.HasField("motion") else np.full(3, math.nan)
        self._add(where["robot"], f"scans of {where['lidar']}", SCAN, stamp, moved, stamp - since)

    def flush(self) -> None:
        """Sends waiting rows."""
        for _, pair in self._series.items():
            _flush(pair)

    def _add(self, robot: str, source: str, colour: Colour, stamp: int, moved: Array, took_ns: int) -> None:
        name = f"{robot}: by {source}"
        path = f"{robot}/{source.replace(' ', '_')}"
        speed, turn = self._series.use(
            path,
            lambda: (
                Series(self._canvas, f"motion/speed/{path}", [name], [colour]),
                Series(self._canvas, f"motion/turn/{path}", [name], [colour]),
            ),
        )
        speed.add(stamp, float(moved[0]) / (took_ns * 1e-9))
        turn.add(stamp, math.degrees(float(moved[2])) / (took_ns * 1e-9))


def _flush(pair: tuple[Series, Series]) -> None:
    for series in pair:
        series.flush()


class RelocationPicture:
    """Draws a robot's last relocation, and a line among the events.

    `brief`: the line alone; the arrows of many robots would hide the map.
    """

    def __init__(self, canvas: Canvas, brief: bool = False) -> None:
        self._canvas, self._brief = canvas, brief

    def draw(self, received: Envelope) -> None:
        """Draws an arrow with its 95 % ellipse; nothing for a search of the whole site."""
        message, robot = received.open(Relocation), received.address["robot"]
        stamp = stamp_of(message.timestamp) or self._canvas.newest
        if not stamp:
            return
        path, pose = f"world/robots/{robot}/relocation", from_message(message.pose)
        words = f"{robot}: relocated: search the whole site"
        self._canvas.clear(stamp, path)
        if message.HasField("pose") and is_place(pose):
            covariance = covariance_from_message(message.covariance)
            if not self._brief:
                drawn = self._canvas.local(pose)
                outline = [lift(ellipse(drawn, covariance), 0.09)] if is_place(covariance) else []
                self._canvas.style(path, _style)
                self._canvas.draw(
                    stamp, path, rr.LineStrips3D([*arrows(drawn, RELOCATION_M, 0.09), *outline])
                )
            place = f"{pose[0]:.2f}, {pose[1]:.2f}, {math.degrees(pose[2]):.0f} deg"
            words = f"{robot}: relocated to {place}"
        self._canvas.draw(stamp, f"events/{robot}", rr.TextLog(words, level=rr.TextLogLevel.INFO))


def _style() -> tuple[rr.LineStrips3D]:
    return (rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(2.0), colors=[SCAN]),)
