"""A whole set made ready for scans, and what each sensor would see of it."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np
from eigenscan.eigenspace.analysis import (
    ANALYSIS_TURN,
    HEADING_STRIDE,
    Analysis,
    RegionSpace,
    coarse_sensor,
    sampled,
)
from eigenscan.eigenspace.embedding import Embedding
from eigenscan.eigenspace.panorama import Sensor
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.geometry.raycast import RayCaster
from eigenscan.geometry.surfaces import Surfaces, faces_of
from eigenscan.projector.association.kinds import association
from eigenscan.projector.association.manifold import Association, Index, Sheets
from eigenscan.projector.association.ratios import Ratios
from eigenscan.projector.intervals import leaving
from eigenscan.projector.lattice import Lattice
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.share import own_share, shared_area
from eigenscan.projector.shelf import WholeSet
from eigenscan.projector.subspaces import Subspaces
from eigenscan.projector.verification import RANGE_CAP, predicted
from eigenscan.projector.wall_field import WallField
from numpy.typing import NDArray

KEPT_SENSORS = 8
"""Sensor grids whose subspaces are kept; the longest unused one goes first."""
Panoramas = NDArray[np.float32]

COARSE_CELL = 0.1
"""m, of the walls that many poses slide to."""


@dataclass(frozen=True)
class SensorView:
    """The site as one sensor sees it.

    A row of `association` is a pose: position `row_position` (n,) of the lattice and window `row_window` (n,)
    of its panorama; region r has the rows from `bounds[r]` to `bounds[r + 1]`.
    `usual_error` (R,): mean square of the error vector that nearly no scan of a region's own exceeds.
    `windows` (P, N + J) are the panoramas to verify against, `leaves` (P, N + J) where rays leave the walls.
    """

    embedding: Embedding
    spaces: Subspaces
    association: Association
    bounds: Index
    row_position: NDArray[np.int32]
    row_window: NDArray[np.int16]
    usual_error: NDArray[np.float64]
    windows: NDArray[np.float32]
    leaves: NDArray[np.float32]
    ratios: Ratios | None
    """Interpolates what was associated, where settings ask for it."""
    foreseen_by: str
    """What the obstacle mask compares a scan with: the setting `obstacles`."""


@dataclass(frozen=True)
class Reading:
    """Where the surfaces of the walls are taken to be: the distance to them, and rays."""

    walls: WallField
    caster: RayCaster


class Site:
    """The set in use, as far as this projector searches it.

    `readings`: where the walls' surfaces may be, in their middle and, where they are thick, at their faces;
    each scan tells which. `caster` is the first one's, `drawn` of the walls as the map draws them.
    `inexactness`, m: how far surfaces may be from there.
    `boxes` (R, 4): corners of the regions, x and y from, x and y to, m, map frame.
    Raises ModelError where its share is empty.
    """

    def __init__(self, whole: WholeSet, settings: ProjectorSettings) -> None:
        self.version, self.frame_id = whole.version, whole.frame_id
        own = own_share(whole.regions, settings.share)
        self.parts = settings.share[1]
        self.searched_area_m2 = shared_area(whole.regions, own, whole.free_area_m2)
        found = Surfaces.of(whole.grid)
        surfaces, self.inexactness = found.grid, found.inexactness
        field = DistanceField.of(whole.grid)
        self.drawn = WallField.of(field)
        as_drawn = Reading(self.drawn, RayCaster.of(whole.grid))
        self.readings: tuple[Reading, ...] = (as_drawn,)
        if surfaces is not whole.grid:
            middle = Reading(WallField.of(DistanceField.of(surfaces)), RayCaster.of(surfaces))
            faces = WallField.of(DistanceField.of(faces_of(whole.grid)))
            self.readings = middle, replace(as_drawn, walls=faces)
        self.caster = self.readings[0].caster
        self.coarse_walls = WallField.of(field, COARSE_CELL)
        self._models, self.analysis = own, own[0].space.analysis
        self.lattice = Lattice.of(own)
        self._enters, self._leaves = self._intervals()
        corners = [self.lattice.positions[positions] for positions in self.lattice.regions]
        self.boxes = np.array([[*points.min(axis=0), *points.max(axis=0)] for points in corners])
        self.regions = tuple(region.region for region in own)
        self._settings = settings
        self._views: OrderedDict[tuple[int, float], SensorView] = OrderedDict()
        self._sensors: dict[tuple[int, float], Sensor] = {}

    def _intervals(self) -> tuple[Panoramas, Panoramas]:
        """Where rays from the positions enter the walls as they are drawn, and where they leave them."""
        positions, surfaces = self.lattice.positions, self.lattice.panoramas
        leaves = leaving(self.drawn, positions, surfaces, RANGE_CAP)
        if len(self.readings) == 1:
            return surfaces, leaves
        drawn = self.readings[1].caster.panoramas(positions, ANALYSIS_TURN, RANGE_CAP)
        # a position within a wall as it is drawn tells nothing of where rays enter it
        return np.where(drawn > 0, np.minimum(drawn, surfaces), surfaces), leaves

    def area(self, regions: NDArray[np.bool_] | None) -> float:
        """Free area of some of the regions (R,), m2, or of all."""
        if regions is None:
            return self.searched_area_m2
        sizes = np.array([len(positions) for positions in self.lattice.regions])
        return float(self.searched_area_m2 * sizes[regions].sum() / sizes.sum())

    @property
    def sensors(self) -> list[Sensor]:
        """Sensors that were seen, the longest unused first."""
        return [self._sensors[key] for key in self._views]

    def view(self, sensor: Sensor) -> SensorView:
        """The site for `sensor`; made at its first scan. Where its first beam looks makes no difference."""
        coarse = coarse_sensor(sensor)
        key = (coarse.beams, coarse.range_max)
        if key not in self._views:
            self._views[key] = self._make(coarse)
            self._sensors[key] = sensor
            while len(self._views) > KEPT_SENSORS:
                oldest, _ = self._views.popitem(last=False)
                del self._sensors[oldest]
        self._views.move_to_end(key)
        return self._views[key]

    def _make(self, coarse: Sensor) -> SensorView:
        settings, lattice = self._settings, self.lattice
        analysis = self.analysis.of(coarse)
        spaces, regions = [], []
        for number, (which, cells) in enumerate(zip(lattice.searched, lattice.cells, strict=True)):
            own, held = self._space(number, analysis)
            spaces.append(own)
            regions.append(Sheets(held, lattice.positions[which], cells))
        searched = np.concatenate(lattice.searched).astype(np.int32)
        headings = np.arange(0, ANALYSIS_TURN, HEADING_STRIDE, dtype=np.int16)
        return SensorView(
            analysis.embedding,
            Subspaces.of([own.space for own in spaces]),
            association(settings.association, regions, settings.margin),
            np.cumsum([0, *(region.rows for region in regions)]),
            np.repeat(searched, len(headings)),
            np.tile(headings, len(searched)),
            np.array([own.usual_error for own in spaces]),
            predicted(self._enters, coarse.beams, coarse.range_max),
            predicted(self._leaves, coarse.beams, coarse.range_max),
            Ratios.of(regions) if settings.interpolation == "ratios" else None,
            settings.obstacles,
        )

    def _space(self, number: int, analysis: Analysis) -> tuple[RegionSpace, NDArray[np.float32]]:
        """The eigenspace of a region, as published or derived, and the coefficients of its searched poses."""
        model = self._models[number]
        if model.space.analysis != analysis:
            return model.derive(analysis)
        searched = self.lattice.panoramas[self.lattice.searched[number]]
        return model.space, sampled(searched, model.space.embedding, model.space.space)
