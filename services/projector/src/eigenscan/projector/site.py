"""A model set prepared for scans, with the view of each sensor."""

from __future__ import annotations

import mmap
from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN, HEADING_STRIDE, coarse_sensor
from eigenscan.eigenspace.embedding import Embedding
from eigenscan.eigenspace.panorama import Sensor
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.geometry.raycast import RayCaster
from eigenscan.geometry.surfaces import Surfaces, faces_of
from eigenscan.projector.association.manifold import Association
from eigenscan.projector.association.ratios import Ratios
from eigenscan.projector.intervals import leaving
from eigenscan.projector.lattice import Lattice
from eigenscan.projector.likelihood import EXACT, Exactness
from eigenscan.projector.model_set_assembler import WholeSet
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.share import own_share, shared_area
from eigenscan.projector.subspaces import Subspaces
from eigenscan.projector.tables import HEADINGS, Flags, Given, Store, Tables
from eigenscan.projector.verification import RANGE_CAP, Steps, predicted, width
from eigenscan.projector.wall_field import WallField
from eigenscan.schemas.hypotheses_pb2 import SURFACES_FACES, SURFACES_MIDDLE, SURFACES_UNSPECIFIED
from eigenscan.schemas.hypotheses_pb2 import Surfaces as Stated
from numba import njit
from numpy.typing import NDArray

KEPT_SENSORS = 8
"""Sensor grids whose subspaces are kept; the least recently used one is dropped first."""
Panoramas = NDArray[np.float32]

STEPS_ASIDE = 2
"""Of the model's grid that verification looks beyond what is searched: it climbs to the position beside, and
takes the one beside that for a pose between."""
COARSE_CELL = 0.1
"""m, of the walls that many poses slide to."""


