"""Uniform and adaptive positions: how many hold how much of the places between them within a bound.

    .venv/bin/python benchmarks/positions.py [--datasets FOLDER] [--bounds 0.8 1.2 1.6 2.5] [--json OUT]

The bound is on the root mean square error of the panorama that is interpolated between positions, ranges
clipped to 20 m. Uniform grids of 0.5, 0.25 and 0.125 m, and the grid of 0.5 m halved where it asks for it,
twice at most. Each cell: positions, the share of the places midway between them where the bound holds, and MB
of the models on the wire. The datasets are not part of the project; by default they are looked for beside it.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from eigenscan.geometry.gridmap import GridMap, read_map
from eigenscan.mapbuilder.adaptive import HALVINGS, adaptive_positions
from eigenscan.mapbuilder.site import Plan, build_site
from floors import floor
from single_scan import DATASETS

SPACINGS = (0.5, 0.25, 0.125)


def wire_mb(grid: GridMap, plan: Plan) -> float:
    return sum(entry.size for entry in build_site(grid, plan).to_message().entries) / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--bounds", type=float, nargs="+", default=[0.8, 1.2, 1.6, 2.5])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    maps = {"floor (made up)": floor(700.0), "intel": read_map(options.datasets / "intel/map.yaml")}
    rows: list[dict[str, Any]] = []
    print(" | ".join(["map", "bound m", *(f"uniform {s} m" for s in SPACINGS), "adaptive"]))
    for name, grid in maps.items():
        sizes = {spacing: wire_mb(grid, Plan(spacing=spacing, threads=2)) for spacing in SPACINGS}
        for bound in options.bounds:
            cells = []
            for spacing in (*SPACINGS, 0.0):
                plan = Plan(spacing=spacing or SPACINGS[0], error=bound, threads=2)
                positions, share = adaptive_positions(grid, plan, 0 if spacing else HALVINGS)
                size = sizes[spacing] if spacing else wire_mb(grid, replace(plan, error=bound))
                cells.append({"positions": len(positions.index), "share": share, "wire_mb": size})
            rows.append({"map": name, "bound_m": bound, "uniform": cells[:-1], "adaptive": cells[-1]})
            texts = [f"{c['positions']}: {c['share']:.1%}, {c['wire_mb']:.1f} MB" for c in cells]
            print(" | ".join([name, f"{bound:g}", *texts]), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
