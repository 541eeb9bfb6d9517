"""One region's eigenspace as it is looked at: its places as loops, scans and poses as points.

Everything is projected here by the region's model, so that all points live in the same space, whatever
analysis a projector makes of it for its own sensor.
"""

from __future__ import annotations

import numpy as np
from eigenscan.eigenspace.components import all_coefficients
from eigenscan.eigenspace.model import RegionModel
from eigenscan.eigenspace.panorama import resample, windows
from eigenscan.eigenspace.ranges import RangeTransform
from eigenscan.geometry.pose import compose, from_message
from eigenscan.schemas import model_pb2
from eigenscan.schemas.scan_pb2 import Scan
from numpy.typing import ArrayLike, NDArray

Array32 = NDArray[np.float32]

PLACES_DRAWN = 60
HEADINGS_DRAWN = 30
LOOP_HEADINGS = 180
FAR_SHARE = 0.99


class Manifold:
    """First three coefficients (paper, eq. 2), m, of places, poses and scans."""

    def __init__(self, message: model_pb2.RegionModel) -> None:
        """Raises ModelError where the message is no sound model."""
        model = RegionModel.from_message(message)
        self.region = model.region
        self._sensor, self._space = model.sensor, model.space
        self._positions = model.positions
        self._transform = RangeTransform(model.range_cap)
        self._turn = model.sensor.turn
        self._values = self._transform(resample(model.panoramas, self._turn))
        self.far = max(float(np.quantile(self._values, FAR_SHARE)), 1e-3)
        """Range, m, that hardly any beam exceeds here."""

    def cloud(self) -> Array32:
        """Points (n, 3): at most PLACES_DRAWN places of the region, at HEADINGS_DRAWN headings each."""
        chosen = np.linspace(0, len(self._values) - 1, min(PLACES_DRAWN, len(self._values))).astype(np.intp)
        points: Array32 = self._turned(chosen, HEADINGS_DRAWN)[:, :-1].reshape(-1, 3)
        return points

    def loop(self, base: ArrayLike, scan: Scan) -> Array32:
        """Closed line (n, 3): the place of the grid nearest to the lidar of `scan`, at all its headings.

        `base` (3,) is the robot's.
        """
        place = self._nearest(compose(np.asarray(base, dtype=np.float64)[None], from_message(scan.mount)))
        loop: Array32 = self._turned(place, LOOP_HEADINGS)[0]
        return loop

    def _turned(self, places: NDArray[np.intp], headings: int) -> Array32:
        """Points (P, headings + 1, 3), the last of each like its first."""
        every = _three(all_coefficients(self._values[places], self._space))
        turned = np.linspace(0, self._turn, headings + 1).astype(np.intp) % self._turn
        points: Array32 = every[:, turned]
        return points

    def _nearest(self, sensors: NDArray[np.float64]) -> NDArray[np.intp]:
        offsets = sensors[:, None, :2] - self._positions
        nearest: NDArray[np.intp] = (offsets**2).sum(axis=-1).argmin(axis=1)
        return nearest

    @property
    def bearings(self) -> Array32:
        """Of the analysed beams (B,), rad, to the left."""
        steps = np.arange(self._sensor.beams, dtype=np.float32)
        return np.float32(self._sensor.angle_min) + np.float32(self._sensor.angle_increment) * steps

    def eigenscans(self, number: int) -> tuple[Array32, Array32]:
        """The first eigenvectors (n, B), at most `number`, and their shares of the variance (n,)."""
        shares = self._space.eigenvalues[:number] / np.float32(max(self._space.total_variance, 1e-9))
        return self._space.vectors[:number], shares

    def scan(self, scan: Scan) -> Array32:
        """The scan's point (3,). Beams that are missing, or beyond its field of view, count as the mean."""
        return _three(self._space.project(self._filled(self._values_of(scan))))

    def sight(self, scan: Scan) -> tuple[Array32, Array32]:
        """Ranges (B,), m, NaN where none was measured, and their reconstruction (paper, eq. 3)."""
        values = self._values_of(scan)
        return values, self._space.reconstruct(self._space.project(self._filled(values)))

    def _values_of(self, scan: Scan) -> Array32:
        """Values (B,) of the scan's beams at the analysed bearings; NaN where there is none."""
        beam = np.rint((self.bearings - scan.angle_min) / scan.angle_increment)
        seen = (beam >= 0) & (beam < len(scan.ranges))
        ranges = np.full(self._sensor.beams, np.nan)
        ranges[seen] = np.asarray(scan.ranges, dtype=np.float64)[beam[seen].astype(np.intp)]
        return self._transform(ranges)

    def _filled(self, values: Array32) -> Array32:
        return np.where(np.isnan(values), np.float32(self._space.mean), values)

    def poses(self, bases: ArrayLike, scan: Scan) -> Array32:
        """Points (n, 3) of what the lidar of `scan` would see with the robot's base at `bases` (n, 3).

        By the nearest place of the grid and the nearest heading.
        """
        sensors = compose(np.asarray(bases, dtype=np.float64).reshape(-1, 3), from_message(scan.mount))
        place = self._nearest(sensors)
        window = np.rint(self._sensor.window_of(sensors[:, 2], self._turn)).astype(np.intp) % self._turn
        return _three(self._space.project(windows(self._values[place], window, self._space.beams)))


def _three(coefficients: Array32) -> Array32:
    """The first three of (..., M); 0 for those that the model does not have."""
    missing = max(3 - coefficients.shape[-1], 0)
    padding = [(0, 0)] * (coefficients.ndim - 1) + [(0, missing)]
    return np.pad(coefficients[..., :3], padding)
