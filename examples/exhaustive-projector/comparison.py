"""A scan against everything that the map could show: all panoramas, all headings, then the map itself.

Poses are the sensor's, (x m, y m, theta rad), in the map frame. Needs numpy alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DIRECTIONS = 120  # of a turn: 3 degrees
CAP = 10.0  # m: a wall farther than that, or none, counts as this
TRUNCATION = 1.0  # m: a beam that is off by more is off
CANDIDATES = 250
BEAMS = 60  # of a scan that are compared with the map
FIELD_REACH = 1.0  # m: farther from a wall is as far
LEVELS = (
    (0.25, 0.06, 0.3),
    (0.12, 0.03, 0.2),
    (0.06, 0.015, 0.12),
    (0.03, 0.008, 0.08),
    (0.015, 0.004, 0.06),
)
"""Step (m), step (rad) and width of a wall (m) of each round of refinement."""
WALL = 0.07  # m: width of a wall in the final comparison
APART = (1.0, 0.3)  # m, rad: nearer poses are one
LISTED = 20
EVIDENCE = 0.5 * BEAMS  # neighbours see the same wall: two beams are worth one
SEEN_BY_RIGHT = 0.8  # share of the beams that the right pose explains, people in the room included
SEEN_BY_CHANCE = 0.5  # share that the best pose of a place explains where the scan was not taken
RAY_STEP = 0.1  # m, between the points of a beam that must be free


@dataclass(frozen=True)
class Building:
    """Panoramas (P, N), m, at positions (P, 2), the index of their regions (P,), and the map."""

    panoramas: NDArray[np.float32]
    positions: Array
    regions: NDArray[np.int64]
    field: NDArray[np.float32]  # m to the nearest wall, row by row
    free: NDArray[np.bool_]
    origin: Array
    resolution: float

    def cells(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows and columns of map-frame points (..., 2); of those outside, the nearest cell's."""
        c, s = np.cos(self.origin[2]), np.sin(self.origin[2])
        away = points - self.origin[:2]
        columns = (away[..., 0] * c + away[..., 1] * s) / self.resolution
        rows = (away[..., 1] * c - away[..., 0] * s) / self.resolution
        height, width = self.field.shape
        return np.clip(rows.astype(np.int64), 0, height - 1), np.clip(columns.astype(np.int64), 0, width - 1)


@dataclass(frozen=True)
class Found:
    """Poses (k, 3), most likely first, with covariances (k, 3, 3); the rest is (k,)."""

    poses: Array
    covariances: Array
    log_likelihoods: Array
    explained: Array
    regions: NDArray[np.int64]


def coarse(panoramas: NDArray[np.float32]) -> NDArray[np.float32]:
    """Panoramas (P, N) at DIRECTIONS directions, capped; the beam nearest to each direction."""
    count = panoramas.shape[1]
    nearest = np.round(np.arange(DIRECTIONS) * count / DIRECTIONS).astype(np.int64) % count
    return np.minimum(panoramas[:, nearest], np.float32(CAP))


def distance_field(occupied: NDArray[np.bool_], resolution: float) -> NDArray[np.float32]:
    """Metres from each cell to the nearest occupied one, at most FIELD_REACH: along columns, then rows."""
    reach = int(FIELD_REACH / resolution)
    padded = np.pad(
        np.where(occupied, 0.0, FIELD_REACH**2).astype(np.float32), reach, constant_values=FIELD_REACH**2
    )
    height, width = occupied.shape
    steps = np.arange(-reach, reach + 1)
    squares = (steps * resolution) ** 2
    columns = np.min(
        [padded[reach + k : reach + k + height] + d for k, d in zip(steps, squares, strict=True)], axis=0
    )
    rows = np.min(
        [columns[:, reach + k : reach + k + width] + d for k, d in zip(steps, squares, strict=True)], axis=0
    )
    field: NDArray[np.float32] = np.sqrt(np.minimum(rows, FIELD_REACH**2)).astype(np.float32)
    return field


def locate(building: Building, bearings: Array, ranges: Array) -> Found:
    """Where a scan may have been taken; ranges (B,) m, +inf: no return, NaN: missing."""
    hits = np.flatnonzero(np.isfinite(ranges))
    hits = hits[np.linspace(0, len(hits) - 1, min(BEAMS, len(hits))).astype(np.int64)]
    points = ranges[hits, None] * np.stack([np.cos(bearings[hits]), np.sin(bearings[hits])], axis=1)
    poses, regions = _candidates(building, bearings, ranges)
    for step, turn, width in LEVELS:
        poses = _climb(building, poses, points, step, turn, width)
    on_wall = _support(building, poses, points, WALL)
    kept = _distinct(poses, on_wall)
    poses, regions = poses[kept], regions[kept]
    explained = np.clip(on_wall[kept] - _through_walls(building, poses, points), 0.0, 1.0)
    likelihoods = _log_likelihoods(explained)
    order = np.argsort(-likelihoods, kind="stable")[:LISTED]
    covariances = _covariances(building, poses[order], points)
    return Found(poses[order], covariances, likelihoods[order], explained[order], regions[order])


