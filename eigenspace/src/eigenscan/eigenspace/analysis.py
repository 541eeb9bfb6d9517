"""The analysis of a region, which gives builder, projector and pictures the same eigenspaces.

A lidar of any step is sampled at 2 degrees. So an eigenspace depends on the region's panoramas, the embedding
with its cap, the number of beams at that step, and the number of components.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from eigenscan.eigenspace.components import Eigenspace, analyse, coefficients, error_squares
from eigenscan.eigenspace.embedding import Embedding
from eigenscan.eigenspace.panorama import Sensor
from eigenscan.geometry.circle import TURN
from numpy.typing import NDArray

ANALYSIS_TURN = 180
"""Beams and headings of a full turn in the analysis: steps of 2 degrees."""
COMPONENTS = 16
"""Principal components kept: docs/reports.md."""
SEARCH_SPACING = 0.5
"""Distance between positions that are searched in eigenspace, m; finer positions refine a result."""
HEADING_STRIDE = 3
"""Headings of the analysis grid from one searched heading to the next: 6 degrees."""
USUAL_SHARE = 0.999
"""Share of a region's own scans whose error counts as usual."""


@dataclass(frozen=True)
class Analysis:
    """Parameters of a region's eigenspace besides its panoramas: J `beams`, M `components`."""

    embedding: Embedding = field(default_factory=lambda: Embedding.of("ring"))
    beams: int = ANALYSIS_TURN // 2 + 1
    components: int = COMPONENTS

    def of(self, sensor: Sensor) -> Analysis:
        """The same for another lidar. The direction of its first beam does not matter."""
        coarse, cap = coarse_sensor(sensor), self.embedding.cap
        if coarse.range_max > 0:
            cap = min(cap, coarse.range_max)
        return replace(self, embedding=replace(self.embedding, cap=cap), beams=coarse.beams)

    @property
    def name(self) -> str:
        """One chunk of a key and of a file's name, such as `ring12-91`; no two analyses of a site share one.

        Six digits name a cap in single precision, as drivers state it; any other one has all digits and a d.
        """
        cap = self.embedding.cap
        text = f"{cap:g}" if float(np.float32(f"{cap:g}")) == cap else f"{cap!r}d"
        return f"{self.embedding.kind}{text}-{self.beams}"


@dataclass(frozen=True)
class RegionSpace:
    """A region's eigenspace for one kind of lidar.

    `usual_error`, m^2: nearly every scan taken in the region has an error vector of less mean square.
    """

    embedding: Embedding
    space: Eigenspace
    usual_error: float

    @property
    def analysis(self) -> Analysis:
        """The analysis that made this space."""
        return Analysis(self.embedding, self.space.beams, len(self.space.eigenvalues))


@lru_cache(maxsize=64)  # of few lidars, several times a scan
def coarse_sensor(sensor: Sensor) -> Sensor:
    """The sensor at the analysis step, over the same field of view."""
    step = 2.0 * np.pi / ANALYSIS_TURN
    span = sensor.angle_increment * (sensor.beams - 1)
    # half a beam more counts as one more, for any rounding
    beams = min(int(np.floor(span / step + 0.5 + 1e-9)) + 1, ANALYSIS_TURN)
    return Sensor(sensor.angle_min, step, beams, sensor.range_max)


def beams_of(field_of_view: float) -> int:
    """J of a lidar that sees `field_of_view`, rad."""
    return coarse_sensor(Sensor.facing(field_of_view, TURN / ANALYSIS_TURN)).beams


def searched(index: NDArray[np.int32], spacing: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which positions are searched (S,), of grid indices (P, 2) `spacing` m apart, and their cells (S, 2).

    Cells are SEARCH_SPACING wide, or as wide as the grid; the first position in each is searched.
    """
    stride = max(1, round(SEARCH_SPACING / spacing))
    cells, at = np.unique(index // stride, axis=0, return_index=True)
    return at, cells.astype(np.int64)


def region_space(
    panoramas: NDArray[np.float32], at: NDArray[np.int64], analysis: Analysis
) -> tuple[RegionSpace, NDArray[np.float32]]:
    """Eigenspace of panoramas (P, ANALYSIS_TURN), m, and the coefficients of those `at` (S,).

    The panoramas are those of `sampled`. Raises ValueError without panoramas.
    """
    embedding = analysis.embedding
    channels = embedding(panoramas)
    space = analyse(channels, analysis.beams, analysis.components)
    held = sampled(panoramas[at], embedding, space)
    square = error_squares(channels[:, at], space, held, HEADING_STRIDE)
    usual = float(np.float32(np.quantile(square, USUAL_SHARE)))
    return RegionSpace(embedding, space, usual), held


def sampled(panoramas: NDArray[np.float32], embedding: Embedding, space: Eigenspace) -> NDArray[np.float32]:
    """Coefficients (S, H, M) of panoramas (S, N) at every HEADING_STRIDE-th heading (paper, section 4)."""
    return coefficients(embedding(panoramas), space, HEADING_STRIDE)
