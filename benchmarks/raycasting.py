"""Rays a second and core, and how far they are from exact grid traversal, on a real map.

    python benchmarks/raycasting.py [--map MAP.yaml] [--json OUT]

One thread; the best of several runs in process time. The peer's figures (pruned CDDT 15.9, ray marching
11.5 million rays a second on fr079's map, one core) are those of range_libc.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from eigenscan.geometry.gridmap import FREE, GridMap, read_map
from eigenscan.geometry.raycast import RayCaster
from numpy.typing import NDArray

MAP = Path(__file__).parents[1].parent / "shared/datasets/fr079/map.yaml"
RANGE_MAX, BEAMS = 80.0, 720


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--map", type=Path, default=MAP)
    arguments.add_argument("--json", type=Path)
    given = arguments.parse_args()
    grid = read_map(given.map)
    caster = RayCaster.of(grid)
    figures: dict[str, float] = {"free_m2": grid.free_area}
    print(f"{given.map}: {grid.free_area:.0f} m2 free, {grid.resolution} m a cell, one core")
    for spacing in (0.5, 0.25, 0.1):
        points = positions(grid, spacing)
        seconds = best(partial(caster.panoramas, points, BEAMS, RANGE_MAX))
        figures[f"panoramas_{spacing}_mrays"] = rate = len(points) * BEAMS / seconds / 1e6
        print(f"panoramas, {len(points):6} positions {spacing:4} m apart: {rate:6.1f} million rays/s")
    points = positions(grid, 0.5)
    poses = np.column_stack([points, np.zeros(len(points))])
    bearings = np.arange(BEAMS, dtype=np.float64) * (2 * np.pi / BEAMS)
    seconds = best(lambda: caster.cast(poses, bearings, RANGE_MAX))
    figures["cast_mrays"] = rate = len(points) * BEAMS / seconds / 1e6
    print(f"cast, any pose and bearing:                {rate:6.1f} million rays/s")
    swept, cast = caster.panoramas(points, BEAMS, RANGE_MAX), caster.cast(poses, bearings, RANGE_MAX)
    sample = np.random.default_rng(1).permutation(len(points))[:40]
    exact = traversal(caster, points[sample], bearings)
    for name, ranges in (("panoramas", swept[sample]), ("cast", cast[sample])):
        with np.errstate(invalid="ignore"):
            share = float(((ranges == exact) | (np.abs(ranges - exact) <= 0.01)).mean())
        figures[f"{name}_within_1cm"] = share
        print(f"{name} within 1 cm of exact grid traversal: {share:.2%}")
    if given.json:
        given.json.write_text(json.dumps(figures, indent=1) + "\n")


def positions(grid: GridMap, spacing: float) -> NDArray[np.float64]:
    """Free points on a grid, off the cells' edges."""
    step = round(spacing / grid.resolution)
    rows, columns = np.nonzero(grid.cells[::step, ::step] == FREE)
    return grid.to_map(np.column_stack([columns, rows]) * step + [0.37, 0.61])


def best(run: Callable[[], object], times: int = 7) -> float:
    """Least process time of several runs, s; the first compiles and does not count."""
    run()
    taken = []
    for _ in range(times):
        began = time.process_time()
        run()
        taken.append(time.process_time() - began)
    return min(taken)


def traversal(
    caster: RayCaster, points: NDArray[np.float64], bearings: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Exact ranges (P, B) by plain traversal: every cell's edge that a ray crosses, all rays at once."""
    starts = np.repeat(caster.to_cells(points), len(bearings), axis=0)
    angles = np.tile(bearings - caster.grid.origin[2], len(points))
    direction = np.column_stack([np.cos(angles), np.sin(angles)])
    cell, step = np.floor(starts).astype(np.int64), np.where(direction > 0, 1, -1)
    with np.errstate(divide="ignore"):
        stride = np.abs(1.0 / direction)
        crossing = np.where(direction > 0, cell + 1 - starts, starts - cell) * stride
    travelled, result = np.zeros(len(starts)), np.full(len(starts), np.inf)
    alive = np.arange(len(starts))
    while len(alive):
        value = caster.leap[cell[alive, 1], cell[alive, 0]]
        result[alive[value == 255]] = travelled[alive[value == 255]]
        alive = alive[value < 254]
        axis = np.argmin(crossing[alive], axis=1)
        travelled[alive] = crossing[alive, axis]
        crossing[alive, axis] += stride[alive, axis]
        cell[alive, axis] += step[alive, axis]
        alive = alive[travelled[alive] * caster.grid.resolution <= RANGE_MAX]
    return (result * caster.grid.resolution).reshape(len(points), len(bearings))


if __name__ == "__main__":
    main()
