"""Large sites, built piece by piece: seconds and memory by area, and what a second worker gains.

    .venv/bin/python benchmarks/sharding.py [--areas 3000 12000 50000] [--ratio-area 12000] [--json OUT]

Made-up office floors without two equal rooms, 0.5 m between positions, half a degree. Each area is built by
`eigenscan build` in a process of its own on one thread, so its peak of memory is its own; the map is read
from disk and the models are written. `growth` is the exponent of the CPU seconds against the area from one
row to the next: 1 is a cost in proportion to the area. The ratio is that of the least times of one and of two
dask workers that are started and warm, turn by turn in the same run, with all that the sending process does
for them but the layout, the picture and the swap. On a machine that others load, wall time says little;
therefore also by CPU time: what the sender and the busiest worker spend, one after the other. Set
OMP_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.eigenspace.folder import read_models
from eigenscan.eigenspace.pieces import Pieces
from eigenscan.geometry.gridmap import GridMap, write_map
from eigenscan.mapbuilder.cluster import Workers
from eigenscan.mapbuilder.sharded import build_pieces
from eigenscan.mapbuilder.site import Plan, lay_out
from floors import floor

TURNS = 3


def by_area(area: float, folder: Path) -> dict[str, float]:
    """Cost of the whole command, in its own process."""
    grid = floor(area)
    write_map(grid, folder / "map.yaml")
    command = [
        "-m",
        "eigenscan.cli.main",
        "build",
        folder / "map.yaml",
        "-o",
        folder / "model",
        "--jobs",
        "1",
    ]
    began = time.perf_counter()
    process = os.posix_spawn(
        sys.executable,
        [sys.executable, *map(str, command)],
        os.environ,
        file_actions=[(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)],
    )
    _, status, used = os.wait4(process, 0)
    if status:
        raise SystemExit(f"eigenscan build failed: {status}")
    message = read_models(folder / "model").to_message()
    return {
        "free_m2": grid.free_area,
        "regions": len(message.entries),
        "wall_s": time.perf_counter() - began,
        "cpu_s": used.ru_utime + used.ru_stime,
        "peak_mb": used.ru_maxrss / 1024,
        "wire_mb": sum(entry.size for entry in message.entries) / 1e6,
    }


def one_and_two(area: float, folder: Path) -> dict[str, Any]:
    """Seconds of one and of two workers, turn by turn; the models must be the same."""
    grid, plan = floor(area), Plan()
    layout = lay_out(grid, plan)
    wall: dict[int, list[float]] = {1: [], 2: []}
    cpu: dict[int, list[float]] = {1: [], 2: []}
    versions = set()
    with Workers(1) as one, Workers(2) as two:
        for workers in (one, two):
            small = floor(300.0)
            build(small, Plan(), lay_out(small, plan), folder / "warm", workers)
        for _ in range(TURNS):
            for workers in (one, two):
                before, began, own = spent(workers), time.perf_counter(), time.process_time()
                versions.add(build(grid, plan, layout, folder / "timed", workers))
                wall[workers.count].append(time.perf_counter() - began)
                own = time.process_time() - own
                cpu[workers.count].append(own + max(t - before[w] for w, t in spent(workers).items()))
    if len(versions) != 1:
        raise SystemExit("one and two workers built different models")
    result: dict[str, Any] = {"free_m2": grid.free_area}
    for name, taken in (("wall", wall), ("cpu", cpu)):
        ratio = min(taken[1]) / min(taken[2])
        result |= {f"{name}_one_s": min(taken[1]), f"{name}_two_s": min(taken[2]), f"{name}_ratio": ratio}
    return result


def spent(workers: Workers) -> dict[str, float]:
    """CPU seconds of each worker so far."""
    times: dict[str, float] = workers.client.run(time.process_time)
    return times


def build(grid: GridMap, plan: Plan, layout: Any, folder: Path, workers: Workers) -> str:
    with Pieces(folder) as pieces:
        ready, _ = build_pieces(grid, plan, layout, pieces, engine=workers)
        return " ".join(piece.entry.version for _, piece in sorted(ready.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--areas", type=float, nargs="*", default=[3000, 12000, 50000])
    parser.add_argument("--ratio-area", type=float, default=12000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows: list[dict[str, float]] = []
    for area in options.areas:
        with tempfile.TemporaryDirectory() as folder:
            row = by_area(area, Path(folder))
        row["cpu_s_per_1000_m2"] = 1000 * row["cpu_s"] / row["free_m2"]
        if rows:
            larger = np.log(row["free_m2"] / rows[-1]["free_m2"])
            row["growth"] = float(np.log(row["cpu_s"] / rows[-1]["cpu_s"]) / larger)
        else:
            print(" | ".join([*row, "growth"]))
        rows.append(row)
        print(" | ".join(f"{v:.3g}" if v < 1000 else f"{v:.0f}" for v in row.values()), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        both = one_and_two(options.ratio_area, Path(folder))
    for name in ("wall", "cpu"):
        one, two, ratio = (both[f"{name}_{what}"] for what in ("one_s", "two_s", "ratio"))
        print(
            f"{both['free_m2']:.0f} m2, {name}: one {one:.1f} s, two workers {two:.1f} s, {ratio:.2f} times"
        )
    print(f"{os.getloadavg()[0]:.1f} processes wanted the machine's {os.cpu_count()} cores")
    if options.json:
        options.json.write_text(json.dumps({"areas": rows, "workers": both}, indent=1) + "\n")


if __name__ == "__main__":
    main()
