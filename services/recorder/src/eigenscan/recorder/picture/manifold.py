"""One region's eigenspace for display: its places as loops, in the space that the projector searches.

The basis is the model's own for the declared lidar; for another kind it is derived as in a projector. The
places of a scan and its candidates are published (`Hypotheses.projections` and `coefficients`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN, Analysis
from eigenscan.eigenspace.components import coefficients
from eigenscan.eigenspace.embedding import CIRCUMFERENCE
from eigenscan.eigenspace.model import RegionModel
from eigenscan.eigenspace.panorama import Sensor
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.pose import compose, from_message
from eigenscan.schemas.scan_pb2 import Scan
from numpy.typing import ArrayLike, NDArray

Array32 = NDArray[np.float32]

PLACES_DRAWN = 60
HEADINGS_DRAWN = 30
STEP = TURN / ANALYSIS_TURN
FARTHEST_M = 20.0
FAR_SHARE = 0.99


def analysis_of(model: RegionModel, scan: Scan) -> Analysis:
    """The analysis by which a projector searches the lidar's scans."""
    sensor = Sensor(scan.angle_min, scan.angle_increment, len(scan.ranges), scan.range_max)
    return model.space.analysis.of(sensor)


class Manifold:
    """First three coefficients (paper, eq. 2), m, of the places of a region, for one kind of lidar."""

    def __init__(self, model: RegionModel, analysis: Analysis) -> None:
        same = model.space.analysis == analysis
        self._own = model.space if same else model.derive(analysis)[0]
        self._positions = model.positions
        self._panoramas = model.analysed
        self.beams, self.components = analysis.beams, len(self._own.space.eigenvalues)
        near = np.minimum(self._panoramas, np.float32(FARTHEST_M))
        self.far = max(float(np.quantile(near, FAR_SHARE)), 1e-3)
        """Range, m, that hardly any beam exceeds here."""

    def cloud(self) -> Array32:
        """Points (n, 3): at most PLACES_DRAWN places of the region, at HEADINGS_DRAWN headings each."""
        count = len(self._panoramas)
        chosen = np.linspace(0, count - 1, min(PLACES_DRAWN, count)).astype(np.intp)
        turned = np.linspace(0, ANALYSIS_TURN, HEADINGS_DRAWN, endpoint=False).astype(np.intp)
        points: Array32 = self._turned(chosen)[:, turned].reshape(-1, 3)
        return points

    def loop(self, base: ArrayLike, scan: Scan) -> Array32:
        """Closed line (n, 3): the place of the grid nearest to the lidar of `scan`, at all its headings.

        `base` (3,) is the robot's.
        """
        lidar = compose(np.asarray(base, dtype=np.float64), from_message(scan.mount))
        nearest = ((self._positions - lidar[:2]) ** 2).sum(axis=1).argmin()
        loop = self._turned(np.array([nearest]))[0]
        return np.concatenate([loop, loop[:1]])

    def _turned(self, places: NDArray[np.intp]) -> Array32:
        """Points (P, ANALYSIS_TURN, 3) of places at all headings."""
        return three(coefficients(self._own.embedding(self._panoramas[places]), self._own.space))

    def eigenscans(self, number: int) -> tuple[Array32, Array32]:
        """The first eigenvectors (n, F, J), at most `number`, and their shares of the variance (n,)."""
        space = self._own.space
        shares = space.eigenvalues[:number] / np.float32(max(space.total_variance, 1e-9))
        return space.vectors[:number], shares

    def bearings(self, scan: Scan) -> Array32:
        """Bearings of the analysed beams (J,), rad, to the left."""
        steps = np.arange(self.beams, dtype=np.float32)
        return np.float32(scan.angle_min) + np.float32(STEP) * steps

    def seen(self, scan: Scan) -> Array32:
        """Ranges (J,) at the analysed bearings, m, clipped as in the analysis; NaN if there is none."""
        beam = np.rint(np.arange(self.beams) * (STEP / scan.angle_increment)).astype(np.intp)
        there = beam < len(scan.ranges)
        ranges = np.full(self.beams, np.nan, dtype=np.float32)
        ranges[there] = np.asarray(scan.ranges, dtype=np.float32)[beam[there]]
        return np.minimum(ranges, np.float32(self._own.embedding.cap))

    def kept(self, alpha: Sequence[float], seen: Array32) -> Array32:
        """Ranges (J,) that the coefficients `alpha` (M,) stand for (paper, eq. 3), m.

        A place on the ring is many ranges: the one nearest to what was `seen` (J,).
        """
        channels = self._own.space.reconstruct(np.asarray(alpha, dtype=np.float32))
        if len(channels) == 1:
            plain: Array32 = channels[0]
            return plain
        radius = np.float32(CIRCUMFERENCE / TURN)
        first = np.mod(np.arctan2(channels[1], channels[0]) * radius, np.float32(CIRCUMFERENCE))
        turns = np.rint((np.nan_to_num(seen, nan=0.0) - first) / CIRCUMFERENCE)
        ranges: Array32 = first + np.maximum(turns, 0.0).astype(np.float32) * np.float32(CIRCUMFERENCE)
        return ranges


def three(alphas: Array32) -> Array32:
    """The first three of coefficients (..., M); 0 for missing ones."""
    missing = max(3 - alphas.shape[-1], 0)
    padding = [(0, 0)] * (alphas.ndim - 1) + [(0, missing)]
    return np.pad(alphas[..., :3], padding)
