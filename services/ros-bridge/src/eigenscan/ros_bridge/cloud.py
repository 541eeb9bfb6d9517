"""From the points of a 3D lidar or a depth camera to a scan: the nearest of each direction in a slice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from eigenscan.geometry.pose import Array, to_message
from eigenscan.ros_bridge.inbound import frame_name
from eigenscan.schemas.envelope import stamp
from eigenscan.schemas.scan_pb2 import RawScan

BEAMS = 720
"""Of a full turn: 0.5 deg, no finer than usual 3D lidars turn."""
_FLOATS = {7: "f4", 8: "f8"}
"""sensor_msgs/PointField's types that a coordinate may have."""


class CloudError(ValueError):
    """A message that no scan can be made of; `reason` is a counter's name, the message names the fix."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(frozen=True)
class Slice:
    """Heights above the robot's base, m."""

    low: float
    high: float

    def scan(self, body: Any, time: int, matrix: Array) -> tuple[RawScan, int]:
        """Of a PointCloud2, and how many points of it are not finite.

        `matrix` (4, 4) is the sensor in the base frame, however it is tilted. A direction without a point
        is unknown. Raises CloudError.
        """
        points = coordinates(body)
        finite = np.isfinite(points).all(axis=1)
        from_sensor = points[finite] @ matrix[:3, :3].T
        height = from_sensor[:, 2] + matrix[2, 3]
        flat = from_sensor[(height >= self.low) & (height <= self.high), :2]
        distance = np.hypot(flat[:, 0], flat[:, 1])
        flat, distance = flat[distance > 0.0], distance[distance > 0.0]
        if distance.size == 0:
            raise CloudError(
                "cloud_without_points",
                f"no point of {frame_name(body.header.frame_id)} is {self.low:g} to {self.high:g} m above "
                "the base: set slice_low and slice_high",
            )
        step = 2.0 * np.pi / BEAMS
        beam = np.rint((np.arctan2(flat[:, 1], flat[:, 0]) + np.pi) / step).astype(int) % BEAMS
        nearest = np.full(BEAMS, np.inf)
        np.minimum.at(nearest, beam, distance)
        message = RawScan(
            timestamp=stamp(time),
            frame_id=frame_name(body.header.frame_id),
            # the beams are counted from the base's direction
            mount=to_message((matrix[0, 3], matrix[1, 3], 0.0)),
            angle_min=-np.pi,
            angle_increment=step,
            ranges=np.where(np.isinf(nearest), np.nan, nearest).tolist(),
        )
        return message, int(np.count_nonzero(~finite))


def coordinates(body: Any) -> Array:
    """x, y and z (N, 3) of a PointCloud2's points. Raises CloudError where they cannot be read."""
    fields = {str(field.name): field for field in body.fields}
    try:
        kinds = [_FLOATS[int(fields[axis].datatype)] for axis in "xyz"]
    except KeyError as error:
        raise CloudError("not_a_cloud", f"a cloud needs float fields x, y and z; missing: {error}") from error
    step, width, height, row = map(int, (body.point_step, body.width, body.height, body.row_step))
    offsets = [int(fields[axis].offset) for axis in "xyz"]
    ends = [offset + np.dtype(kind).itemsize for offset, kind in zip(offsets, kinds, strict=True)]
    data = np.asarray(body.data, dtype=np.uint8)
    fits = width > 0 and max(ends) <= step and width * step <= row  # else a point may be as long as no row
    if not fits or data.size != row * height or data.size == 0:
        raise CloudError(
            "not_a_cloud",
            f"{data.size} bytes for {height} rows of {row} bytes, {width} points of {step} bytes each",
        )
    order = ">" if body.is_bigendian else "<"
    point = np.dtype(
        {
            "names": list("xyz"),
            "formats": [order + kind for kind in kinds],
            "offsets": offsets,
            "itemsize": step,
        }
    )
    rows = np.ascontiguousarray(data.reshape(height, row)[:, : width * step])
    points = rows.reshape(-1).view(point)
    return np.stack([points[axis].astype(np.float64) for axis in "xyz"], axis=1)
