"""A whole set made ready for scans: distance field, ray caster, and subspaces for each sensor grid."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from eigenscan.eigenspace.panorama import Sensor
from eigenscan.eigenspace.ranges import RangeTransform
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.geometry.raycast import RayCaster
from eigenscan.projector.likelihood import HORIZON, RangeHistogram
from eigenscan.projector.observation import coarse_sensor
from eigenscan.projector.shelf import WholeSet
from eigenscan.projector.subspace import Subspace, make_subspace

KEPT_SENSORS = 8
"""Sensor grids whose subspaces are kept; the longest unused one goes first."""


@dataclass(frozen=True)
class SensorView:
    """The site as one sensor sees it."""

    subspaces: tuple[Subspace, ...]
    ranges: RangeHistogram
    horizon: float


class Site:
    """The set in use."""

    def __init__(self, whole: WholeSet, components: int, range_cap: float) -> None:
        self.version, self.frame_id = whole.version, whole.frame_id
        self.free_area_m2 = whole.free_area_m2
        self.field = DistanceField.of(whole.grid)
        self.caster = RayCaster.of(whole.grid)
        self._regions = whole.regions
        self._components, self._range_cap = components, range_cap
        self._views: OrderedDict[tuple[float, int, float], SensorView] = OrderedDict()

    @property
    def sensors(self) -> list[Sensor]:
        """Sensors that were seen, on the analysis grid."""
        return [view.subspaces[0].sensor for view in self._views.values()]

    def view(self, sensor: Sensor) -> SensorView:
        """The site for `sensor`; made at its first scan."""
        coarse = coarse_sensor(sensor)
        key = (coarse.angle_min, coarse.beams, coarse.range_max)
        if key not in self._views:
            self._views[key] = self._make(coarse)
            while len(self._views) > KEPT_SENSORS:
                self._views.popitem(last=False)
        self._views.move_to_end(key)
        return self._views[key]

    def _make(self, coarse: Sensor) -> SensorView:
        limit = coarse.range_max if coarse.range_max > 0 else np.inf
        transform = RangeTransform(min(self._range_cap, limit))
        horizon = min(HORIZON, limit)
        subspaces = tuple(
            make_subspace(region, coarse, transform, self._components) for region in self._regions
        )
        seen = np.concatenate([region.panoramas[::4, ::8].ravel() for region in self._regions])
        return SensorView(subspaces, RangeHistogram.of(seen, horizon), horizon)
