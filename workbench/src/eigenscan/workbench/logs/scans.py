"""The scans of a whole log for the mapbuilder: outlines, mounts, and odometry if there is any."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path

import numpy as np
from eigenscan.geometry.pose import from_message, from_pose3
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.mapping.chain import Sweep
from eigenscan.mapbuilder.mapping.cloud import Outline
from eigenscan.schemas.channels import ODOMETRY, SCAN, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.workbench.evaluation.reference import Trajectory
from eigenscan.workbench.logs import LogError, LogOptions, open_log
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from numpy.typing import NDArray

NS = 1_000_000_000


@dataclass(frozen=True)
class Scans:
    """The usable scans of a log. `received`: number of all scans; `reasons`: numbers of rejected ones.

    `logged`: the logged stamp, ns, of each scan whose stamp was changed, by the new one. `damage`: as in Log.
    `counters`: what the log's reader counted.
    """

    sweeps: list[Sweep]
    received: int
    reasons: Mapping[str, int]
    logged: Mapping[int, int]
    damage: str = ""
    counters: Mapping[str, int] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Seconds from the first scan to the last."""
        return (self.sweeps[-1].stamp - self.sweeps[0].stamp) / NS if self.sweeps else 0.0

    @property
    def set_aside(self) -> str:
        """The rejected scans, as text."""
        return "".join(f"; {count} set aside: {reason}" for reason, count in sorted(self.reasons.items()))

    def spread(self, count: int) -> Scans:
        """`count` of the scans, evenly spread over the log."""
        chosen = np.unique(np.linspace(0, len(self.sweeps) - 1, count).astype(np.int64))
        return replace(self, sweeps=[self.sweeps[k] for k in chosen.tolist()])

    def span(self, first: int, last: int) -> str:
        """A stretch of scans, for people."""
        start, end = (self._stamp(number) for number in (first, last))
        if first == last:
            return f"the scan at {Decimal(start) / NS:.3f} s"
        return f"{last - first + 1} scans from {Decimal(start) / NS:.3f} to {Decimal(end) / NS:.3f} s"

    def trajectory(self, numbers: NDArray[np.int64], poses: NDArray[np.float64]) -> str:
        """TUM lines of poses (n, 3) of the base, with the stamps that the log gives its scans."""
        lines = ["# t x y z qx qy qz qw"]
        for number, (x, y, theta) in zip(numbers.tolist(), poses.tolist(), strict=True):
            turn = f"{np.sin(theta / 2):.9f} {np.cos(theta / 2):.9f}"
            lines.append(f"{Decimal(self._stamp(number)) / NS:.9f} {x:.6f} {y:.6f} 0 0 0 {turn}")
        return "\n".join(lines) + "\n"

    def _stamp(self, number: int) -> int:
        stamp = self.sweeps[number].stamp
        return self.logged.get(stamp, stamp)


def read_scans(
    path: Path,
    options: LogOptions,
    moved: Callable[[float], None],
    with_odometry: bool = True,
    received: list[Envelope] | None = None,
) -> Scans:
    """Reads the scans of any log that `eigenscan import` reads; `moved` is called with the progress, 0..1.

    Its messages are added to `received`, since to read a compressed log again takes its time.
    Raises LogError if the log cannot be read or has no usable scan.
    """
    opened, ingest = open_log(path, options), ScanIngestCore(ScanIngestSettings())
    scans: list[Scan] = []
    steps: list[tuple[int, NDArray[np.float64]]] = []
    for envelope in opened.envelopes():
        moved(opened.progress)
        if received is not None:
            received.append(envelope)
        if envelope.channel is ODOMETRY:
            steps.append((envelope.stamp, from_pose3(envelope.open(Odometry).pose)))
        elif envelope.channel is SCAN_RAW:
            scans += [
                published.open(Scan) for published in ingest.handle(envelope) if published.channel is SCAN
            ]
    moved(1.0)
    counters = ingest.condition().counters
    reasons = {
        name.removeprefix("set_aside_"): count
        for name, count in counters.items()
        if name.startswith("set_aside_")
    }
    count = counters["heard"]
    if not scans:
        raise LogError(
            f"{path}: none of its {count} scans can be used "
            f"({', '.join(sorted(reasons))}): check the topic with --lidar-topic"
        )
    stamps = np.array([nanoseconds(scan.timestamp) for scan in scans], dtype=np.int64)
    known = odometry_at(steps if with_odometry else (), stamps)
    sweeps = [_sweep(scan, place) for scan, place in zip(scans, known, strict=True)]
    return Scans(sweeps, count, Counter(reasons), dict(opened.logged), opened.damage, +opened.counters)


def odometry_at(
    steps: Iterable[tuple[int, NDArray[np.float64]]], stamps: NDArray[np.int64]
) -> list[NDArray[np.float64] | None]:
    """The odometry's pose (3,) at each stamp; None if it is unknown or not finite."""
    finite = {stamp: pose for stamp, pose in steps if np.isfinite(pose).all()}
    if not finite:
        return [None] * len(stamps)
    order = sorted(finite)
    way = Trajectory(np.array(order, dtype=np.int64), np.array([finite[stamp] for stamp in order]))
    poses, known = way.at(stamps)
    return [pose if sure else None for pose, sure in zip(poses, known.tolist(), strict=True)]


def _sweep(scan: Scan, odometry: NDArray[np.float64] | None) -> Sweep:
    ranges = np.array(scan.ranges)
    bearings = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    outline = Outline.of(ranges, bearings)
    return Sweep(nanoseconds(scan.timestamp), outline, from_message(scan.mount), odometry)
