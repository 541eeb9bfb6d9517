"""A scan as the projector uses it: on the analysis grid, and as points in the sensor's frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN, coarse_sensor
from eigenscan.eigenspace.panorama import Sensor
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.message_floats import floats_of
from eigenscan.geometry.normalize import FARTHEST
from eigenscan.schemas.scan_pb2 import Scan
from numpy.typing import NDArray

NEAREST = 0.25
"""Least range, m: a shorter beam met a cover or the robot itself."""
WIDEST = 1e3
"""rad, of the first beam: the contract has half a turn; a damaged number may be larger than any angle."""
WEIGHED_BEAMS = 120
"""Beams that are enough for the likelihood."""


@dataclass(frozen=True)
class Observation:
    """One scan. `ranges` (B,) float32 m on the sensor's own grid: +inf empty, NaN missing.

    `coarse` (J,) are the ranges nearest to the analysis grid, angle_min + j * 2 degrees, and
    `bearings` (J,) its angles in the sensor's frame.
    """

    sensor: Sensor
    ranges: NDArray[np.float32]
    coarse: NDArray[np.float32]
    bearings: NDArray[np.float64]

    @cached_property
    def used(self) -> NDArray[np.bool_]:
        """Beams (J,) of the analysis grid that came back."""
        return np.isfinite(self.coarse)

    @cached_property
    def returned(self) -> int:
        """How many beams of the analysis grid came back."""
        return int(np.count_nonzero(self.used))

    @cached_property
    def measured(self) -> int:
        """How many measurements these are: with beams farther apart than the grid's, several are of one."""
        back = (self.ranges >= NEAREST) & (self.ranges < FARTHEST)
        return min(self.returned, int(np.count_nonzero(back)))

    @cached_property
    def few(self) -> NDArray[np.int64]:
        """Indices (k,) of at most WEIGHED_BEAMS of the used beams, evenly spread."""
        used = np.flatnonzero(self.used)
        return np.ascontiguousarray(used[:: max(1, -(-len(used) // WEIGHED_BEAMS))])

    @cached_property
    def weighed(self) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Bearings (k,) and ranges (k,) of the `few`."""
        return self.bearings[self.few], self.coarse[self.few]

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """End points (n, 2) of the beams that came back, m, sensor frame."""
        r = self.coarse[self.used].astype(np.float64)
        angle = self.bearings[self.used]
        points = np.empty((len(r), 2))
        points[:, 0], points[:, 1] = r * np.cos(angle), r * np.sin(angle)
        return points


def by_reach(ranges: NDArray[np.float32] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights (n,) of beams with ranges (n,), m, 1 in the mean: the root of the range.

    Half-way between beams that count alike and stretches of wall that count by their length, for many beams
    on one near thing (a person) show little more than one.
    """
    root: NDArray[np.float64] = np.sqrt(ranges, dtype=np.float64)
    return root / max(float(root.mean()), 1e-9)


def windows_at(headings: NDArray[np.float64], angle_min: float) -> NDArray[np.int64]:
    """Windows (n,) of a panorama, 0 to ANALYSIS_TURN, nearest to what a sensor sees at headings (n,), rad."""
    return np.rint((headings + angle_min) * (ANALYSIS_TURN / TURN)).astype(np.int64) % ANALYSIS_TURN


def observe(scan: Scan) -> Observation:
    """Observation of a canonical scan. Raises ValueError for an invalid angular grid."""
    beams = len(scan.ranges)
    step = scan.angle_increment
    if not beams or not (0.0 < step <= np.pi and abs(scan.angle_min) <= WIDEST):
        raise ValueError(f"{beams} beams from {scan.angle_min} rad in steps of {step} rad")
    if not 0.0 <= scan.range_max < np.inf:
        raise ValueError(f"range_max = {scan.range_max} m")
    ranges = floats_of(scan, "ranges")
    sensor = Sensor(scan.angle_min, step, beams, scan.range_max)
    nearest, outside, bearings = _analysis_grid(sensor)
    coarse = ranges[nearest]
    coarse[outside] = np.nan
    coarse[coarse < NEAREST] = np.nan
    coarse[coarse >= FARTHEST] = np.inf  # a scan that no ingest made: sums in single precision would overflow
    return Observation(sensor, ranges, coarse, bearings)


@lru_cache(maxsize=64)
def _analysis_grid(sensor: Sensor) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.float64]]:
    """Of each beam (J,) of the analysis grid the sensor's nearest, whether there is none, its bearing."""
    grid, step = coarse_sensor(sensor), sensor.angle_increment
    offset = np.arange(grid.beams) * grid.angle_increment
    nearest = np.rint(offset / step).astype(np.int64)
    outside = nearest >= sensor.beams
    bearings = np.where(outside, offset / step, nearest) * step + sensor.angle_min
    bearings.flags.writeable = False  # shared by all scans of the sensor
    return np.minimum(nearest, sensor.beams - 1), outside, bearings
