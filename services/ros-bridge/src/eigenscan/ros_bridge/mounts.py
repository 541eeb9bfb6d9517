"""Finds the mounts of the lidars in tf."""

from __future__ import annotations

from typing import Any

import numpy as np
from eigenscan.geometry.transforms import TransformTree, planar
from eigenscan.ros_bridge.inbound import frame_name
from numpy.typing import NDArray

DEFAULT_BASE = "base_link"

Mount = tuple[NDArray[np.float64], bool]
"""Pose (3,) of the sensor in the base frame, and whether it is upside down."""


class MountError(ValueError):
    """A scan without a mount; `reason` is a counter's name, and the message has the fix."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


class Mounts:
    """The mounts of one robot. The first transform of each frame counts: lidars do not move on their base."""

    def __init__(self, base_frame: str | None, from_tf: bool, has_odometry: bool) -> None:
        self._given = base_frame is not None or not has_odometry
        self._base = base_frame if has_odometry or base_frame else DEFAULT_BASE
        self._from_tf = from_tf
        self._tree = TransformTree()
        self._known: dict[str, Mount] = {}

    def receive_base(self, frame: str) -> None:
        """The frame that odometry moves; it is the base unless the settings name another."""
        if not self._given and self._base != (frame or DEFAULT_BASE):
            self._base = frame or DEFAULT_BASE
            self._known.clear()

    def receive(self, item: Any) -> None:
        """Takes a TransformStamped between frames of the robot: not odometry, which moves."""
        move, turn = item.transform.translation, item.transform.rotation
        parent, child = frame_name(item.header.frame_id), frame_name(item.child_frame_id)
        self._tree.receive(parent, child, (move.x, move.y, move.z), (turn.x, turn.y, turn.z, turn.w))

    def carries(self, frame: str) -> bool:
        """Whether a frame that odometry moves has the robot on it: the base; any frame if none is given."""
        if self._given and self._base is not None:
            return frame == self._base or self._tree.between(frame, self._base) is not None
        return self._tree.has_children(frame)

    def of(self, frame: str) -> Mount:
        """The mount of the sensor with that frame. Raises MountError if there is none yet."""
        if not self._from_tf:
            return np.zeros(3), False
        if frame not in self._known:
            self._known[frame] = self._find(frame)
        return self._known[frame]

    def matrix(self, frame: str) -> NDArray[np.float64]:
        """The sensor (4, 4) in the base frame, however it is tilted. Raises MountError."""
        if not self._from_tf:
            return np.eye(4)
        if self._base is None:
            raise MountError(
                "no_base", "no odometry yet, in tf or on its topic, whose child is the robot's base"
            )
        matrix = np.eye(4) if frame == self._base else self._tree.between(self._base, frame)
        if matrix is None:
            raise MountError(
                "no_mount",
                f"no transform from {self._base} to {frame}: publish it on tf_static, "
                "or set mounts_from_tf to false and give scan-ingest the mounts",
            )
        return matrix

    def _find(self, frame: str) -> Mount:
        mount = planar(self.matrix(frame))
        if mount is None:
            raise MountError("tilted", f"{frame} is tilted: it does not see the plane that the map shows")
        return mount
