"""Walls as intervals: where a beam enters and leaves a wall, and how far it gets beyond.

A wall's surface lies anywhere in the wall as drawn. So a beam has passed a wall only if it leaves everything
that is drawn, and more surely the farther it gets: a beam along a wall is metres long in it.
"""

from __future__ import annotations

import numpy as np
from eigenscan.projector.wall_field import WallField, distance_at
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Singles = NDArray[np.float32]
Words = NDArray[np.uint32]

STEP_M = 0.1
"""m along a beam, from one look at its clearance to the next: half of that is the most that is overlooked."""
FAR_OFF = 0.5
"""m: a beam that got so far away from every wall is as good as beyond the one that it met."""


def leaving(field: WallField, positions: Array, entered: Singles, until: float) -> Singles:
    """Ranges (P, N), m, at which rays from positions (P, 2) leave the walls that they `entered` (P, N).

    Ray k looks along world direction k 2 pi / N. +inf where no wall is in sight, or it ends before `until`.
    """
    turn = entered.shape[1]
    poses = np.column_stack([positions, np.zeros(len(positions))])
    out = np.full(entered.shape, np.inf, dtype=np.float32)
    _leaving(
        field.cells,
        field.cell,
        field.cells_of(poses),
        np.arange(turn) * (2.0 * np.pi / turn),
        entered,
        until,
        out,
    )
    return out


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _leaving(
    cells: Words, cell: float, poses: Array, bearings: Array, entered: Singles, until: float, out: Singles
) -> None:
    height, width = cells.shape
    half = 0.5 * cell
    for i in range(len(poses)):
        x, y = poses[i, 0], poses[i, 1]
        for j in range(len(bearings)):
            angle = poses[i, 2] + bearings[j]
            dx, dy = np.cos(angle) / cell, np.sin(angle) / cell
            along = entered[i, j] + half
            while along < until:
                u, v = x + dx * along, y + dy * along
                inside = 0.0 <= u < width and 0.0 <= v < height
                if not inside or distance_at(cells[int(v), int(u)]) >= half:
                    out[i, j] = along
                    break
                along += half


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def find_clearance(
    cells: Words, cell: float, poses: Array, bearings: Array, entered: Singles, seen: Singles, out: Singles
) -> None:
    """How far (n, B), m, beams got away from every wall after they `entered` (n, B) one; 0 if they did not.

    From poses (n, 3) in the field, see WallField.cells_of, along `bearings` (B,) to where they ended, `seen`
    (B,); about FAR_OFF at most. `out` must be 0 before.
    """
    flat, columns = cells.reshape(-1), np.int64(cells.shape[1])
    right, top = float(cells.shape[1]), float(cells.shape[0])
    half = 0.5 * cell
    least = max(half, STEP_M)
    cos, sin = np.cos(bearings) / cell, np.sin(bearings) / cell
    dx, dy, along, ends = np.empty((4, len(bearings)))
    most, under_way = np.empty(len(bearings)), np.empty(len(bearings), dtype=np.uint32)
    for i in range(len(poses)):
        x, y = poses[i, 0], poses[i, 1]
        ahead, aside = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        count = 0
        for j in range(len(bearings)):
            dx[j], dy[j] = ahead * cos[j] - aside * sin[j], aside * cos[j] + ahead * sin[j]
            ends[j], most[j] = seen[j], 0.0
            along[j] = min(entered[i, j] + half, ends[j])
            under_way[count] = j
            count += entered[i, j] < seen[j]
        # all beams a step, and again, without branches, as rays are cast
        while count > 0:
            going = 0
            for k in range(count):
                j = under_way[k]
                u, v = x + dx[j] * along[j], y + dy[j] * along[j]
                inside = (u >= 0.0) & (u < right) & (v >= 0.0) & (v < top)
                at = np.uint64(np.int64(v) * columns + np.int64(u) if inside else 0)
                distance = distance_at(flat[at]) if inside else FAR_OFF
                most[j] = max(most[j], distance) if inside else FAR_OFF
                out[i, j] = most[j]
                under_way[going] = j
                going += (most[j] < FAR_OFF) & (along[j] < ends[j])
                # distances change by no more than the way: what is much farther off is not stepped over
                along[j] = min(along[j] + max(most[j] - distance, least), ends[j])
            count = going
