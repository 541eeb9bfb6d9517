"""Draws answers on the map, by matplotlib."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.distance_tiles import box_of
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.geometry.pose import compose, transform
from eigenscan.localize.answers import Hypotheses
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.transforms import Affine2D

BEST, OTHER, SEEN = "#d62728", "#1f77b4", "#ff7f0e"
WALL, FLOOR, NOTHING = 0.15, 1.0, 0.85
ALSO_SHOWN = 9
MARGIN = 1.0
"""Margin around the known part of the map, m."""


def draw(grid: GridMap, found: Hypotheses | None, axes: Axes | None) -> Axes:
    """The map; the best pose as a red arrow with its scan, others in blue, fainter where less likely."""
    if axes is None:
        _, axes = pyplot.subplots(figsize=(8, 6), layout="constrained")
    _draw_map(grid, axes)
    if found is not None and len(found.poses):
        _draw_poses(found, axes)
        _draw_scan(found, axes)
        axes.legend(loc="upper right")
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
    return axes


def _draw_map(grid: GridMap, axes: Axes) -> None:
    grey = np.full(grid.cells.shape, NOTHING)
    grey[grid.cells == FREE], grey[grid.cells == OCCUPIED] = FLOOR, WALL
    height, width = grid.cells.shape
    x, y, theta = grid.origin
    placed = Affine2D().scale(grid.resolution).rotate(theta).translate(x, y) + axes.transData
    axes.imshow(grey, "gray", vmin=0, vmax=1, origin="lower", extent=(0, width, 0, height), transform=placed)
    rows, columns = box_of(grid.cells != UNKNOWN)
    ends = [[c, r] for c in (columns.start, columns.stop) for r in (rows.start, rows.stop)]
    corners = grid.to_map(np.array(ends))
    low, high = corners.min(axis=0) - MARGIN, corners.max(axis=0) + MARGIN
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def _draw_poses(found: Hypotheses, axes: Axes) -> None:
    odds = np.exp(found.log_likelihoods - found.log_likelihoods[0])
    shown = found.poses[: 1 + ALSO_SHOWN]
    for number in range(len(shown) - 1, -1, -1):
        x, y, theta = shown[number]
        axes.quiver(
            *(x, y, np.cos(theta), np.sin(theta)),
            color=BEST if number == 0 else OTHER,
            alpha=1.0 if number == 0 else 0.4 + 0.6 * float(odds[number]),
            label={0: "best pose", 1: "other poses"}.get(number),
            scale=18,
            width=0.008,
            zorder=4,
        )


def _draw_scan(found: Hypotheses, axes: Axes) -> None:
    scan = found.scan
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    seen = scan.returns
    points = ranges[seen, None] * np.stack([np.cos(angles[seen]), np.sin(angles[seen])], axis=1)
    x, y = transform(compose(found.poses[0], scan.mount), points).T
    axes.scatter(x, y, s=4, color=SEEN, zorder=3, label="its scan")
