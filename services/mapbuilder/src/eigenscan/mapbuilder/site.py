"""From a map to the models of its regions: the whole way, without files or messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from eigenscan.eigenspace.components import analyse
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.model import ModelError, RegionModel, quantize
from eigenscan.eigenspace.panorama import Sensor
from eigenscan.eigenspace.ranges import RangeTransform
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.gridmap import GridMap
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.drawn import divide_as_drawn
from eigenscan.mapbuilder.geojson import GivenRegion, RegionsError
from eigenscan.mapbuilder.positions import Positions, free_positions
from eigenscan.mapbuilder.regions import Division, Regions, divide
from numpy.typing import NDArray

_CAST_AT_ONCE = 40_000
"""Positions whose panoramas are in memory as floats, 120 MB at half a degree."""

Progress = Callable[[str, float], None]
"""Hears the step's name and the share of the whole that is done."""


@dataclass(frozen=True)
class Plan:
    """How a map becomes models. Lengths in m, angles in rad."""

    spacing: float = 0.5
    step: float = float(np.deg2rad(0.5))
    clearance: float = 0.15
    range_max: float = 80.0
    range_cap: float = 20.0
    field_of_view: float = float(np.pi)
    share: float = 0.9
    frame_id: str = "map"
    division: Division = field(default_factory=Division)
    threads: int = 1

    @property
    def sensor(self) -> Sensor:
        """The sensor that the published eigenspaces are for."""
        return Sensor.facing(self.field_of_view, TURN / self.turn, self.range_cap)

    @property
    def turn(self) -> int:
        """Beams of a panorama: the step is rounded to a whole part of a turn."""
        return round(TURN / self.step)


@dataclass(frozen=True)
class Layout:
    """Where models are to be built; `names`: of the regions that hold positions, by number from 0."""

    positions: Positions
    regions: Regions
    names: dict[int, str]


def lay_out(grid: GridMap, plan: Plan, drawn: Sequence[GivenRegion] = ()) -> Layout:
    """Positions and regions of a map; the regions as they are found, or as `drawn`.

    Raises ModelError where no position is free, RegionsError where a drawn region holds none.
    """
    positions = free_positions(grid, plan.spacing, plan.clearance)
    if not len(positions.index):
        raise ModelError(
            f"no free position {plan.clearance} m from the walls on a grid of {plan.spacing} m: "
            "check the map's thresholds and resolution, or ask for a finer spacing"
        )
    regions = divide_as_drawn(grid, drawn, plan.division) if drawn else divide(grid, plan.division)
    inhabited = [n for n, inside in enumerate(regions.members(positions.points)) if len(inside)]
    empty = next((n for n in range(len(drawn)) if n not in inhabited), None)
    if empty is not None:
        raise RegionsError(
            f"region {drawn[empty].name!r} holds no position {plan.clearance} m from the walls: "
            "draw it larger, or ask for a finer spacing"
        )
    digits = max(2, len(str(len(inhabited))))
    found = {n: f"r{k:0{digits}}" for k, n in enumerate(inhabited, 1)}
    return Layout(positions, regions, {n: region.name for n, region in enumerate(drawn)} or found)


def build_site(
    grid: GridMap,
    plan: Plan,
    progress: Progress = lambda _step, _share: None,
    layout: Layout | None = None,
) -> SiteModel:
    """Models of all regions of the map, where `layout` says. Raises ModelError where no position is free."""
    progress("regions", 0.0)
    layout = layout or lay_out(grid, plan)
    positions, regions = layout.positions, layout.regions
    inside = regions.members(positions.points)
    members = [_Member(name, n, inside[n]) for n, name in layout.names.items()]
    caster, models = RayCaster.of(grid), list[RegionModel]()
    with ThreadPoolExecutor(max(plan.threads, 1)) as pool:
        for batch in _batches(members, positions.points):
            progress("panoramas", 0.1 + 0.9 * len(models) / len(members))
            held, where = np.unique(np.concatenate([m.inside for m in batch]), return_inverse=True)
            ranges = caster.panoramas(positions.points[held], plan.turn, plan.range_max, plan.threads)
            rows = np.split(where, np.cumsum([len(m.inside) for m in batch])[:-1])
            for model in pool.map(
                lambda member, own, ranges=ranges: _model(plan, positions, regions, member, ranges[own]),
                batch,
                rows,
            ):
                models.append(model)
                progress("eigenspaces", 0.1 + 0.9 * len(models) / len(members))
    models.sort(key=lambda model: model.region)
    return SiteModel(grid, plan.frame_id, tuple(models))


@dataclass(frozen=True)
class _Member:
    """A region's name, its number on the raster, and the indices of its positions."""

    name: str
    number: int
    inside: NDArray[np.int64]


def _batches(members: list[_Member], points: NDArray[np.float64]) -> list[list[_Member]]:
    """Neighbouring regions that are cast together: halved across the longer side until they fit."""
    if len(members) == 1 or sum(len(member.inside) for member in members) <= _CAST_AT_ONCE:
        return [members]
    middles = np.array([points[member.inside].mean(axis=0) for member in members])
    axis = int(np.argmax(np.ptp(middles, axis=0)))
    order = np.argsort(middles[:, axis], kind="stable")
    half = len(order) // 2
    return [
        batch
        for part in (order[:half], order[half:])
        for batch in _batches([members[i] for i in part], points)
    ]


def _model(
    plan: Plan,
    positions: Positions,
    regions: Regions,
    member: _Member,
    panoramas: NDArray[np.float32],
) -> RegionModel:
    sensor = plan.sensor
    space = analyse(RangeTransform(plan.range_cap)(panoramas), sensor.beams, share=plan.share)
    model = RegionModel(
        region=member.name,
        frame_id=plan.frame_id,
        spacing=positions.spacing,
        origin=positions.origin,
        index=positions.index[member.inside],
        ranges=quantize(panoramas),
        sensor=sensor,
        range_cap=plan.range_cap,
        space=space,
        outline=regions.outline(member.number),
    )
    model.to_message()  # hashes and packs here, on this thread; the model keeps both
    return model