def _candidates(building: Building, bearings: Array, ranges: Array) -> tuple[Array, NDArray[np.int64]]:
    """The CANDIDATES poses of the lattice whose panoramas are nearest to the scan, by truncated distance."""
    step = 2.0 * np.pi / DIRECTIONS
    first, last = (int(np.round(bearings[i] / step)) for i in (0, -1))
    wanted = np.arange(first, min(last, first + DIRECTIONS - 1) + 1)
    nearest = np.abs(bearings[None, :] - (wanted * step)[:, None]).argmin(axis=1)
    scan = np.minimum(ranges[nearest], CAP).astype(np.float32)
    known = np.flatnonzero(~np.isnan(scan))
    cost = np.zeros(building.panoramas.shape, dtype=np.float32)  # by position and heading
    for j in known:  # one beam against all poses at once
        turned = np.roll(building.panoramas, -int(wanted[j]), axis=1)
        cost += np.minimum(np.abs(turned - scan[j]), np.float32(TRUNCATION))
    count = min(CANDIDATES, cost.size)
    best = np.argpartition(cost.ravel(), count - 1)[:count]
    position, heading = np.unravel_index(best, cost.shape)
    theta = heading * step
    return np.column_stack([building.positions[position], theta]), building.regions[position]


def _ends(poses: Array, points: Array) -> Array:
    """Points (B, 2) of the sensor's frame as seen from each pose (..., 3): (..., B, 2), map frame."""
    c, s = np.cos(poses[..., 2:]), np.sin(poses[..., 2:])
    x = poses[..., 0:1] + c * points[:, 0] - s * points[:, 1]
    y = poses[..., 1:2] + s * points[:, 0] + c * points[:, 1]
    return np.stack([x, y], axis=-1)


def _support(building: Building, poses: Array, points: Array, width: float) -> Array:
    """Share of the points (B, 2) that lie on walls of that width, softly, for each pose (..., 3)."""
    away = building.field[building.cells(_ends(poses, points))]
    support: Array = np.exp(-0.5 * (away / width) ** 2).mean(axis=-1)
    return support


def _climb(building: Building, poses: Array, points: Array, step: float, turn: float, width: float) -> Array:
    """Each pose (n, 3), or the best of its 26 neighbours."""
    around = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    neighbours: Array = poses[:, None, :] + around * np.array([step, step, turn])
    best = _support(building, neighbours, points, width).argmax(axis=1)
    climbed: Array = neighbours[np.arange(len(poses)), best]
    return climbed


def _distinct(poses: Array, scores: Array) -> NDArray[np.int64]:
    """Indices of the best pose of each neighbourhood, best first, at most twice as many as are listed."""
    kept: list[int] = []
    left = np.argsort(-scores, kind="stable")
    while len(left) and len(kept) < 2 * LISTED:
        best, left = int(left[0]), left[1:]
        kept.append(best)
        turn = np.abs((poses[left, 2] - poses[best, 2] + np.pi) % (2.0 * np.pi) - np.pi)
        far = np.hypot(*(poses[left, :2] - poses[best, :2]).T) > APART[0]
        left = left[far | (turn > APART[1])]
    return np.array(kept, dtype=np.int64)


def _through_walls(building: Building, poses: Array, points: Array) -> Array:
    """Share of the beams that would have to cross something that is not free."""
    reach = np.hypot(points[:, 0], points[:, 1])
    along = np.arange(RAY_STEP, reach.max() + RAY_STEP, RAY_STEP)
    before_end = along[None, :] < reach[:, None] - 2.5 * WALL
    share = np.where(before_end, along[None, :] / reach[:, None], 0.0)
    inner = share[..., None] * points[:, None, :]
    blocked = [~building.free[building.cells(_ends(pose, inner.reshape(-1, 2)))] for pose in poses]
    crossed = np.array(blocked).reshape(len(poses), *before_end.shape) & before_end
    share_crossed: Array = crossed.any(axis=2).mean(axis=1)
    return share_crossed


def _log_likelihoods(explained: Array) -> Array:
    """Log odds of each pose against a place that the map does not show: EVIDENCE coins, explained or not."""
    hit = np.log(SEEN_BY_RIGHT / SEEN_BY_CHANCE)
    miss = np.log((1.0 - SEEN_BY_RIGHT) / (1.0 - SEEN_BY_CHANCE))
    nats: Array = EVIDENCE * (explained * hit + (1.0 - explained) * miss)
    return nats


def _covariances(building: Building, poses: Array, points: Array) -> Array:
    """Inverse information (k, 3, 3) of points that slide on walls; what no wall holds is half a metre.

    On a wall half the squared distance curves across it by 1, and along it by 0: that is what a point holds.
    Nothing is known better than to a cell, and to the last steps of the search.
    """
    ends = _ends(poses, points)
    step = 2.0 * building.resolution

    def q(x: float, y: float) -> Array:
        return 0.5 * building.field[building.cells(ends + step * np.array([x, y]))].astype(np.float64) ** 2

    curve = np.empty((*ends.shape[:2], 2, 2))
    curve[..., 0, 0] = q(1, 0) + q(-1, 0) - 2.0 * q(0, 0)
    curve[..., 1, 1] = q(0, 1) + q(0, -1) - 2.0 * q(0, 0)
    curve[..., 0, 1] = curve[..., 1, 0] = 0.25 * (q(1, 1) + q(-1, -1) - q(1, -1) - q(-1, 1))
    near = building.field[building.cells(ends)] < 2.0 * WALL
    curve *= near[..., None, None] / step**2
    arm = ends - poses[:, None, :2]
    J = np.broadcast_to(np.eye(2, 3), (*ends.shape[:2], 2, 3)).copy()
    J[..., 0, 2], J[..., 1, 2] = -arm[..., 1], arm[..., 0]
    held = np.einsum("kbji,kbjl,kblm->kim", J, curve, J) * EVIDENCE / (len(points) * WALL**2)
    values, vectors = np.linalg.eigh(held)
    held = np.einsum("kij,kj,klj->kil", vectors, np.maximum(values, 0.0), vectors)
    cell = np.diag([building.resolution, building.resolution, LEVELS[-1][1] + LEVELS[-2][1]]) ** 2
    covariances: Array = np.linalg.inv(held + np.diag([4.0, 4.0, 25.0])) + cell
    return covariances
