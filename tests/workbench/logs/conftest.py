from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.gridmap import OCCUPIED, read_map
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.logs import Log
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation, Slerp

from tests.environment import DATASETS

Pose = NDArray[np.float64]
PoseAt = Callable[[int], Pose | None]


@dataclass(frozen=True)
class Judge:
    """Shows how well scans fit a map from where the robot is known to have been."""

    dataset: Path

    def __post_init__(self) -> None:
        grid = read_map(self.dataset / "map.yaml")
        metres = distance_transform_edt(grid.cells != OCCUPIED) * grid.resolution
        object.__setattr__(self, "_grid", grid)
        object.__setattr__(self, "_metres", metres)

    def pose_at(self, reference: str) -> PoseAt:
        """Pose at a stamp as the reference file has it, interpolated by scipy."""
        rows = np.loadtxt(self.dataset / reference)
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        times, positions, turns = rows[:, 0], rows[:, 1:3], Slerp(rows[:, 0], Rotation.from_quat(rows[:, 4:]))

        def at(stamp: int) -> Pose | None:
            time = stamp * 1e-9
            right = int(np.clip(np.searchsorted(times, time), 1, len(times) - 1))
            if not times[0] <= time <= times[-1] or times[right] - times[right - 1] > 1.0:
                return None
            x, y = (np.interp(time, times, positions[:, axis]) for axis in (0, 1))
            return np.array([x, y, turns(time).as_euler("ZYX")[0]])

        return at

    def share(self, scan: RawScan, base: Pose, turned: float = 0.0) -> float:
        """Share of the returns that end within 15 cm of an occupied cell."""
        ranges = np.array(scan.ranges[:])
        limit = 0.99 * scan.range_max if scan.range_max else np.inf
        hit = np.isfinite(ranges) & (ranges > max(scan.range_min, 0.01)) & (ranges < limit)
        angle = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
        angle = (-angle if scan.upside_down else angle) + scan.mount.theta + turned
        sensor = np.column_stack([ranges * np.cos(angle), ranges * np.sin(angle)])[hit]
        # sensor in the base, base in the map: the angles above are in the base already
        points = sensor + np.array([scan.mount.x, scan.mount.y])
        c, s = np.cos(base[2]), np.sin(base[2])
        points = points @ np.array([[c, s], [-s, c]]) + base[:2]
        column, row = np.floor(self._grid.to_grid(points)).astype(int).T  # type: ignore[attr-defined]
        metres = np.pad(self._metres, 1, constant_values=9.0)  # type: ignore[attr-defined]
        height, width = metres.shape
        near = metres[np.clip(row + 1, 0, height - 1), np.clip(column + 1, 0, width - 1)]
        return float(np.mean(near < 0.15)) if hit.any() else 0.0

    def shares(self, log: Log, at: PoseAt, every: int, turned: float = 0.0) -> dict[str, float]:
        """Mean share by lidar, over every so many scans."""
        found: dict[str, list[float]] = defaultdict(list)
        for name, scan, stamp in every_scan(log, every):
            base = at(log.logged.get(stamp, stamp))
            if base is not None:
                found[name].append(self.share(scan, base, turned))
        return {name: float(np.mean(shares)) for name, shares in found.items() if len(shares) >= 20}


def every_scan(log: Log, every: int) -> Iterable[tuple[str, RawScan, int]]:
    """Name, scan and stamp of every so manieth scan of each lidar."""
    seen: dict[str, int] = defaultdict(int)
    for envelope in log.envelopes():
        if envelope.channel is SCAN_RAW:
            name = envelope.address["lidar"]
            seen[name] += 1
            if seen[name] % every == 0:
                yield name, envelope.open(RawScan), envelope.stamp


@pytest.fixture
def judge() -> Callable[[str], Judge]:
    return lambda dataset: Judge(DATASETS / dataset)
