"""Assembles received maps and region models into whole sets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.eigenspace.floors import Floor, usable_floors
from eigenscan.eigenspace.model import ModelError, RegionModel, set_version
from eigenscan.geometry.gridmap import GridMap, from_message
from eigenscan.projector import set_aside
from eigenscan.projector.set_aside import Sizes, size_of_model
from eigenscan.schemas import model_pb2
from foxglove_schemas_protobuf.Grid_pb2 import Grid

MOST_CELLS = 2**26
"""Cells of the positions' grid around all regions: 2 km x 2 km at 0.25 m. More is hostile."""
MOST_GRIDS = 2
"""Maps that are held besides those of the sets in use and announced: their sets may come later."""


@dataclass(frozen=True)
class WholeSet:
    """A map and all regions of one announced set."""

    version: str
    frame_id: str
    grid: GridMap
    regions: tuple[RegionModel, ...]
    free_area_m2: float
    floors: tuple[Floor, ...] = ()


class ModelSetAssembler:
    """Collects maps, models and sets in any order; gives each whole set once.

    A set is given again where what its version does not cover has changed: its frame, area or floors.
    """

    def __init__(self) -> None:
        self._grids: dict[str, GridMap] = {}
        self._models: dict[str, RegionModel] = {}
        self._announced: model_pb2.ModelSet | None = None
        self._given: tuple[str, ...] = ()
        """The models of the set that was given last."""
        self._used: model_pb2.ModelSet | None = None
        """The set that was given last, without its time."""
        self._wanted: frozenset[str] = frozenset()
        """The models of the sets in use and announced."""
        self._wanted_bytes = 0
        """What of them is held."""
        self._others: Sizes[str] = Sizes()
        """The other models that are held."""
        self.set_aside = 0
        """Models, while no set needed them."""

    @property
    def missing(self) -> str:
        """The missing parts of the newest set, as text; empty if it is complete."""
        announced = self._announced
        if announced is None:
            return "no model"
        if announced is self._used:
            return ""
        lacking = sum(entry.version not in self._models for entry in announced.entries)
        parts = [f"{lacking} of {len(announced.entries)} regions"] if lacking else []
        if announced.map_version not in self._grids:
            parts.append("the map")
        return f"model {announced.version[:12]} lacks {' and '.join(parts)}"

    def is_whole(self, version: str) -> bool:
        """Whether the newest set has that version, and was given."""
        return self._used is not None and self._used is self._announced and self._used.version == version

    def put_map(self, message: Grid) -> WholeSet | None:
        """Takes a map. Raises MapError."""
        grid = from_message(message)
        self._grids.pop(grid.version, None)
        self._grids[grid.version] = grid  # the newest last
        wanted = {each.map_version for each in (self._announced, self._used) if each}
        for version in [one for one in self._grids if one not in wanted][:-MOST_GRIDS]:
            del self._grids[version]
        return self._whole()

    def put_model(self, message: model_pb2.RegionModel) -> WholeSet | None:
        """Takes a region's model. Raises ModelError."""
        if message.version not in self._models:
            self._models[message.version] = RegionModel.from_message(message)
            self._sort_in(message.version)
            self._refuse_too_large()
        return self._whole()

    def put_set(self, message: model_pb2.ModelSet) -> WholeSet | None:
        """Takes the announcement of a set; the newest one counts. Raises ModelError."""
        if not message.entries:
            raise ModelError(f"model set {message.version[:12]!r}: has no regions")
        if len(message.entries) > set_aside.MOST_REGIONS:
            raise ModelError(
                f"model set {message.version[:12]!r}: {len(message.entries)} regions, "
                f"{set_aside.MOST_REGIONS} at most: build larger regions"
            )
        expected = set_version(message.map_version, [entry.version for entry in message.entries])
        if message.version != expected:
            raise ModelError(
                f"model set {message.version[:12]!r}: its entries make version {expected[:12]!r}: damaged"
            )
        announced = model_pb2.ModelSet()
        announced.CopyFrom(message)
        announced.ClearField("timestamp")
        self._announce(self._used if announced == self._used else announced)
        self._refuse_too_large()
        return self._whole()

    def _announce(self, announced: model_pb2.ModelSet | None) -> None:
        """Wants the models of that set, besides those in use, and sorts what is held again."""
        self._announced, before = announced, self._wanted
        entries = announced.entries if announced else ()
        self._wanted = frozenset((*self._given, *(entry.version for entry in entries)))
        held = self._models.keys()
        self._wanted_bytes = sum(size_of_model(self._models[one]) for one in before & self._wanted & held)
        for version in held & (self._wanted - before):  # first, or the next ones may set them aside
            self._sort_in(version)
        for version in [one for one in held if one in before - self._wanted]:
            self._sort_in(version)

    def _sort_in(self, version: str) -> None:
        """Counts a model that is held as wanted, or among the others; sets the oldest of these aside."""
        size = size_of_model(self._models[version])
        if version in self._wanted:
            self._others.take(version)
            self._wanted_bytes += size
            return
        for old in self._others.put(version, size):
            del self._models[old]
            self.set_aside += 1

    def _refuse_too_large(self) -> None:
        """Raises ModelError, and no longer wants the announced set, where its models take too much memory."""
        announced = self._announced
        if announced is None or self._wanted_bytes <= set_aside.MOST_SET_BYTES:
            return
        self._announce(None)
        raise ModelError(
            f"model set {announced.version[:12]!r}: takes more than "
            f"{set_aside.MOST_SET_BYTES / 1e9:.1f} GB of memory: build the site again with a larger --spacing"
        )

    def _whole(self) -> WholeSet | None:
        announced = self._announced
        if announced is None or announced is self._used:
            return None
        grid = self._grids.get(announced.map_version)
        found = [self._models.get(entry.version) for entry in announced.entries]
        regions = tuple(model for model in found if model is not None)
        if grid is None or len(regions) < len(found):
            return None
        try:
            _fit_together(regions, grid, announced.free_area_m2)
        except ModelError:
            self._announce(None)  # it stays refused, however often one of its parts comes again
            raise
        if self._used is not None and self._used.map_version != announced.map_version:
            self._grids.pop(self._used.map_version, None)
        self._used = announced
        self._given = tuple(model.version for model in regions)
        # only models that the next set may share are kept
        self._models = {model.version: model for model in regions}
        self._others = Sizes()
        self._announce(announced)
        floors = usable_floors(announced)
        return WholeSet(announced.version, announced.frame_id, grid, regions, announced.free_area_m2, floors)


