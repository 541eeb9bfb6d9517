"""Poses of a robot's frames, from its transforms (REP 105)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

FARTHEST = 1e9  # m; map coordinates may be large, damaged bytes are larger
MOST_FRAMES = 2000
"""That a robot names; further ones are ignored."""
HORIZONTAL = 0.94
"""Cosine, 20 deg: a lidar tilted by more does not see the plane that the map shows."""


class TransformTree:
    """The first transform received of each frame to its parent."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Matrix]] = {}

    def receive(
        self, parent: str, child: str, translation: Sequence[float], rotation: Sequence[float]
    ) -> None:
        """`rotation` is x, y, z, w. Invalid values are ignored."""
        turned = rotation_matrix(rotation)
        if turned is None or not is_place(translation) or child in self._parents:
            return
        if len(self._parents) >= MOST_FRAMES:
            return
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turned, translation
        self._parents[child] = (parent, matrix)

    def frames(self) -> list[str]:
        """All frames that were named, in the order received."""
        return list(
            dict.fromkeys(frame for child, (parent, _) in self._parents.items() for frame in (parent, child))
        )

    def has_children(self, frame: str) -> bool:
        """Whether a transform to `frame` was received."""
        return any(parent == frame for parent, _ in self._parents.values())

    def between(self, base: str, frame: str) -> Matrix | None:
        """Pose (4, 4) of `frame` in `base`; None if they are not connected."""
        from_base, from_frame = self._line(base), self._line(frame)
        for ancestor, to_frame in from_frame.items():
            if ancestor in from_base:
                joined: Matrix = np.linalg.inv(from_base[ancestor]) @ to_frame
                return joined
        return None

    def _line(self, frame: str) -> dict[str, Matrix]:
        """Pose of `frame` in each of its ancestors, itself first."""
        line = {frame: np.eye(4)}
        matrix = line[frame]
        while frame in self._parents:
            frame, step = self._parents[frame]
            if frame in line:
                break
            matrix = step @ matrix
            line[frame] = matrix
        return line


def is_place(coordinates: Sequence[float]) -> bool:
    """Whether these are metres that a robot may be at: finite, and not damage."""
    return bool(np.all(np.abs(np.asarray(coordinates, dtype=np.float64)) < FARTHEST))


def rotation_matrix(quaternion: Sequence[float]) -> Matrix | None:
    """Rotation (3, 3) of a quaternion x, y, z, w of any length; None if it is invalid."""
    q = np.asarray(quaternion, dtype=np.float64)
    if not np.all(np.abs(q) < FARTHEST) or np.linalg.norm(q) < 1e-6:
        return None
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def planar(matrix: Matrix) -> tuple[NDArray[np.float64], bool] | None:
    """Pose (3,) on the plane and whether the frame is upside down; None if it is tilted."""
    if abs(matrix[2, 2]) < HORIZONTAL:
        return None
    pose = np.array([matrix[0, 3], matrix[1, 3], np.arctan2(matrix[1, 0], matrix[0, 0])])
    return pose, bool(matrix[2, 2] < 0.0)
