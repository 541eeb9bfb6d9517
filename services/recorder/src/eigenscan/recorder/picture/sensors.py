"""Draws on demand: a lidar's raw scans, and the coordinate frames."""

from __future__ import annotations

import numpy as np
import rerun as rr
from eigenscan.geometry.pose import FARTHEST_M, from_message, transform
from eigenscan.recorder.picture.canvas import Canvas, Pace, stamp_of
from eigenscan.recorder.picture.palette import OBSTACLE, SCAN
from eigenscan.recorder.picture.shapes import arrows, is_place, lift
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.recently_used import RecentlyUsed
from eigenscan.schemas.scan_pb2 import RawScan
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

MOST_FRAMES = 64
"""Most frames of a robot; each is one more entity."""
AXIS_M = 0.4


class RawScanPicture:
    """Draws raw scans as the driver gives them, in the robot's base frame: a wrong mount is seen at once."""

    def __init__(self, canvas: Canvas, pace: Pace) -> None:
        self._canvas, self._pace = canvas, pace

    def draw(self, received: Envelope) -> None:
        """Blue: ends of beams within the sensor's limits; red: beyond them; an arrow: its mount."""
        message, where = received.open(RawScan), received.address
        path = f"raw/{where['robot']}/{where['lidar']}"
        stamp, mount = stamp_of(message.timestamp), from_message(message.mount)
        if stamp is None or not is_place(mount) or not self._pace.due(path, stamp):
            return
        ranges = np.asarray(message.ranges, dtype=np.float64)
        angles = message.angle_min + message.angle_increment * np.arange(len(ranges))
        if message.upside_down:
            angles = -angles
        ends = np.stack([np.cos(angles), np.sin(angles)], axis=-1) * ranges[:, None]
        there = np.all(np.abs(ends) < FARTHEST_M, axis=-1) & (ranges > 0.0)
        within = (ranges >= message.range_min) & (ranges < (message.range_max or np.inf))
        colours = np.where(within[there, None], np.array(SCAN), np.array(OBSTACLE)).astype(np.uint8)
        self._canvas.style(path, _raw_style)
        self._canvas.draw(
            stamp,
            path,
            rr.Points3D(lift(transform(mount, ends[there]), 0.0), colors=colours),
            rr.LineStrips3D(arrows(mount, AXIS_M, 0.0)),
        )


class FramesPicture:
    """Draws coordinate frames as axes, each within its parent: the tree of entities is that of the frames."""

    def __init__(self, canvas: Canvas, pace: Pace) -> None:
        self._canvas, self._pace = canvas, pace
        self._parents: RecentlyUsed[str, dict[str, str]] = RecentlyUsed()

    def draw(self, received: Envelope) -> None:
        """The child's axes in its parent."""
        message, robot = received.open(FrameTransform), received.address["robot"]
        stamp = stamp_of(message.timestamp)
        parent, child = message.parent_frame_id, message.child_frame_id
        parents = self._parents.use(robot, dict[str, str])
        if stamp is None or (child not in parents and len(parents) >= MOST_FRAMES):
            return
        parents[child] = parent
        path = self._path(robot, child, parents)
        moved = [getattr(message.translation, axis) for axis in "xyz"]
        turned = [getattr(message.rotation, axis) for axis in "xyzw"]
        if not is_place(moved) or not is_place(turned) or not self._pace.due(path, stamp):
            return
        self._canvas.style(path, _axes_style)
        self._canvas.draw(
            stamp, path, rr.Transform3D(translation=moved, quaternion=rr.Quaternion(xyzw=turned))
        )

    def _path(self, robot: str, child: str, parents: dict[str, str]) -> str:
        """The child's path below all its known parents; a cycle is cut."""
        names = [child]
        while (parent := parents.get(names[0])) is not None and parent not in names:
            names.insert(0, parent)
        return "/".join([f"frames/{robot}", *(rr.escape_entity_path_part(name or "-") for name in names)])


def _raw_style() -> tuple[rr.Points3D, rr.LineStrips3D]:
    return (
        rr.Points3D.from_fields(radii=rr.Radius.ui_points(2.0)),
        rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(2.0), colors=[SCAN]),
    )


def _axes_style() -> tuple[rr.TransformAxes3D]:
    return (rr.TransformAxes3D(AXIS_M),)
