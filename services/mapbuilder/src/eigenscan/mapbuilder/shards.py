"""Shards: neighbouring regions that are built together, each shard on any thread or computer.

The panorama of a position does not depend on its shard. So the models are the same to the last bit for any
division and any worker.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from eigenscan.eigenspace.model import RegionModel, quantize
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.plan import Plan
from eigenscan.mapbuilder.positions import Positions
from numpy.typing import NDArray

CAST_AT_ONCE = 16_000
"""Positions of a shard at most, unless one region has more: 46 MB of panoramas at half a degree. The walls
around a shard are swept for each, so smaller ones cost more: at 4,000 a third more, at 1,000 three times."""

CAST_AGAINST = "surfaces"
"""The map's cells that rays meet; pieces of builds with others differ."""

Built = TypeVar("Built")


@dataclass(frozen=True)
class Area:
    """A region that is to be built: its name, its positions and its outline (K, 2), m, map frame."""

    name: str
    positions: Positions
    outline: NDArray[np.float64]

    @property
    def size(self) -> float:
        """Area in the outline, furniture and all, m^2."""
        x, y = self.outline.T
        return 0.5 * abs(float(x @ np.roll(y, 1) - y @ np.roll(x, 1)))

    def key(self, map_version: str, plan: Plan) -> str:
        """SHA-256, hex, of all that its model is made of."""
        # only inputs that change a model count, not the division or the worker
        how = replace(plan, threads=1, error=0.0, division=type(plan.division)())
        digest = hashlib.sha256(
            repr((CAST_AGAINST, map_version, how, self.name, self.positions.spacing)).encode()
        )
        for array in (self.positions.origin, self.positions.index, self.outline):
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()


Shard = Sequence[Area]


def shards(areas: Sequence[Area], most: int = CAST_AT_ONCE) -> list[Shard]:
    """Neighbouring areas together: halved, by positions, across the longer side until they have `most`."""
    sizes = np.array([len(area.positions.index) for area in areas])
    if len(areas) <= 1 or sizes.sum() <= most:
        return [areas] if areas else []
    middles = np.array([area.positions.points.mean(axis=0) for area in areas])
    axis = int(np.argmax(np.ptp(middles, axis=0)))
    order = np.argsort(middles[:, axis], kind="stable")
    # halves of equal work, so that workers end at the same time; none is empty
    behind = np.cumsum(sizes[order])
    half = 1 + int(np.argmin(np.abs(behind[:-1] - behind[-1] / 2)))
    return [
        shard for part in (order[:half], order[half:]) for shard in shards([areas[i] for i in part], most)
    ]


def build_shard(
    caster: RayCaster, plan: Plan, shard: Shard, finish: Callable[[RegionModel], Built]
) -> Iterator[Built]:
    """The results of `finish` for each of the shard's models, in order, on the plan's threads."""
    index = np.concatenate([area.positions.index for area in shard])
    held, where = np.unique(index, axis=0, return_inverse=True)
    points = replace(shard[0].positions, index=held).points
    ranges = caster.panoramas(points, plan.turn, plan.range_max, plan.threads)
    rows = np.split(where.reshape(-1), np.cumsum([len(area.positions.index) for area in shard])[:-1])
    with ThreadPoolExecutor(max(plan.threads, 1)) as pool:
        yield from pool.map(lambda area, own: finish(_model(plan, area, ranges[own])), shard, rows)


def _model(plan: Plan, area: Area, panoramas: NDArray[np.float32]) -> RegionModel:
    return RegionModel.of(
        plan.analysis,
        region=area.name,
        frame_id=plan.frame_id,
        spacing=area.positions.spacing,
        origin=area.positions.origin,
        index=area.positions.index,
        ranges=quantize(panoramas),
        outline=area.outline,
    )


def in_memory(model: RegionModel) -> RegionModel:
    """The model, hashed and packed on the thread that built it; it keeps both."""
    model.to_message()
    return model
