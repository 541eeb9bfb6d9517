"""The part of a site that a projector searches."""

from __future__ import annotations

import numpy as np
from eigenscan.eigenspace.model import ModelError, RegionModel

Part = tuple[int, int]
"""(k, n): the k-th of n shares, counted from 1."""


def own_share(regions: tuple[RegionModel, ...], part: Part) -> tuple[RegionModel, ...]:
    """Every n-th region in the order of their names, from the k-th on, alike in all projectors of a site.

    Neighbouring regions go to different parts, so each part has some of every kind. Raises ModelError if none
    is left.
    """
    k, n = part
    own = tuple(sorted(regions, key=lambda model: model.region)[k - 1 :: n])
    if not own:
        raise ModelError(f"part {k}/{n}: the set has only {len(regions)} regions: ask for fewer parts")
    return own


def shared_area(regions: tuple[RegionModel, ...], own: tuple[RegionModel, ...], area_m2: float) -> float:
    """Free area of the share, m2, of a site's `area_m2`, by its positions; what regions share counts once."""
    return area_m2 * _places(own) / _places(regions)


def _places(regions: tuple[RegionModel, ...]) -> int:
    return len(np.unique(np.concatenate([model.index for model in regions]), axis=0))
