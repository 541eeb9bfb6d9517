"""A small office that no place of looks like another, and scans of it."""

from __future__ import annotations

from functools import cache

import numpy as np
from eigenscan.eigenspace.embedding import Kind
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, to_message
from eigenscan.geometry.pose import compose
from eigenscan.geometry.pose import to_message as pose_message
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.schemas.channels import MAP, MODEL, MODEL_SET, SCAN
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Obstacles
from eigenscan.schemas.scan_pb2 import Scan
from numpy.typing import NDArray

RESOLUTION = 0.05
ADDRESS = {"site": "s", "robot": "r", "lidar": "front"}
Array = NDArray[np.float64]


def _wall(
    cells: NDArray[np.uint8], x0: float, y0: float, x1: float, y1: float, value: int = OCCUPIED
) -> None:
    c0, r0, c1, r1 = (round(v / RESOLUTION) for v in (x0, y0, x1, y1))
    cells[r0 : max(r1, r0 + 1), c0 : max(c1, c0 + 1)] = value


@cache
def office() -> GridMap:
    """16 m x 11 m: a hallway, four different rooms, some furniture."""
    cells = np.full((round(11 / RESOLUTION), round(16 / RESOLUTION)), UNKNOWN, dtype=np.uint8)
    _wall(cells, 0.5, 0.5, 15.5, 10.5)
    for room in ((0.6, 4.5, 15.4, 6.3), (0.6, 0.6, 5.0, 4.4), (5.1, 0.6, 11.0, 4.4), (11.1, 0.6, 15.4, 4.4)):
        _wall(cells, *room, FREE)
    for room in ((0.6, 6.4, 8.2, 10.4), (8.3, 6.4, 15.4, 10.4)):
        _wall(cells, *room, FREE)
    for door in ((1.0, 4.4, 1.9, 4.5), (9.0, 4.4, 9.9, 4.5), (12.5, 4.4, 13.4, 4.5), (6.0, 6.3, 6.9, 6.4)):
        _wall(cells, *door, FREE)
    _wall(cells, 10.0, 6.3, 10.9, 6.4, FREE)
    for thing in ((3.5, 0.6, 5.0, 1.2), (6.0, 2.5, 7.6, 3.2), (14.6, 3.0, 15.4, 4.4), (2.0, 8.0, 4.5, 8.8)):
        _wall(cells, *thing)
    _wall(cells, 11.5, 9.4, 13.0, 10.4)
    _wall(cells, 14.5, 7.0, 14.8, 8.5)
    return GridMap(cells, RESOLUTION, np.array([-3.0, 2.0, 0.0]))


@cache
def tower() -> GridMap:
    """Another building: one hall with columns, slanted."""
    cells = np.full((round(12 / RESOLUTION), round(12 / RESOLUTION)), UNKNOWN, dtype=np.uint8)
    row, column = np.mgrid[: cells.shape[0], : cells.shape[1]] * RESOLUTION
    away = np.abs(column - 6) + 0.7 * np.abs(row - 6)
    cells[away < 5.5] = OCCUPIED
    cells[away < 5.3] = FREE
    for x, y in ((4.5, 5.0), (7.5, 7.0), (6.0, 3.5), (5.0, 8.0)):
        cells[np.hypot(column - x, row - y) < 0.35] = OCCUPIED
    return GridMap(cells, RESOLUTION, np.zeros(3))


@cache
def site(
    spacing: float = 0.5, of: str = "office", embedding: Kind = "ring", components: int = 16
) -> SiteModel:
    plan = Plan(spacing=spacing, embedding=embedding, components=components)
    return build_site(office() if of == "office" else tower(), plan)


def envelopes(built: SiteModel) -> list[Envelope]:
    """Map, models and set as the mapbuilder publishes them."""
    announced = built.to_message()
    return [
        Envelope(MAP, {"site": "s"}, to_message(built.grid, built.frame_id)),
        *(Envelope(MODEL, {"site": "s", "region": m.region}, m.to_message()) for m in built.regions),
        Envelope(MODEL_SET, {"site": "s"}, announced),
    ]


