"""Builds a site's models after a change: only regions that see it; the others stay."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.model import RegionModel, quantize
from eigenscan.geometry.gridmap import GridMap
from eigenscan.geometry.raycast import RayCaster
from eigenscan.geometry.surfaces import Surfaces
from eigenscan.mapbuilder.positions import free_positions
from eigenscan.mapbuilder.site import Plan
from numpy.typing import NDArray
from scipy.spatial import KDTree

Index = NDArray[np.int32]


def rebuild(site: SiteModel, grid: GridMap, plan: Plan) -> SiteModel:
    """The models of `grid`, a map with the same cells as the site's, in the site's regions.

    Positions that the change covers are left out, those that it frees join the regions of the nearest ones,
    and panoramas that do not see it stay bit for bit. A region that it covers whole stays as it is.
    """
    spacing, known = site.regions[0].spacing, Surfaces.of(site.grid)
    # by the same thickness, so that unchanged places stay equal
    before, now = known.grid, Surfaces.of(grid, known.thickness).grid
    old, new = (free_positions(surfaces, spacing, plan.clearance).index for surfaces in (before, now))
    given = _without(new, old)
    nearest = _distance(np.concatenate([model.index for model in site.regions]), given)
    work = _Rebuild(plan, RayCaster.of(before), RayCaster.of(now), _without(old, new), given, nearest)
    return replace(site, grid=grid, regions=tuple(work.after(model) for model in site.regions))


@dataclass(frozen=True)
class _Rebuild:
    """The old and the new map, and the grid positions (n, 2) that the change took and gave.

    Each given position has its distance from the nearest old one.
    """

    plan: Plan
    before: RayCaster
    now: RayCaster
    taken: Index
    given: Index
    nearest: NDArray[np.float64]

    def after(self, model: RegionModel) -> RegionModel:
        """The model itself if the change does not touch it."""
        stays = ~_among(model.index, self.taken)
        if not stays.any():
            return model
        kept, ranges = model.index[stays], model.ranges[stays]
        now = self._ranges(self.now, model, kept)
        changed = (self._ranges(self.before, model, kept) != now).any(axis=1)
        joining = _without(self.given[_distance(model.index, self.given) <= self.nearest], model.index)
        if stays.all() and not changed.any() and not len(joining):
            return model
        ranges = np.where(changed[:, None], now, ranges)
        index = np.concatenate([kept, joining])
        ranges = np.concatenate([ranges, self._ranges(self.now, model, joining)])
        order = np.lexsort(index.T)
        return model.with_ranges(index[order], ranges[order])

    def _ranges(self, caster: RayCaster, model: RegionModel, index: Index) -> NDArray[np.uint16]:
        points, beams = model.origin + index * model.spacing, model.ranges.shape[1]
        cast = caster.panoramas(points, beams, self.plan.range_max, self.plan.threads)
        return quantize(cast, model.range_unit)


def _distance(index: Index, to: Index) -> NDArray[np.float64]:
    """Distance (m,) of each row of `to` (m, 2) from the nearest row of `index`."""
    return np.asarray(KDTree(index).query(to)[0], dtype=np.float64)


def _among(index: Index, others: Index) -> NDArray[np.bool_]:
    """Which rows of `index` (n, 2) are rows of `others` (m, 2)."""
    one, other = (rows.astype(np.int64) @ [1 << 32, 1] for rows in (index, others))
    return np.isin(one, other)


def _without(index: Index, others: Index) -> Index:
    return index[~_among(index, others)]
