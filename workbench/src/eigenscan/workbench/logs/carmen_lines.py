"""One line of a CARMEN log."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
from eigenscan.geometry.normalize import ScanError
from eigenscan.geometry.pose import between
from numpy.typing import NDArray

FRONT_KINDS = ("ROBOTLASER1", "FLASER", "RAWLASER1")
LIDAR_OF = {
    **dict.fromkeys(FRONT_KINDS, "front"),
    **dict.fromkeys(("ROBOTLASER2", "RLASER", "RAWLASER2"), "rear"),
    **{f"{kind}LASER{n}": f"laser{n}" for kind in ("ROBOT", "RAW") for n in (3, 4, 5)},
}
"""Lidar that a kind of scan line is of. Of kinds of the same lidar the first one in a log counts most."""

NS = 1_000_000_000

SICK_NO_RETURN = 81.83
"""From this range on, m, an LMS 200's number states why it has no range."""

KIND = re.compile(r"[A-Z][A-Z0-9_-]*")


class LineError(ScanError):
    """A line that cannot be read; `reason` is a counter's name."""


@dataclass(frozen=True)
class Geometry:
    """Directions and limit of a scan line: rad, rad, m."""

    angle_min: float
    angle_increment: float
    range_max: float


@dataclass(frozen=True)
class Line:
    """A line with a stamp: a scan, odometry, or both."""

    kind: str
    stamp: int  # ns, as logged
    odometry: NDArray[np.float64] | None = None  # (3,), the robot
    laser: NDArray[np.float64] | None = None  # (3,), the sensor in the same frame
    geometry: Geometry | None = None
    words: tuple[str, ...] = ()  # the ranges, unread

    def ranges(self) -> NDArray[np.float64]:
        """Ranges (B,), m. Raises LineError if one is no number."""
        try:
            return np.array(self.words, dtype=np.float64)
        except ValueError as error:
            raise LineError("garbage_line") from error

    def mount(self) -> NDArray[np.float64] | None:
        """Pose (3,) of the sensor in the robot's frame, m and rad, if the line has one."""
        if self.laser is None or self.odometry is None:
            return None
        return between(self.odometry, self.laser)


def read_line(text: str) -> Line | None:
    """Reads a line; None for a comment, or a kind without scans and odometry.

    Raises LineError if it is cut off or garbage.
    """
    words = text.split()
    if not words or words[0].startswith("#"):
        return None
    kind = words[0]
    try:
        if kind == "ODOM":
            return _odometry(words)
        if kind in ("FLASER", "RLASER"):
            return _old_laser(kind, words)
        if kind in LIDAR_OF:
            return _laser(kind, words)
    except ValueError as error:
        raise error if isinstance(error, LineError) else LineError("garbage_line") from error
    if not KIND.fullmatch(kind):
        raise LineError("garbage_line")
    return None


def _floats(words: list[str]) -> NDArray[np.float64]:
    return np.array(list(map(float, words)))


def _stamp(word: str) -> int:
    value = float(word)
    # the year 2096: 64 bits of nanoseconds end not long after
    if not 0.0 <= value < 4e9:
        raise LineError("absurd_stamp")
    # exact to the last digit, as a float is not
    exact = Decimal(word)
    # 1.13486e+09, six digits of an epoch: right to hours, so no time at all
    return 0 if int(exact.as_tuple().exponent) > 1 else round(exact * NS)


def _need(words: list[str], count: int) -> None:
    if len(words) < count:
        raise LineError("cut_line")


def _odometry(words: list[str]) -> Line:
    # ODOM x y theta tv rv accel ipc_timestamp host logger_timestamp
    _need(words, 9)
    return Line("ODOM", _stamp(words[7]), odometry=_floats(words[1:4]))


def _old_laser(kind: str, words: list[str]) -> Line:
    # FLASER n ranges x y theta odom_x odom_y odom_theta ipc_timestamp host logger_timestamp
    _need(words, 2)
    end = 2 + _count(words[1])
    _need(words, end + 8)
    return Line(
        kind,
        _stamp(words[end + 6]),
        odometry=_floats(words[end + 3 : end + 6]),
        laser=_floats(words[end : end + 3]),
        geometry=guess_geometry(end - 2),
        words=tuple(words[2:end]),
    )


def _laser(kind: str, words: list[str]) -> Line:
    # ROBOTLASERn type start fov resolution max accuracy remission n ranges n remissions
    #   [laser_pose robot_pose tv rv forward side axis] ipc_timestamp host logger_timestamp
    _need(words, 9)
    start, fov, resolution, range_max = _floats(words[2:6]).tolist()
    count = _count(words[8])
    end = 9 + count
    _need(words, end + 1)
    tail = end + 1 + _count(words[end])
    with_pose = kind.startswith("ROBOT")
    _need(words, tail + (13 if with_pose else 2))
    if resolution == 0.0 and count > 1:
        resolution = fov / (count - 1)
    return Line(
        kind,
        _stamp(words[tail + (11 if with_pose else 0)]),
        odometry=_floats(words[tail + 3 : tail + 6]) if with_pose else None,
        laser=_floats(words[tail : tail + 3]) if with_pose else None,
        geometry=Geometry(start, resolution, range_max),
        words=tuple(words[9:end]),
    )


def _count(word: str) -> int:
    value = int(word)
    if value < 0:
        raise LineError("garbage_line")
    return value


def guess_geometry(count: int) -> Geometry:
    """Directions of an old laser line, which has only the number of its ranges.

    SICK lasers look from -90 to +90 deg: 181 or 361 beams with both ends, 180 or 360 without the last.
    """
    if count in (400, 401):  # SICK at 0.25 deg sees 100 deg
        return Geometry(math.radians(-50.0), math.radians(0.25), SICK_NO_RETURN)
    if count in (681, 682, 683, 726, 768, 769):  # Hokuyo URG: 1024 steps a turn
        step = 2.0 * math.pi / 1024
        return Geometry(-0.5 * (count - 1) * step, step, 0.0)
    if count in (1080, 1081):  # Hokuyo UTM: 270 deg
        return Geometry(math.radians(-135.0), math.radians(0.25), 0.0)
    step = math.pi / max(count - count % 2, 1)
    return Geometry(-0.5 * math.pi, step, SICK_NO_RETURN)
