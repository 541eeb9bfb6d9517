"""Finds claims that differ from the reference although the scan supports them.

A reference made by SLAM has errors of its own. Such a claim still counts as false, but is listed separately.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.geometry.pose import compose, from_message, transform
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.workbench.evaluation.metrics import Judged
from numpy.typing import NDArray

ON_WALL_M = 0.15
"""A return that ends this near to a wall is on it."""
MORE = 0.25
"""Least increase of the share of returns on walls, from the reference to the claim."""
NEAR_M, NEAR_RAD = 1.5, np.radians(30.0)
"""A claim farther off is not doubtful: a similar place also has more returns on walls than a place that the
map lacks."""
LEAST_RETURNS = 30
RULE = (
    f"within {NEAR_M:g} m and {np.degrees(NEAR_RAD):.0f}° of it, with {100 * MORE:.0f} % more of the returns "
    f"within {100 * ON_WALL_M:.0f} cm of a wall than at the reference"
)


@dataclass(frozen=True)
class Walls:
    """Measures how well a scan fits at a pose."""

    field: DistanceField
    canonical: Callable[[Envelope], Scan | None]

    def share(self, scan: Scan, base: NDArray[np.float64]) -> float:
        """Share of the scan's returns on walls, from the base's pose (3,); NaN for too few returns."""
        return float(self.shares(scan, base[None])[0])

    def shares(self, scan: Scan, bases: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same (n,) from poses (n, 3)."""
        ranges = np.asarray(scan.ranges, dtype=np.float64)
        angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
        farthest = scan.range_max or np.inf  # 0: not stated
        seen = np.isfinite(ranges) & (ranges > 0) & (ranges < farthest)
        if np.count_nonzero(seen) < LEAST_RETURNS:
            return np.full(len(bases), np.nan)
        points = ranges[seen, None] * np.column_stack([np.cos(angles[seen]), np.sin(angles[seen])])
        lidars = compose(bases, from_message(scan.mount))
        ends = np.stack([transform(lidar, points) for lidar in lidars])
        shares: NDArray[np.float64] = np.mean(self.field.at(ends)[0] <= ON_WALL_M, axis=1)
        return shares


def doubtful(judged: Judged, scans: Iterable[Envelope], walls: Walls) -> Iterator[int]:
    """Rows of false claims for which the scan speaks more than for the reference, by RULE.

    `scans`: the raw scans of the run.
    """
    by_stamp = {scan.stamp: scan for scan in scans}
    for row in np.flatnonzero(judged.false_claims).tolist():
        raw = by_stamp.get(int(judged.stream.stamps[row]))
        if raw is None or judged.position_m[row] > NEAR_M or judged.heading_rad[row] > NEAR_RAD:
            continue
        scan = walls.canonical(raw)
        if scan is None:
            continue
        claim = judged.stream.poses[row]
        if walls.share(scan, claim) - walls.share(scan, claim - judged.offsets[row]) >= MORE:
            yield row
