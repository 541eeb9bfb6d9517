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
from eigenscan.geometry.raycast import RayCaster
from eigenscan.localize import Localizer, Scan, read_log
from scipy.spatial import Delaunay

mpl.use("Agg")
from matplotlib import pyplot

SHOWN = 4
CAP = 8.0
"""m: where few beams see farther, a greater cap lets those few places fill the picture."""
COLOURS = ["#4c78a8", "#f58518", "#54a24b", "#b279a2"]
RANGE_MAX = 80.0
REACH, FINE, TURNED = 0.7, 0.1, 16
"""m around the scan's place, m between places; steps of heading."""
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
        transformed: np.ndarray = RangeTransform(CAP)(np.interp(wanted, angles, ranges))
        return transformed

    @property
    def degrees(self) -> np.ndarray:
        """Direction of each of those beams."""
        sensor = self.region.sensor
        degrees: np.ndarray = np.degrees(sensor.angle_min + sensor.angle_increment * np.arange(sensor.beams))
        return degrees


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


def draw_surfaces(example: Example, path: Path) -> None:
    """Figures 3 and 4 of the paper, of a real room: a synthetic scan; a triangle of places in eigenspace."""
    region, turn = example.region, example.region.panoramas.shape[1]
    fine = _around(example, REACH, FINE)
    colours = _by_place(fine)
    figure = pyplot.figure(figsize=(13, 5.6), layout="constrained")
    plan: Any = figure.add_subplot(1, 2, 1)
    space: Any = figure.add_subplot(1, 2, 2, projection="3d")
    space.computed_zorder = False  # what is drawn later is seen
    _draw_synthetic(plan, example)
    plan.scatter(*fine.T, c=colours, s=12)
    triangles = Delaunay(fine).simplices
    heading = region.sensor.window_of(np.array([example.pose[2]]), turn)
    sheet = _coefficients(example, fine, heading)
    surface = space.plot_trisurf(*sheet.T, triangles=triangles, edgecolor="white", linewidth=0.2, alpha=0.8)
    surface.set_facecolor(colours[triangles].mean(axis=1))
    loop = _coefficients(example, example.pose[None, :2], heading + np.arange(-TURNED, TURNED + 1))
    space.plot(
        *loop.T,
        color="black",
        linewidth=1,
        label=f"the place, turned by up to {TURNED / turn * 360:.0f}°",
    )
    corners = _triangle(example)
    closed = np.vstack([corners, corners[:1]])
    plan.plot(*closed.T, color="black", linewidth=1.5)
    space.plot(
        *_coefficients(example, closed, heading).T,
        color="black",
        linewidth=2,
        label="a triangle of the model's places",
    )
    space.scatter(*example.space.project(example.reduced)[:3], label="the scan", **STAR)
    space.set(
        title="…and in eigenspace", xlabel="coefficient 1", ylabel="coefficient 2", zlabel="coefficient 3"
    )
    space.legend(loc="upper left", frameon=False)
    space.view_init(elev=38, azim=-75)
    _save(figure, path)


def _around(example: Example, reach: float, spacing: float) -> np.ndarray:
    """Free points (n, 2) on a grid around the scan's place."""
    steps = np.arange(-reach, reach + spacing / 2, spacing)
    points = example.pose[:2] + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    free: np.ndarray = points[example.grid.at(points) == FREE]
    return free


def _triangle(example: Example) -> np.ndarray:
    """The three places (3, 2) of the model around the scan's."""
    net = Delaunay(example.region.positions)
    corners: np.ndarray = example.region.positions[net.simplices[net.find_simplex(example.pose[:2])]]
    return corners


def _coefficients(example: Example, places: np.ndarray, headings: np.ndarray) -> np.ndarray:
    """First three coefficients (n, 3) of what is seen at places (n, 2) or one, at windows (n,) or one."""
    turn = example.region.panoramas.shape[1]
    panoramas = RayCaster.of(example.grid).panoramas(places, turn, RANGE_MAX)
    count = max(len(places), len(headings))
    which = np.broadcast_to(np.round(headings).astype(np.int64) % turn, count)
    scans = windows(np.broadcast_to(panoramas, (count, turn)), which, example.region.sensor.beams)
    coefficients: np.ndarray = example.space.project(RangeTransform(CAP)(scans))[:, :3]
    return coefficients


def _draw_synthetic(plan: Any, example: Example) -> None:
    """The rays of the panorama at the scan's place; those in the sensor's field stronger."""
    _draw_plan(plan, example, np.full((len(example.region.positions), 3), 0.6))
    turn, place = example.region.panoramas.shape[1], example.pose[:2]
    (ranges,) = RayCaster.of(example.grid).panoramas(place[None], turn, RANGE_MAX)
    half = np.radians(example.degrees.max())
    for index in range(0, turn, turn // 90):
        angle, reach = index * TURN / turn, min(float(ranges[index]), RANGE_MAX)
        ahead = np.abs((angle - example.pose[2] + np.pi) % TURN - np.pi) <= half
        end = place + reach * np.array([np.cos(angle), np.sin(angle)])
        plan.plot(*np.stack([place, end]).T, color=COLOURS[1] if ahead else "0.75", linewidth=0.8)
    plan.set(title="What a place sees, cast in the map; places around it by colour…")
    plan.set(xlim=place[0] + np.array([-4, 4]), ylim=place[1] + np.array([-3.5, 3.5]))


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
    """Draws the pictures."""
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
    draw_surfaces(example, given.out / "surfaces.png")


if __name__ == "__main__":
    main()
