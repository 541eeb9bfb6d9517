"""A site built piece by piece: each region goes to disk as it is finished, and is not held in memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

from eigenscan.eigenspace.model import ModelError
from eigenscan.eigenspace.pieces import Piece, Pieces
from eigenscan.eigenspace.region_file import pack_region
from eigenscan.geometry.gridmap import GridMap
from eigenscan.geometry.raycast import RayCaster
from eigenscan.geometry.surfaces import Surfaces
from eigenscan.mapbuilder.plan import Plan
from eigenscan.mapbuilder.shards import CAST_AT_ONCE, Area, Shard, build_shard, shards
from eigenscan.mapbuilder.site import Layout, Progress


class Engine(Protocol):
    """Builds shards, `count` at a time, in any order."""

    @property
    def count(self) -> int:
        """Shards that are built at a time."""

    def build(
        self, caster: RayCaster, plan: Plan, waiting: Sequence[Shard]
    ) -> Iterator[tuple[int, list[bytes]]]:
        """The number of each shard, and the content of its regions' files."""


_SHARDS_PER_WORKER = 4
"""Least number of shards for each worker, so that they end at about the same time."""


def build_pieces(
    grid: GridMap,
    plan: Plan,
    layout: Layout,
    pieces: Pieces,
    progress: Progress = lambda _step, _share: None,
    engine: Engine | None = None,
) -> tuple[Mapping[str, Piece], int]:
    """All pieces of the site by their regions' names, and how many of them existed before.

    They equal those of build_site, with any engine; the default is this process's threads. Raises ModelError
    where the engine ends without some of them.
    """
    progress("regions", 0.0)
    version = grid.version
    keys = {area.name: area.key(version, plan) for area in layout.areas}
    ready = {name: piece for name, key in keys.items() if (piece := pieces.find(key))}
    found = len(ready)
    missing = [area for area in layout.areas if area.name not in ready]
    engine = engine or _Threads()
    waiting = shards(missing, _size(missing, engine.count))
    if waiting:
        for number, contents in engine.build(RayCaster.of(Surfaces.of(grid).grid), plan, waiting):
            for area, content in zip(waiting[number], contents, strict=True):
                ready[area.name] = pieces.keep(keys[area.name], content)
            progress("regions", len(ready) / len(keys))
    if lost := sorted(keys.keys() - ready.keys()):
        raise ModelError(f"{pieces.folder}: regions {', '.join(lost)[:80]} were not built: run it again")
    return ready, found


def _size(missing: Sequence[Area], at_a_time: int) -> int:
    """Positions of a shard."""
    positions = sum(len(area.positions.index) for area in missing)
    return CAST_AT_ONCE if at_a_time < 2 else min(CAST_AT_ONCE, positions // (_SHARDS_PER_WORKER * at_a_time))


class _Threads:
    """One shard after the other, on the plan's threads."""

    count = 1

    def build(
        self, caster: RayCaster, plan: Plan, waiting: Sequence[Shard]
    ) -> Iterator[tuple[int, list[bytes]]]:
        for number, shard in enumerate(waiting):
            yield number, list(build_shard(caster, plan, shard, pack_region))
