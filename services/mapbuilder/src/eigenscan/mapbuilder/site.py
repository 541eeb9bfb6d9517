"""Builds the models of a map's regions, without files or messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.model import MOST_BYTES, ModelError, RegionModel, panorama_bytes
from eigenscan.geometry.gridmap import GridMap
from eigenscan.geometry.raycast import RayCaster
from eigenscan.geometry.surfaces import Surfaces
from eigenscan.mapbuilder.adaptive import adaptive_positions
from eigenscan.mapbuilder.drawn import divide_as_drawn
from eigenscan.mapbuilder.geojson import GivenRegion, RegionsError
from eigenscan.mapbuilder.plan import Plan
from eigenscan.mapbuilder.positions import Positions, free_positions
from eigenscan.mapbuilder.regions import Regions, divide
from eigenscan.mapbuilder.shards import Area, build_shard, in_memory, shards

Progress = Callable[[str, float], None]
"""Receives the step's name and the share of the whole that is done."""

__all__ = ["Layout", "Plan", "Progress", "build_site", "lay_out"]


@dataclass(frozen=True)
class Layout:
    """Positions and regions of the models; `names`: of regions that hold positions, by number from 0."""

    positions: Positions
    regions: Regions
    names: dict[int, str]
    within: float = math.nan
    """Share of the places between positions where `plan.error` holds; NaN without that bound."""

    @cached_property
    def areas(self) -> tuple[Area, ...]:
        """The areas to build, by the regions' names."""
        inside = self.regions.members(self.positions.points)
        areas = [
            Area(name, self.positions.at(inside[n]), self.regions.outline(n))
            for n, name in self.names.items()
        ]
        return tuple(sorted(areas, key=lambda area: area.name))

    @property
    def held(self) -> int:
        """Positions that lie in some region; those that several share count once."""
        return len(np.unique(np.concatenate([area.positions.index for area in self.areas]), axis=0))


def lay_out(grid: GridMap, plan: Plan, drawn: Sequence[GivenRegion] = ()) -> Layout:
    """Positions and regions of a map's surfaces; the regions as found, or as `drawn`.

    Raises ModelError if no position is free or a region is too large, RegionsError if a drawn one holds none.
    """
    within = math.nan
    grid = Surfaces.of(grid).grid
    if plan.error:
        positions, within = adaptive_positions(grid, plan)
    else:
        positions = free_positions(grid, plan.spacing, plan.clearance)
    if not len(positions.index):
        raise ModelError(
            f"no free position {plan.clearance} m from the walls on a grid of {plan.spacing} m: "
            "check the map's thresholds and resolution, or ask for a finer spacing"
        )
    regions = divide_as_drawn(grid, drawn, plan.division) if drawn else divide(grid, plan.division)
    members = regions.members(positions.points)
    inhabited = [n for n, inside in enumerate(members) if len(inside)]
    empty = next((n for n in range(len(drawn)) if n not in inhabited), None)
    if empty is not None:
        raise RegionsError(
            f"region {drawn[empty].name!r} holds no position {plan.clearance} m from the walls: "
            "draw it larger, or ask for a finer spacing"
        )
    if not inhabited:
        raise ModelError("no free position lies in a region: the map's free space is too narrow for one")
    digits = max(2, len(str(len(inhabited))))
    found = {n: f"r{k:0{digits}}" for k, n in enumerate(inhabited, 1)}
    names = {n: region.name for n, region in enumerate(drawn)} or found
    for n, name in names.items():
        if panorama_bytes(len(members[n]), plan.turn) > MOST_BYTES:
            raise ModelError(
                f"region {name!r} has {len(members[n])} positions of {plan.turn} beams, over {MOST_BYTES} "
                "bytes: ask for a coarser spacing or step, or draw smaller regions"
            )
    return Layout(positions, regions, names, within)


def build_site(
    grid: GridMap,
    plan: Plan,
    progress: Progress = lambda _step, _share: None,
    layout: Layout | None = None,
) -> SiteModel:
    """Models of all regions of the map, as in `layout`. Raises ModelError if no position is free."""
    progress("regions", 0.0)
    areas = (layout or lay_out(grid, plan)).areas
    caster, models = RayCaster.of(Surfaces.of(grid).grid), list[RegionModel]()
    for shard in shards(areas):
        progress("panoramas", 0.1 + 0.9 * len(models) / len(areas))
        for model in build_shard(caster, plan, shard, in_memory):
            models.append(model)
            progress("eigenspaces", 0.1 + 0.9 * len(models) / len(areas))
    models.sort(key=lambda model: model.region)
    return SiteModel(grid, plan.frame_id, tuple(models))