def _fit_together(regions: tuple[RegionModel, ...], grid: GridMap, free_area_m2: float) -> None:
    """Raises ModelError where regions of one set lie on different grids, or outside of their map.

    Also where the set's free area is none of this map's: probabilities are by it.
    """
    first = regions[0]
    height, width = grid.cells.shape
    if not 0.0 < free_area_m2 <= height * width * grid.resolution**2:
        raise ModelError(
            f"model set: free_area_m2 = {free_area_m2:g} must be above 0 and within its map: "
            "build the site again"
        )
    for model in regions:
        column, row = grid.to_grid(model.positions).T
        if not ((column >= 0) & (column <= width) & (row >= 0) & (row <= height)).all():
            raise ModelError(
                f"region {model.region!r}: has positions outside of the map: build the site again"
            )
    positions = np.concatenate([model.positions for model in regions])
    columns, rows = np.ptp(positions, axis=0) / first.spacing + 1
    if columns * rows > MOST_CELLS:
        raise ModelError(
            f"region {first.region!r}: spacing {first.spacing:g} m makes {columns * rows:.0f} cells, "
            f"{MOST_CELLS} at most: build the site again with a larger --spacing"
        )
    for model in regions[1:]:
        if model.space.analysis != first.space.analysis:
            raise ModelError(
                f"region {model.region!r}: its eigenspace is of another analysis than that of "
                f"{first.region!r}: build the whole site again"
            )
        if model.spacing != first.spacing:
            raise ModelError(
                f"region {model.region!r}: positions {model.spacing} m apart, those of {first.region!r} "
                f"{first.spacing} m: build the whole site again"
            )
