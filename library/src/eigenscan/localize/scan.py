"""One sweep of a lidar, as a caller has it and as the cores take it."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.pose import to_message
from eigenscan.ingest.core import WHY, ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.schemas.channels import DEFAULT_ROBOT, DEFAULT_SITE, SCAN_RAW, is_chunk
from eigenscan.schemas.envelope import LATEST_S, Envelope, nanoseconds, stamp
from eigenscan.schemas.scan_pb2 import RawScan
from numpy.typing import ArrayLike, NDArray

_SET_ASIDE = "set_aside_"
_UNITS = {
    "angle_min": "rad", "angle_increment": "rad", "range_max": "m", "range_min": "m", "time": "finite, s",
    "time_increment": "s", "stamped_after": "s",
}  # fmt: skip


class ScanError(ValueError):
    """A scan that cannot be used; the message names the fault."""


@dataclass(frozen=True, repr=False, eq=False)
class Scan:
    """A sweep: beam j looks along `angle_min + j * angle_increment` in the sensor's frame.

    `ranges` (B,) in m; +inf, or `range_max` (0: not stated) and more: no return; NaN, 0, masked, or below
    `range_min`: missing.
    Angles in rad, counter-clockwise seen from above; an increment may be negative. `mount`: the sensor in
    the robot's base frame, m, m, rad. For tracking only: `time` in s; the name `lidar`, of one of several;
    `time_increment`, s from beam to beam in their order (0: not stated), by which beams are deskewed to
    `time`; `stamped_after`, s from the beam measured first to `time`.
    """

    ranges: ArrayLike
    angle_min: float
    angle_increment: float
    range_max: float
    range_min: float = 0.0
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    time: float = 0.0
    lidar: str = "lidar"
    time_increment: float = 0.0
    stamped_after: float = 0.0

    def __post_init__(self) -> None:
        """Raises ScanError where a field has another shape, or is no number."""
        self._row()
        try:
            shape: tuple[int, ...] = np.shape(self.mount)
        except ValueError:  # rows of unlike length
            shape = ()
        if shape != (3,):
            raise ScanError(f"mount = {self.mount!r}: give x, y and heading in the robot's frame, m, m, rad")
        for name, unit in _UNITS.items():
            value = getattr(self, name)
            if not is_number(value) or (unit.startswith("finite") and not math.isfinite(value)):
                raise ScanError(f"{name} = {value!r:.80}: give a number, {unit}")
        if not all(map(is_number, np.asarray(self.mount).tolist())):
            raise ScanError(f"mount = {self.mount!r:.80}: give numbers, m, m, rad")
        if not (isinstance(self.lidar, str) and is_chunk(self.lidar)):
            raise ScanError(f"lidar = {self.lidar!r:.80}: give its name, a str without blanks or / * $ # ? @")
        if abs(self.time) > LATEST_S:
            raise ScanError(f"time = {self.time:g}: beyond the year 2096: give s, not ms or ns")
        for name, angle in (("angle_min", self.angle_min), ("mount's heading", self.mount[2])):
            if abs(angle) > 2.0 * TURN:
                raise ScanError(f"{name} = {angle:g}: more than two turns: give rad, not degrees")

    def __repr__(self) -> str:
        ranges = self._row()
        ends = np.degrees([self.angle_min, self.angle_min + (len(ranges) - 1) * self.angle_increment])
        within = f" within {self.range_max:g} m" if self.range_max else ""
        return (
            f"<Scan: {len(ranges)} beams from {ends[0]:.1f} to {ends[1]:.1f} degrees, "
            f"{np.count_nonzero(self.returns)} with a return{within}, time {self.time:g} s>"
        )

    @property
    def returns(self) -> NDArray[np.bool_]:
        """Which beams (B,) came back: not those beyond `range_max`, unless it is 0, not stated."""
        ranges = self._row()
        most = self.range_max or np.inf
        found: NDArray[np.bool_] = (ranges > self.range_min) & (ranges < most)
        return found

    def _row(self) -> NDArray[np.float32]:
        """The ranges, one a beam."""
        try:
            given: np.ma.MaskedArray[Any, Any] = np.ma.asarray(self.ranges)
            if given.dtype.kind not in "iufO":
                raise TypeError(f"{given.dtype}")
            with np.errstate(over="ignore"):  # what is too large is no return
                ranges = np.ma.filled(given.astype(np.float32), np.nan)
        except (TypeError, ValueError, OverflowError) as error:
            raise ScanError(f"ranges are no numbers in m: {error}") from None
        if ranges.ndim != 1:
            hint = ", such as ranges[0]" if ranges.ndim == 2 else ""
            raise ScanError(f"ranges of shape {ranges.shape}: give one row, one range a beam{hint}")
        return ranges

    @classmethod
    def of(cls, raw: RawScan, lidar: str = "lidar") -> Scan:
        """The same as the contract's message."""
        mount = raw.mount.x, raw.mount.y, raw.mount.theta
        turned = -1.0 if raw.upside_down else 1.0
        return cls(
            np.fromiter(raw.ranges, np.float32, len(raw.ranges)),
            angle_min=turned * raw.angle_min,
            angle_increment=turned * raw.angle_increment,
            range_max=raw.range_max,
            range_min=raw.range_min,
            mount=mount,
            time=nanoseconds(raw.timestamp) * 1e-9,
            lidar=lidar,
            time_increment=raw.time_increment,
            stamped_after=raw.stamped_after,
        )

    @property
    def stamp(self) -> int:
        """`time` in ns."""
        return round(self.time * 1e9)

    def raw(self) -> RawScan:
        """The scan as a driver publishes it."""
        return RawScan(
            timestamp=stamp(self.stamp),
            mount=to_message(self.mount),
            angle_min=self.angle_min,
            angle_increment=self.angle_increment,
            range_min=self.range_min,
            range_max=self.range_max,
            ranges=self._row().tolist(),
            time_increment=self.time_increment,
            stamped_after=self.stamped_after,
        )

    def canonical(self) -> Envelope:
        """The scan as scan-ingest publishes it if it is the first. Raises ScanError if it cannot be used."""
        return taken(ScanIngestCore(ScanIngestSettings()), self)[-1]


def is_number(value: object) -> bool:
    """Whether it is a number that a float holds: one of Python's own may be too large."""
    if not isinstance(value, Real):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def taken(ingest: ScanIngestCore, scan: Scan) -> list[Envelope]:
    """What a scan-ingest publishes of a scan, that itself last. Raises ScanError if it sets it aside."""
    before = _set_aside(ingest)
    address = {"site": DEFAULT_SITE, "robot": DEFAULT_ROBOT, "lidar": scan.lidar}
    published = list(ingest.handle(Envelope(SCAN_RAW, address, scan.raw())))
    if not published:
        (reason,) = _set_aside(ingest) - before
        raise ScanError(f"scan of {len(scan.raw().ranges)} beams cannot be used: {WHY[reason]}")
    return published


def _set_aside(ingest: ScanIngestCore) -> Counter[str]:
    """Scans set aside so far, by reason."""
    counters = ingest.condition().counters.items()
    return Counter({name.removeprefix(_SET_ASIDE): n for name, n in counters if name.startswith(_SET_ASIDE)})