def ready(built: SiteModel | None = None, instance: str = "robot", **settings: object) -> ProjectorCore:
    core = ProjectorCore(ProjectorSettings(**settings), instance)
    for envelope in envelopes(built or site()):
        assert list(core.handle(envelope)) == []
    return core


def free_poses(count: int, seed: int, grid: GridMap | None = None, clearance: float = 0.35) -> Array:
    """Random sensor poses (count, 3) away from walls, map frame."""
    from scipy.ndimage import distance_transform_edt

    grid = grid or office()
    rng = np.random.default_rng(seed)
    roomy = distance_transform_edt(grid.cells == FREE) * grid.resolution > clearance
    row, column = np.nonzero(roomy)
    pick = rng.choice(len(row), count, replace=False)
    points = grid.to_map(np.column_stack([column[pick], row[pick]]) + rng.uniform(0, 1, (count, 2)))
    return np.column_stack([points, rng.uniform(-np.pi, np.pi, count)])


def scan_at(
    sensor_pose: Array,
    *,
    grid: GridMap | None = None,
    field_of_view: float = np.pi,
    step: float = np.deg2rad(1.0),
    range_max: float = 30.0,
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0),
    noise: float = 0.02,
    seed: int = 0,
    time: int = 1,
) -> Scan:
    """What a sensor at `sensor_pose` sees, with Gaussian noise."""
    beams = min(round(field_of_view / step) + 1, round(2 * np.pi / step))
    angle_min = -0.5 * step * (beams - 1)
    bearings = angle_min + np.arange(beams) * step
    ranges = RayCaster.of(grid or office()).cast(sensor_pose, bearings, range_max)[0].astype(np.float64)
    ranges += np.random.default_rng(seed).normal(0.0, noise, beams)
    scan = Scan(
        frame_id="base",
        mount=pose_message(mount),
        angle_min=angle_min,
        angle_increment=step,
        range_min=0.05,
        range_max=range_max,
        ranges=np.where(ranges > range_max, np.inf, np.maximum(ranges, 0.05)).tolist(),
    )
    scan.timestamp.FromNanoseconds(time)
    return scan


def occlude(scan: Scan, share: float, seed: int) -> Scan:
    """People in front of the sensor: random runs of beams cut short until `share` of them is."""
    rng = np.random.default_rng(seed)
    ranges = np.array(scan.ranges)
    hidden = np.zeros(len(ranges), dtype=bool)
    while hidden.mean() < share:
        width = int(rng.integers(4, 16))
        start = int(rng.integers(0, len(ranges)))
        run = (start + np.arange(width)) % len(ranges)
        ranges[run] = np.minimum(ranges[run], rng.uniform(0.4, 1.5) + rng.normal(0, 0.02, width))
        hidden[run] = True
    other = Scan()
    other.CopyFrom(scan)
    other.ranges[:] = ranges.tolist()
    return other


def receive(core: ProjectorCore, scan: Scan, **address: str) -> tuple[Hypotheses, Obstacles | None]:
    output = list(core.handle(Envelope(SCAN, {**ADDRESS, **address}, scan)))
    hypotheses = output[0].open(Hypotheses)
    return hypotheses, output[1].open(Obstacles) if len(output) > 1 else None


def poses_of(message: Hypotheses) -> Array:
    return np.array([[h.pose.x, h.pose.y, h.pose.theta] for h in message.hypotheses]).reshape(-1, 3)


def is_right(poses: Array, truth: Array) -> NDArray[np.bool_]:
    """Within 0.5 m and 10 degrees."""
    turn = (poses[..., 2] - truth[2] + np.pi) % (2 * np.pi) - np.pi
    return (np.hypot(poses[..., 0] - truth[0], poses[..., 1] - truth[1]) <= 0.5) & (
        np.abs(turn) <= np.deg2rad(10)
    )


def base_of(sensor_pose: Array, mount: tuple[float, float, float]) -> Array:
    from eigenscan.geometry.pose import inverse

    return compose(sensor_pose, inverse(np.array(mount)))
