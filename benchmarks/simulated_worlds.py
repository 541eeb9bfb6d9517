"""Drives through simulated buildings that their maps do not quite show, written as logs to be evaluated."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from eigenscan.geometry.gridmap import GridMap, write_map
from eigenscan.workbench.simulation.world import office
from floors import floor, warehouse

EIGENSCAN = Path(sys.executable).parent / "eigenscan"
SECONDS = 180
LACKING = 3
"""Of the office's furniture every so manieth piece is not in the map."""


@dataclass(frozen=True)
class World:
    """A building as it is and as its map shows it, and what drives through it."""

    name: str
    real: GridMap
    known: GridMap
    lidar: tuple[str, ...]
    seed: int


def worlds() -> list[World]:
    """Four lidars in the demo's office, in floors of other sizes and among racks that a plan draws filled."""
    plan = office()
    real = plan.render()
    known = replace(plan, furniture=tuple(f for i, f in enumerate(plan.furniture) if i % LACKING)).render()
    small, large = floor(400, seed=5), floor(1500, seed=6)
    deep, racks = warehouse(1.1, seed=7), warehouse(0.6, seed=8)
    wide = ("--fov", "270", "--beams", "541", "--range-max", "20", "--noise", "0.03")
    full = ("--fov", "360", "--beams", "360", "--range-max", "12")
    short = ("--fov", "240", "--beams", "667", "--range-max", "5.6")
    return [
        World("office, 180°", real, known, (), 11),
        World("office, 240°, 5.6 m", real, known, short, 12),
        World("floor 400 m², 360°", small, small, full, 13),
        World("floor 1,500 m², 270°", large, large, wide, 14),
        World("racks of 1.1 m, 360°", deep, deep, full, 15),
        World("racks of 0.6 m, 360°", racks, racks, full, 16),
    ]


def write(world: World, folder: Path) -> None:
    """log.mcap, log.tum and map.yaml of a drive of SECONDS among six people."""
    folder.mkdir(parents=True)
    write_map(world.real, folder / "real.yaml")
    write_map(world.known, folder / "map.yaml")
    command: list[str | Path] = [EIGENSCAN, "simulate", "--map", folder / "real.yaml"]
    command += [
        "-o",
        folder / "log.mcap",
        "--truth",
        folder / "log.tum",
        "--seconds",
        str(SECONDS),
        "--people",
        "6",
    ]
    subprocess.run([*command, "--seed", str(world.seed), *world.lidar], check=True)
