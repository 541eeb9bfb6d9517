"""Parallel rays from many positions at once: one sweep over the map for each direction.

All rays of one direction are parallel. Walls and positions are visited in the order in which such a ray
meets them, backwards. Each wall cell paints the lanes across the direction that it blocks; a position
reads the two lanes beside it and so knows the first wall before it: a ray costs a few loads. Where a ray
passes the edge of a wall between its two lanes, it is traced from there on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.trace import trace
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import label

LANES_PER_CELL = 8
_PARALLEL = 1e-12
_DIAGONAL = 1.5
"""Cells that a stop reaches along a direction, and some."""


@dataclass(frozen=True)
class Visits:
    """Stops and points in the reverse order in which rays meet them.

    There is one run `bounds[i]:bounds[i + 1]` for each i = 2 * quadrant + (1 if |dy| > |dx|), with quadrant =
    (dx < 0) + 2 * (dy < 0). `x`, `y` (V,): column and row, in cells, of a stop's near corner or of a point.
    `what` (V,): the point's index, WALL_VISIT or DARK_VISIT.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    what: NDArray[np.int32]
    bounds: NDArray[np.int64]


WALL_VISIT, DARK_VISIT = -1, -2


def visits(
    wall: NDArray[np.bool_], dark: NDArray[np.bool_], points: NDArray[np.float64], corner: NDArray[np.int64]
) -> Visits:
    """Visits for a part (h, w) of a map, the cells of which stop a ray, and points (P, 2).

    The points are in continuous (column, row) of the map, the part starts at its cell `corner` (2,). Only
    stops that face the open space around the points are kept.
    """
    columns, rows = np.floor(points).astype(np.int64).T - corner[:, None]
    open_space = _around(~(wall | dark), columns, rows)
    runs: list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]] = []
    for quadrant in range(4):
        left, down = bool(quadrant & 1), bool(quadrant & 2)
        # a ray enters a cell through its near vertical or its near horizontal side
        facing = _shifted(open_space, 1, not left) | _shifted(open_space, 0, not down)
        r, c = np.nonzero(facing & (wall | dark))
        kind = np.where(wall[r, c], WALL_VISIT, DARK_VISIT)
        what = np.concatenate([kind, np.arange(len(points))]).astype(np.int32)
        x = np.concatenate([c + corner[0] + left, points[:, 0]])
        y = np.concatenate([r + corner[1] + down, points[:, 1]])
        by_x = np.concatenate([c, columns]) * (1 if left else -1)
        by_y = np.concatenate([r, rows]) * (1 if down else -1)
        for keys in ((by_y, by_x), (by_x, by_y)):
            order = np.lexsort(keys)
            runs.append((x[order], y[order], what[order]))
    bounds = np.concatenate([[0], np.cumsum([len(run[0]) for run in runs])])
    x, y, what = (np.concatenate([run[i] for run in runs]) for i in range(3))
    return Visits(x, y, what.astype(np.int32), bounds)


