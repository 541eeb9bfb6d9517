"""From a map to the models of its regions: the whole way, without files or messages."""

from __future__ import annotations

from collections.abc import Callable
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
from eigenscan.mapbuilder.positions import Positions, free_positions
from eigenscan.mapbuilder.regions import Division, Regions, divide
from numpy.typing import NDArray

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
        return Sensor.facing(self.field_of_view, TURN / round(TURN / self.step), self.range_cap)


def build_site(grid: GridMap, plan: Plan, progress: Progress = lambda _step, _share: None) -> SiteModel:
    """Models of all regions of the map. Raises ModelError where no position is free."""
    progress("regions", 0.0)
    positions = free_positions(grid, plan.spacing, plan.clearance)
    if not len(positions.index):
        raise ModelError(
            f"no free position {plan.clearance} m from the walls on a grid of {plan.spacing} m: "
            "check the map's thresholds and resolution, or ask for a finer spacing"
        )
    regions = divide(grid, plan.division)
    points = positions.points
    progress("panoramas", 0.1)
    ranges = RayCaster.of(grid).panoramas(points, plan.sensor.turn, plan.range_max, plan.threads)
    inhabited = [(n, inside) for n, inside in enumerate(regions.members(points)) if len(inside)]
    members = [(f"r{k:02}", n, inside) for k, (n, inside) in enumerate(inhabited, 1)]
    models = []
    with ThreadPoolExecutor(max(plan.threads, 1)) as pool:
        made = pool.map(lambda item: _model(plan, positions, regions, ranges, *item), members)
        for done, model in enumerate(made, 1):
            models.append(model)
            progress("eigenspaces", 0.5 + 0.5 * done / len(members))
    return SiteModel(grid, plan.frame_id, tuple(models))


def _model(
    plan: Plan,
    positions: Positions,
    regions: Regions,
    ranges: NDArray[np.float32],
    name: str,
    number: int,
    inside: NDArray[np.int64],
) -> RegionModel:
    panoramas = ranges[inside]
    sensor = plan.sensor
    space = analyse(RangeTransform(plan.range_cap)(panoramas), sensor.beams, share=plan.share)
    model = RegionModel(
        region=name,
        frame_id=plan.frame_id,
        spacing=positions.spacing,
        origin=positions.origin,
        index=positions.index[inside],
        ranges=quantize(panoramas),
        sensor=sensor,
        range_cap=plan.range_cap,
        space=space,
        outline=regions.outline(number),
    )
    model.to_message()  # hashes and packs here, on this thread; the model keeps both
    return model
