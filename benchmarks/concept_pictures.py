"""The pictures of docs/concepts.md, from a real map and a real scan.

benchmarks/concept_pictures.py --map MAP.yaml --log LOG --truth REF.tum --scan 3000 --out FOLDER
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from eigenscan.eigenspace.components import Eigenspace, analyse
from eigenscan.eigenspace.model import RegionModel
from eigenscan.eigenspace.panorama import windows
from eigenscan.eigenspace.ranges import RangeTransform
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.localize import Localizer, Scan, read_log

mpl.use("Agg")
from matplotlib import pyplot

SHOWN = 4
CAP = 8.0
"""m: where few beams see farther, a greater cap lets those few places fill the picture."""
COLOURS = ["#4c78a8", "#f58518", "#54a24b", "#b279a2"]
STAR: Any = {"color": "#d62728", "marker": "*", "s": 300, "edgecolor": "white", "zorder": 5}


@dataclass(frozen=True)
class Example:
    """A scan of a log, where it was taken (3,), and the region that it was taken in."""

    scan: Scan
    pose: np.ndarray
    grid: GridMap
    region: RegionModel
    space: Eigenspace

    @property
    def reduced(self) -> np.ndarray:
        """The scan on the eigenspace's beams, in what is analysed: m, no return as the cap."""
        sensor, ranges = self.region.sensor, np.asarray(self.scan.ranges, dtype=np.float64)
        angles = self.scan.angle_min + self.scan.angle_increment * np.arange(len(ranges))
        ranges = np.where(ranges < self.scan.range_max, ranges, CAP)
        wanted = sensor.angle_min + sensor.angle_increment * np.arange(sensor.beams)
        return RangeTransform(CAP)(np.interp(wanted, angles, ranges))

    @property
    def degrees(self) -> np.ndarray:
        """Direction of each of those beams."""
        sensor = self.region.sensor
        return np.degrees(sensor.angle_min + sensor.angle_increment * np.arange(sensor.beams))


def choose(map_file: Path, log: Path, truth: Path, number: int) -> Example:
    """The `number`th scan of a log, with its reference pose."""
    localizer = Localizer.from_map(map_file)
    scan, _ = read_log(log)[number]
    rows = np.loadtxt(truth)
    row = rows[np.argmin(np.abs(rows[:, 0] - scan.time))]
    pose = np.array([row[1], row[2], 2 * np.arctan2(row[6], row[7])])
    nearest = [
        np.hypot(*(r.positions - pose[:2]).T).min() + 1e-3 * len(r.index) for r in localizer.site.regions
    ]
    region = localizer.site.regions[int(np.argmin(nearest))]
    space = analyse(RangeTransform(CAP)(region.panoramas), region.sensor.beams, share=region.space.explained)
    return Example(scan, pose, localizer.site.grid, region, space)


def draw_components(example: Example, path: Path) -> None:
    """The eigen-scans of a region, and a scan made of few of them."""
    space, degrees, scan = example.space, example.degrees, example.reduced
    share = 100 * space.eigenvalues / space.total_variance
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(12, 4), layout="constrained")
    for k in range(SHOWN):
        left.plot(
            degrees, space.vectors[k], color=COLOURS[k], label=f"{k + 1}: {share[k]:.0f} % of the variance"
        )
    left.set(title="The first four eigen-scans of one room", xlabel="beam, degrees", ylabel="weight")
    left.set_ylim(-0.085, 0.13)
    left.legend(frameon=False, loc="upper center", ncols=2)
    right.plot(degrees, scan, color="black", linewidth=1, label="a real scan")
    for count, colour in ((4, COLOURS[0]), (len(space.vectors), COLOURS[1])):
        made = space.reconstruct(np.pad(space.project(scan)[:count], (0, len(space.vectors) - count)))
        right.plot(degrees, made, color=colour, label=f"made of {count} eigen-scans")
    right.set(
        title="A scan, said in a few numbers", xlabel="beam, degrees", ylabel="range, m", ylim=(0, None)
    )
    right.legend(frameon=False)
    _save(figure, path)


def draw_manifold(example: Example, path: Path) -> None:
    """All places of a room in the first coefficients, at the scan's heading, and the scan among them."""
    region, space = example.region, example.space
    sensor, turn = region.sensor, region.panoramas.shape[1]
    window = np.round(sensor.window_of(np.array([example.pose[2]]), turn)).astype(np.int64) % turn
    scans = windows(region.panoramas, np.repeat(window, len(region.positions)), sensor.beams)
    alpha = space.project(RangeTransform(CAP)(scans))
    own = space.project(example.reduced)
    colours = _by_place(region.positions)
    figure, (plan, sheet) = pyplot.subplots(1, 2, figsize=(10, 5), layout="constrained", width_ratios=(2, 3))
    _draw_plan(plan, example, colours)
    sheet.scatter(alpha[:, 0], alpha[:, 1], c=colours, s=22)
    sheet.scatter(own[0], own[1], label="the scan", **STAR)
    sheet.set(
        title="…and where they are in eigenspace", xlabel="first coefficient", ylabel="second coefficient"
    )
    sheet.legend(loc="upper right")
    _save(figure, path)


def _draw_plan(plan: Any, example: Example, colours: np.ndarray) -> None:
    grid, points = example.grid, example.region.positions
    grey = np.full(grid.cells.shape, 0.85)
    grey[grid.cells == FREE], grey[grid.cells == OCCUPIED] = 1.0, 0.2
    height, width = grid.cells.shape
    x, y = grid.origin[:2]
    size = grid.resolution
    plan.imshow(
        grey, "gray", vmin=0, vmax=1, origin="lower", extent=(x, x + width * size, y, y + height * size)
    )
    plan.scatter(*points.T, c=colours, s=14)
    plan.scatter(*example.pose[:2], **STAR)
    low, high = points.min(axis=0) - 2, points.max(axis=0) + 2
    plan.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    plan.set(title="Places of a room, each with a colour…", xlabel="x, m", ylabel="y, m")


def _by_place(points: np.ndarray) -> np.ndarray:
    """A colour for each place: neighbours have like ones."""
    unit = (points - points.min(axis=0)) / np.ptp(points, axis=0)
    hue = np.arctan2(unit[:, 1] - 0.5, unit[:, 0] - 0.5) / TURN + 0.5
    value = 0.55 + 0.4 * np.hypot(*(unit - 0.5).T)
    return mpl.colors.hsv_to_rgb(np.stack([hue, np.full(len(hue), 0.75), np.clip(value, 0, 1)], axis=1))


def _save(figure: Any, path: Path) -> None:
    figure.savefig(path, dpi=90)
    pyplot.close(figure)
    print(path)


def main() -> None:
    """Draws both pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in ("map", "log", "truth", "out"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    parser.add_argument("--scan", type=int, default=0, help="number of the scan in the log")
    given = parser.parse_args()
    example = choose(given.map, given.log, given.truth, given.scan)
    draw_components(example, given.out / "eigenscans.png")
    draw_manifold(example, given.out / "manifold.png")


if __name__ == "__main__":
    main()