def _around(
    free: NDArray[np.bool_], columns: NDArray[np.int64], rows: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """The connected parts of `free` that hold one of the cells."""
    parts, _ = label(free)
    height, width = free.shape
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    held = np.unique(parts[rows[inside], columns[inside]])
    kept: NDArray[np.bool_] = np.isin(parts, held[held > 0])
    return kept


def _shifted(cells: NDArray[np.bool_], axis: int, forwards: bool) -> NDArray[np.bool_]:
    """Each cell's neighbour before it (forwards) or behind it along `axis`; False at the edge."""
    moved = np.zeros_like(cells)
    source, target = (slice(None, -1), slice(1, None)) if forwards else (slice(1, None), slice(None, -1))
    if axis:
        moved[:, target] = cells[:, source]
    else:
        moved[target] = cells[source]
    return moved


def sweep(
    seen: Visits,
    leap: NDArray[np.uint8],
    angles: NDArray[np.float64],
    rows: NDArray[np.int64],
    reach: tuple[float, float],
    unit: float,
    out: NDArray[np.float32],
) -> None:
    """Fills `rows` of `out` (N, P), m, for the directions `angles` (N,), rad, in the grid's frame.

    `reach`: how far from every point all stops are among the visits, and how far a ray goes; in cells,
    `unit` in m per cell. inf where no wall is in sight. Lets other threads run.
    """
    if len(seen.x):
        _sweep(seen.x, seen.y, seen.what, seen.bounds, leap, angles, rows, reach, unit, out)


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _sweep(x, y, what, bounds, leap, angles, rows, reach, unit, out):  # type: ignore[no-untyped-def]
    low_x, high_x, low_y, high_y = x.min(), x.max(), y.min(), y.max()
    for k in rows:
        dx, dy = np.cos(angles[k]), np.sin(angles[k])
        # a lane is a coordinate across the direction; a cell reaches 2 beyond its corner at most. They are
        # counted from the map's corner, so that a point's range does not depend on the other points
        least = np.floor(min(-dy * low_x, -dy * high_x) + min(dx * low_y, dx * high_y)) - 2.0
        width = abs(dy) * (high_x - low_x) + abs(dx) * (high_y - low_y) + 5.0
        lanes = np.full(int(width * LANES_PER_CELL) + 2, -1, dtype=np.int32)
        run = 2 * ((1 if dx < 0.0 else 0) + (2 if dy < 0.0 else 0)) + (1 if abs(dy) > abs(dx) else 0)
        part = slice(bounds[run], bounds[run + 1])
        _sweep_one(x[part], y[part], what[part], leap, dx, dy, least, reach, unit, lanes, out[k])


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _sweep_one(x, y, what, leap, dx, dy, least, reach, unit, lanes, out):  # type: ignore[no-untyped-def]
    inverse_x = 1.0 / dx if abs(dx) > _PARALLEL else 0.0
    inverse_y = 1.0 / dy if abs(dy) > _PARALLEL else 0.0
    across_x, across_y, first = -dy * LANES_PER_CELL, dx * LANES_PER_CELL, int(least) * LANES_PER_CELL
    down, up = _extent(dx, dy)
    near, limit = reach
    for i in range(len(x)):
        place = across_x * x[i] + across_y * y[i]
        if what[i] < 0:
            low, high = int(np.floor(place + down)) + 1, int(np.floor(place + up)) + 1
            for lane in range(low - first, high - first):
                lanes[lane] = i
            continue
        below = int(np.floor(place))
        stop, other = lanes[below - first], lanes[below - first + 1]
        if stop < 0 and other < 0:
            # no stop on the way out of the part of the map that was swept
            reached = trace(leap, x[i], y[i], dx, dy, limit, near)
        elif stop != other:
            reached = _between(x, y, what, leap, dx, dy, i, place - below, stop, other, reach)
        else:
            # what blocks both lanes blocks the ray between them
            reached = max((x[stop] - x[i]) * inverse_x, (y[stop] - y[i]) * inverse_y, 0.0)
            if reached > near:
                # it is among the visits or not by where other points lie, which must make no difference
                reached = trace(leap, x[i], y[i], dx, dy, limit, near)
            elif what[stop] == DARK_VISIT:
                reached = np.inf
        out[what[i]] = reached * unit if reached <= limit else np.inf


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _extent(dx: float, dy: float) -> tuple[float, float]:
    """Lanes that a cell reaches down and up from its near corner."""
    aside_x = (dy if dx < 0.0 else -dy) * LANES_PER_CELL
    aside_y = (-dx if dy < 0.0 else dx) * LANES_PER_CELL
    return min(0.0, aside_x) + min(0.0, aside_y), max(0.0, aside_x) + max(0.0, aside_y)


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _between(x, y, what, leap, dx, dy, i, share, low, high, reach):  # type: ignore[no-untyped-def]
    """Cells from point `i` to the first wall; `share` of a lane above `low`'s lane, below `high`'s."""
    inverse_x = 1.0 / dx if abs(dx) > _PARALLEL else 0.0
    inverse_y = 1.0 / dy if abs(dy) > _PARALLEL else 0.0
    down, up = _extent(dx, dy)
    near, limit = reach
    nearest, hit, doubtful = np.inf, -1, np.inf
    for stop, lanes_aside in ((low, -share), (high, 1.0 - share)):
        if stop < 0:
            continue
        to_x, to_y = x[stop] - x[i], y[stop] - y[i]
        if down <= (dy * to_x - dx * to_y) * LANES_PER_CELL <= up:
            reached = max(to_x * inverse_x, to_y * inverse_y)
            if reached < nearest:
                nearest, hit = reached, stop
        else:
            # the ray passes this stop, which may hide in its lane one that the ray meets behind it
            aside = lanes_aside / LANES_PER_CELL
            reached = max((to_x + dy * aside) * inverse_x, (to_y - dx * aside) * inverse_y)
            doubtful = min(doubtful, reached - _DIAGONAL)
    if min(nearest, doubtful) > near:
        return trace(leap, x[i], y[i], dx, dy, limit, near)
    if doubtful < nearest:
        return trace(leap, x[i], y[i], dx, dy, limit, max(doubtful, 0.0))
    return max(nearest, 0.0) if hit >= 0 and what[hit] == WALL_VISIT else np.inf


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def transpose(source: NDArray[np.float32]) -> NDArray[np.float32]:
    """Contiguous transpose, tile by tile so that both sides stay in the cache."""
    rows, columns = source.shape
    out = np.empty((columns, rows), dtype=np.float32)
    for r0 in range(0, rows, 32):
        for c0 in range(0, columns, 32):
            for c in range(c0, min(c0 + 32, columns)):
                for r in range(r0, min(r0 + 32, rows)):
                    out[c, r] = source[r, c]
    return out