class SensorView:
    """The site as one sensor sees it.

    A row of `association` is a pose (see `places`); region r has those from `bounds[r]` to `bounds[r + 1]`.
    `windows` (P, W) are the panoramas to verify against, `leaves` (P, W) where rays leave the walls, as of
    `predicted`: of the regions that are ready, and of the positions beside them.
    """

    def __init__(
        self,
        tables: Tables,
        lattice: Lattice,
        enters: Panoramas,
        leaves: Panoramas,
        range_max: float,
        foreseen_by: str,
    ) -> None:
        """`enters` and `leaves` (P, N): where rays from the lattice's positions enter and leave walls, m.

        `foreseen_by`: what the obstacle mask compares a scan with, the setting `obstacles`.
        """
        self.foreseen_by = foreseen_by
        self.tables, self._lattice, self._range_max = tables, lattice, range_max
        self._enters, self._leaves = enters, leaves
        sizes = [len(which) * HEADINGS for which in lattice.searched]
        self.bounds = np.cumsum([0, *sizes])
        self._searched = np.concatenate(lattice.searched)
        self.windows, self.leaves = (untouched(len(enters), width(tables.analysis.beams)) for _ in range(2))
        self._shown = np.zeros(len(sizes), dtype=bool)
        self._show()

    def places(self, rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Lattice positions (n,), and windows (n,) of their panoramas, of rows (n,) of `association`."""
        return self._searched[rows // HEADINGS], rows % HEADINGS * HEADING_STRIDE

    def distinct_places(
        self, rows: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Of sorted rows (n,) each once (k,), and their `places`."""
        found: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]] = _distinct_places(
            rows, self._searched
        )
        return found

    @property
    def embedding(self) -> Embedding:
        """The embedding of the analysis."""
        return self.tables.analysis.embedding

    @property
    def spaces(self) -> Subspaces:
        """Spaces of the regions that are ready, and of others if known."""
        return self.tables.subspaces

    @property
    def association(self) -> Association:
        """Over the regions that are ready."""
        return self.tables.association

    @property
    def ratios(self) -> Ratios | None:
        """Interpolates matches, if the settings ask for it."""
        return self.tables.ratios

    @property
    def usual_error(self) -> NDArray[np.float64]:
        """See `Tables`."""
        return self.tables.usual_error

    def admit(self, wanted: Flags, order: NDArray[np.float64]) -> None:
        """See `Tables`."""
        self.tables.admit(wanted, order)
        self._show()

    def complete(self) -> SensorView:
        """Itself, with all regions ready."""
        self.tables.complete()
        self._show()
        return self

    def _show(self) -> None:
        """Fills the predicted scans around regions that became ready."""
        fresh = np.flatnonzero(self.tables.ready & ~self._shown)
        if not len(fresh):
            return
        self._shown[fresh] = True
        near = np.unique(np.concatenate([self._lattice.regions[r] for r in fresh]))
        for _ in range(STEPS_ASIDE):
            near = np.unique(self._lattice.neighbours[near])
            near = near[near >= 0]
        for out, panoramas in ((self.windows, self._enters), (self.leaves, self._leaves)):
            out[near] = predicted(panoramas[near], self.tables.analysis.beams, self._range_max)


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _distinct_places(
    rows: NDArray[np.int64], searched: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    distinct, home, window = np.empty_like(rows), np.empty_like(rows), np.empty_like(rows)
    count = 0
    for i in range(len(rows)):
        if i > 0 and rows[i] == rows[i - 1]:
            continue
        # unsigned: an index that cannot be negative is not looked at twice
        place = np.uint64(rows[i]) // np.uint64(HEADINGS)
        distinct[count], home[count] = rows[i], searched[place]
        window[count] = rows[i] % HEADINGS * HEADING_STRIDE
        count += 1
    return distinct[:count], home[:count], window[:count]


@dataclass(frozen=True)
class Reading:
    """Where the surfaces of the walls are taken to be: the distance to them, and rays; how exact they are."""

    walls: WallField
    caster: RayCaster
    surfaces: Stated = SURFACES_UNSPECIFIED
    exactness: Exactness = EXACT


class Site:
    """The set in use, as far as this projector searches it.

    `readings`: where the walls' surfaces may be, in their middle and, where they are thick, at their faces;
    each scan shows which. `caster` is the first one's, `drawn` of the walls as the map draws them.
    `inexactness`, m: how far surfaces may be from there.
    `boxes` (R, 4): corners of the regions, x and y from, x and y to, m, map frame.
    Raises ModelError where its share is empty.
    """

    def __init__(
        self,
        whole: WholeSet,
        settings: ProjectorSettings,
        given: Given | None = None,
        store: Store | None = None,
    ) -> None:
        """`given`: eigenspaces for other lidars that were received; it may grow. `store`: of tables."""
        self.version, self.frame_id, self.floors = whole.version, whole.frame_id, whole.floors
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
            exactness = Exactness.of(self.inexactness)
            middle = Reading(
                WallField.of(DistanceField.of(surfaces)), RayCaster.of(surfaces), SURFACES_MIDDLE, exactness
            )
            faces = WallField.of(DistanceField.of(faces_of(whole.grid)))
            self.readings = middle, Reading(faces, as_drawn.caster, SURFACES_FACES, exactness.as_drawn())
        self.caster = self.readings[0].caster
        self.coarse_walls = WallField.of(field, COARSE_CELL)
        self.models, self.analysis = own, own[0].space.analysis
        self.lattice = Lattice.of(own)
        self._enters, self._leaves = self._intervals()
        corners = [self.lattice.positions[positions] for positions in self.lattice.regions]
        self.boxes = np.array([[*points.min(axis=0), *points.max(axis=0)] for points in corners])
        self.regions = tuple(region.region for region in own)
        self._settings, self._given, self._store = settings, {} if given is None else given, store
        self._views: OrderedDict[tuple[int, float], SensorView] = OrderedDict()
        self._sensors: dict[tuple[int, float], Sensor] = {}
        self._passing: set[tuple[int, float]] = set()

    def _intervals(self) -> tuple[Panoramas, Panoramas]:
        """Where rays from the positions enter the walls as they are drawn, and where they leave them."""
        positions, surfaces = self.lattice.positions, self.lattice.panoramas
        leaves = leaving(self.drawn, positions, surfaces, RANGE_CAP)
        if len(self.readings) == 1:
            return surfaces, leaves
        drawn = self.readings[1].caster.panoramas(positions, ANALYSIS_TURN, RANGE_CAP)
        # a position within a wall as it is drawn shows nothing of where rays enter it
        return np.where(drawn > 0, np.minimum(drawn, surfaces), surfaces), leaves

    def area(self, regions: NDArray[np.bool_] | None) -> float:
        """Free area of some of the regions (R,), m2, or of all."""
        if regions is None:
            return self.searched_area_m2
        sizes = np.array([len(positions) for positions in self.lattice.regions])
        return float(self.searched_area_m2 * sizes[regions].sum() / sizes.sum())

    def has_view(self, sensor: Sensor) -> bool:
        """Whether there is a view for `sensor` of a robot already."""
        coarse = coarse_sensor(sensor)
        key = (coarse.beams, coarse.range_max)
        return key in self._views and key not in self._passing

    def abandon(self) -> None:
        """Stops the background work for its views."""
        for view in self._views.values():
            view.tables.abandoned = True

    @property
    def sensors(self) -> list[Sensor]:
        """Sensors of robots that were seen, the longest unused first."""
        return [self._sensors[key] for key in self._views if key not in self._passing]

    def view(self, sensor: Sensor, *, passing: bool = False) -> SensorView:
        """The site for `sensor`; made at its first scan. The heading of its first beam makes no difference.

        `passing`: for a single query. Such views are dropped first, so that no robot's lidar loses its own.
        """
        coarse = coarse_sensor(sensor)
        key = (coarse.beams, coarse.range_max)
        if key not in self._views:
            while len(self._views) >= KEPT_SENSORS:
                oldest = next((one for one in self._views if one in self._passing), next(iter(self._views)))
                self._views.pop(oldest).tables.abandoned = True
                self._passing.discard(oldest)
                del self._sensors[oldest]
            self._views[key] = self._make(coarse)
            self._sensors[key] = sensor
            if passing:
                self._passing.add(key)
        if not passing:
            self._passing.discard(key)
        self._views.move_to_end(key)
        return self._views[key]

    def _make(self, coarse: Sensor) -> SensorView:
        tables = Tables(
            self.models, self.lattice, self.analysis.of(coarse), self._settings, self._given, self._store
        )
        return SensorView(
            tables, self.lattice, self._enters, self._leaves, coarse.range_max, self._settings.obstacles
        )


def untouched(rows: int, columns: int) -> Steps:
    """An array that takes memory only where it is written, in small pages: few of its rows are."""
    memory = mmap.mmap(-1, max(2 * rows * columns, 1))
    if hasattr(mmap, "MADV_NOHUGEPAGE"):
        with suppress(OSError):  # a kernel without large pages
            memory.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(memory, dtype=np.int16, count=rows * columns).reshape(rows, columns)
