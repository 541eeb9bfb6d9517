"""A building's models: seconds, megabytes, memory, by area and threads.

    python benchmarks/build.py [--spacing 0.25] [--json OUT]

The building is an office of rooms of 4 m x 5 m on both sides of hallways, furnished, repeated to the area.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import time
from dataclasses import replace
from multiprocessing import get_context
from typing import Any

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.mapbuilder.site import Plan, build_site

RESOLUTION = 0.05


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--spacing", type=float, default=0.25)
    arguments.add_argument("--areas", type=float, nargs="+", default=[700.0, 2800.0])
    arguments.add_argument("--json", type=str)
    given = arguments.parse_args()
    figures: dict[str, Any] = {"build": []}
    plan = Plan(spacing=given.spacing)
    cores = len(os.sched_getaffinity(0))
    names = ("m2", "threads", "s", "CPU s", "regions", "positions", "MB wire", "MB peak")
    print(" ".join(f"{name:>9}" for name in names))
    for area in given.areas:
        for threads in sorted({1, 2, cores}):
            with get_context("spawn").Pool(1) as own:  # its peak is this build's, not an earlier one's
                row = own.apply(build, (area, replace(plan, threads=threads)))
            figures["build"].append(row)
            print(" ".join(f"{value:9.4g}" for value in row.values()))
    if given.json:
        with open(given.json, "w", encoding="utf-8") as file:  # noqa: PTH123
            json.dump(figures, file, indent=1)


def build(area: float, plan: Plan) -> dict[str, float]:
    build_site(office(60.0), plan)  # compiles
    grid = office(area)
    began, cpu = time.perf_counter(), time.process_time()
    site = build_site(grid, plan)
    seconds, cpu_seconds = time.perf_counter() - began, time.process_time() - cpu
    message = site.to_message()
    return {
        "m2": grid.free_area,
        "threads": plan.threads,
        "s": seconds,
        "cpu_s": cpu_seconds,
        "regions": len(site.regions),
        "positions": len(np.unique(np.concatenate([m.index for m in site.regions]), axis=0)),
        "wire_mb": sum(entry.size for entry in message.entries) / 1e6,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def office(area: float) -> GridMap:
    """Hallways of 2 m with furnished rooms on both sides, about `area` m2 of free space."""
    rows = max(1, round(np.sqrt(area / 100.0)))
    columns = max(2, round(area / (rows * 47.0)))
    width, height = columns * 4.1 + 2.0, rows * 12.5 + 2.0
    cells = np.full((round(height / RESOLUTION), round(width / RESOLUTION)), UNKNOWN, dtype=np.uint8)
    rng = np.random.default_rng(7)

    def box(x: float, y: float, w: float, h: float, value: int) -> None:
        c, r = round(x / RESOLUTION), round(y / RESOLUTION)
        cells[r : r + round(h / RESOLUTION), c : c + round(w / RESOLUTION)] = value

    for row in range(rows):
        y = 1.0 + row * 12.5
        box(0.9, y - 0.1, columns * 4.1 + 0.2, 12.4, OCCUPIED)
        box(1.0, y + 5.1, columns * 4.1 - 0.1, 2.0, FREE)
        for column in range(columns):
            x = 1.0 + column * 4.1
            for bottom, door in ((y, y + 5.0), (y + 7.2, y + 7.1)):
                box(x, bottom, 4.0, 5.0, FREE)
                box(x + rng.uniform(0.3, 2.7), door, 0.9, 0.1, FREE)
                for _ in range(4):
                    w, h = rng.uniform(0.3, 1.2, 2)
                    box(x + rng.uniform(0, 4 - w), bottom + rng.uniform(0.8, 4.2 - h), w, h, OCCUPIED)
        if row:
            box(1.5, y - 0.3, 1.0, 0.4, FREE)
    return GridMap(cells, RESOLUTION, np.zeros(3))


if __name__ == "__main__":
    main()
