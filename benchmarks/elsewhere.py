"""Another building: what a robot's lidar and odometry show once it has been carried off the map."""

from functools import cached_property
from pathlib import Path

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.pose import compose, from_pose3, to_pose3
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.evaluation.log import Log, read_log
from eigenscan.workbench.evaluation.windows import Window
from eigenscan.workbench.logs import LogOptions
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from numpy.typing import NDArray

Array = NDArray[np.float64]

ELSEWHERE = {
    "intel": "fr079/log.clf.gz",
    "aces": "intel/log.clf.gz",
    "fr079": "intel/log.clf.gz",
    "jarvis": "olin_mac/rosbag2",
    "olin": "jarvis/jarvis_complex_path_fast.bag",
}
"""By log with one lidar, another building's whose lidar sees as much and as often."""


class Elsewhere:
    """A stretch of another building's log for each window of a log, as the log's own lidar would see it."""

    def __init__(self, path: Path | None) -> None:
        self._path = path

    @staticmethod
    def of(name: str, datasets: Path) -> "Elsewhere":
        """For a log of the datasets."""
        return Elsewhere(datasets / ELSEWHERE[name] if name in ELSEWHERE else None)

    @cached_property
    def _log(self) -> Log | None:
        """Read when a fault first needs it."""
        return read_log(self._path, LogOptions(), lambda _: None) if self._path else None

    def stretch(self, number: int, count: int, received: list[Envelope]) -> list[Envelope]:
        """The `number`-th of `count`, as long as what is `received`; empty where there is none."""
        if self._log is None:
            return []
        ours = next(e for e in received if e.channel is SCAN_RAW)
        stamps = [e.stamp for e in received]
        first, last, length = self._log.scans.min(), self._log.scans.max(), max(stamps) - min(stamps)
        start = int(first + (number + 0.5) / (count + 1) * (last - first))
        inside = self._log.between(Window(start, start + length))
        theirs = next(e.open(RawScan) for e in inside if e.channel is SCAN_RAW).mount
        mount = ours.open(RawScan).mount
        step = np.array([theirs.x - mount.x, theirs.y - mount.y, 0.0])
        return [_odometry(e, step) if e.channel is ODOMETRY else _scan(e, ours) for e in inside]


def _odometry(envelope: Envelope, step: Array) -> Envelope:
    """Of a base that carries its lidar where ours does."""
    message = Odometry()
    message.CopyFrom(envelope.open(Odometry))
    message.pose.CopyFrom(to_pose3(compose(from_pose3(message.pose), step)))
    return Envelope(ODOMETRY, envelope.address, message)


def _scan(envelope: Envelope, ours: Envelope) -> Envelope:
    """Each of our beams has the range of the nearest of theirs."""
    theirs, message = envelope.open(RawScan), RawScan()
    message.CopyFrom(ours.open(RawScan))
    message.timestamp.CopyFrom(theirs.timestamp)
    off = np.abs(wrap(_bearings(message)[:, None] - _bearings(theirs)))
    nearest = off.argmin(axis=1)
    ranges = np.asarray(theirs.ranges, dtype=np.float64)[nearest]
    ranges[off.min(axis=1) > theirs.angle_increment] = np.nan
    ranges[ranges >= message.range_max] = np.inf
    del message.ranges[:]
    message.ranges.extend(ranges.tolist())
    return Envelope(SCAN_RAW, ours.address, message)


def _bearings(scan: RawScan) -> Array:
    """In the base frame, rad."""
    side = -1.0 if scan.upside_down else 1.0
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges), dtype=np.float64)
    bearings: Array = scan.mount.theta + side * angles
    return bearings
