"""Obstacles that the map does not have, against the simulator's truth, and along walls that it does have."""

from dataclasses import replace

import numpy as np
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.geometry.pose import compose, transform
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.obstacles import find_obstacles
from eigenscan.projector.wall_field import WallField
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.workbench.simulation.lidar import Lidar, to_discs
from eigenscan.workbench.simulation.people import RADIUS
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office as furnished

from tests.services.projector.office import is_right, poses_of, ready, receive

# written out, not taken from what is tested: a change there must show here
REACH = 1.0

NEAR = 8.0

SAME_WALL = 0.05
"""m: two maps that differ by no more along a beam show it the same wall."""


def unexpected(
    lidar: Lidar, world: RayCaster, known: RayCaster, base: np.ndarray, people: np.ndarray
) -> np.ndarray:
    """Which beams (B,) from the base pose (3,) end on parts of the `world` that the map `known` lacks.

    Those are people (n, 2), m, and furniture.
    """
    sensor = compose(base, lidar.mount)
    wall = world.cast(sensor, lidar.bearings, lidar.range_max)[0].astype(np.float64)
    shown = known.cast(sensor, lidar.bearings, lidar.range_max)[0].astype(np.float64)
    body = to_discs(sensor, lidar.bearings, people, RADIUS)
    on_it: np.ndarray = (body < wall) | (np.isfinite(wall) & (shown > wall + SAME_WALL))
    return on_it


def _canonical(raw: RawScan) -> Scan:
    return Scan(
        timestamp=raw.timestamp,
        mount=raw.mount,
        angle_min=raw.angle_min,
        angle_increment=raw.angle_increment,
        range_max=raw.range_max,
        ranges=raw.ranges,
    )


def test_people_and_new_furniture_are_found_and_little_else() -> None:
    plan = furnished()
    world = plan.render()
    kept = tuple(thing for i, thing in enumerate(plan.furniture) if i % 3)
    map_ = replace(plan, furniture=kept).render()
    core = ready(build_site(map_, Plan()))
    lidar = Lidar(beams=361, fov=1.5 * np.pi, range_max=12.0, rate=1.0)
    stage = Stage(world, Scenario(seconds=40.0, seed=5, people=6, lidar=lidar))
    there, known = RayCaster.of(world), RayCaster.of(map_)
    real = masked = both = localized = 0
    for envelope in (t.envelope for t in stage.messages() if t.envelope.channel == SCAN_RAW):
        raw = envelope.open(RawScan)
        time = nanoseconds(raw.timestamp)
        truth = stage.pose_at(time)
        message, obstacles = receive(core, _canonical(raw))
        if not is_right(poses_of(message)[:1], truth)[0]:
            continue
        assert obstacles is not None
        localized += 1
        ranges = np.array(raw.ranges)
        near = np.isfinite(ranges) & (ranges <= NEAR)
        on_it = unexpected(lidar, there, known, truth, stage.people_at(time)) & near
        mask = (np.frombuffer(obstacles.mask, dtype=np.uint8) == 0) & near
        real, masked = real + int(on_it.sum()), masked + int(mask.sum())
        both += int((on_it & mask).sum())
    assert localized >= 36
    assert real > 1000
    assert both >= 0.95 * masked
    assert both >= 0.95 * real


def _hall() -> GridMap:
    """10 m by 4 m; its east end is not mapped."""
    cells = np.full((42, 120), UNKNOWN, dtype=np.uint8)
    cells[:, :100] = OCCUPIED
    cells[1:-1, 1:100] = FREE
    return GridMap(cells, 0.1, np.zeros(3))


def test_where_no_wall_is_in_sight_free_ground_shows() -> None:
    grid = _hall()
    pose = np.array([2.0, 2.1, 0.0])
    # one on free ground, two where the map ends
    ranges = np.array([4.0, 9.0, np.inf], dtype=np.float32)
    bearings = np.array([0.0, 0.0, 0.0])
    predicted = np.full(3, np.inf, dtype=np.float32)
    found = find_obstacles(pose, bearings, ranges, predicted, WallField.of(DistanceField.of(grid)), grid)
    assert found.mask.tolist() == [0, 1, 255]
    assert np.allclose(found.in_sensor, [[4.0, 0.0]])
    assert np.allclose(found.in_map, [[6.0, 2.1]])


def test_along_a_wall_a_small_error_of_the_pose_is_no_obstacle() -> None:
    grid = _hall()
    caster, walls = RayCaster.of(grid), WallField.of(DistanceField.of(grid))
    bearings = np.deg2rad(np.arange(-60.0, 60.0, 0.5))
    truth = np.array([1.0, 1.0, 0.0])
    ranges = caster.cast(truth, bearings, 30.0)[0]
    off = truth + np.array([0.0, 0.04, np.deg2rad(0.7)])
    predicted = caster.cast(off, bearings, 30.0)[0]
    both = np.isfinite(ranges) & np.isfinite(predicted)
    assert np.count_nonzero(predicted[both] - ranges[both] > 0.3) > 3
    found = find_obstacles(off, bearings, ranges, predicted, walls, grid)
    assert not np.any(found.mask == 0)


def test_the_error_energy_shows_how_far_to_trust_the_mask() -> None:
    grid = _hall()
    caster, walls = RayCaster.of(grid), WallField.of(DistanceField.of(grid))
    bearings = np.deg2rad(np.arange(-90.0, 90.0, 1.0))
    truth = np.array([3.0, 2.0, np.pi])
    ranges = caster.cast(truth, bearings, 30.0)[0]
    confidences = []
    for away in (0.0, 0.2, 0.6):
        predicted = caster.cast(truth + np.array([away, 0.0, 0.0]), bearings, 30.0)[0]
        confidences.append(find_obstacles(truth, bearings, ranges, predicted, walls, grid).confidence)
    assert confidences[0] > 0.99
    assert confidences == sorted(confidences, reverse=True)
    assert confidences[2] < 0.9


def test_distance_at_points_is_the_distance_fields() -> None:
    grid = _hall()
    field = DistanceField.of(grid)
    points = np.random.default_rng(0).uniform([0.5, 0.5], [9.0, 3.5], (200, 2))
    direct = field.at(points)[0]
    near = direct < REACH - 0.1
    assert near.sum() > 50
    assert np.allclose(WallField.of(field).at(points)[near], direct[near], atol=0.05)


def test_they_are_those_of_the_plain_form() -> None:
    """Beam by beam in numpy, for scans among walls, off the map and without a beam."""
    grid = _hall()
    caster, walls = RayCaster.of(grid), WallField.of(DistanceField.of(grid))
    rng = np.random.default_rng(4)
    for beams in (0, 1, 90, 361):
        pose = np.array([*rng.uniform((0.5, 0.5), (11.0, 3.5)), rng.uniform(-np.pi, np.pi)])
        bearings = np.linspace(-np.pi, np.pi, beams)
        predicted = caster.cast(pose, bearings, 30.0)[0]
        ranges = np.where(np.isfinite(predicted), predicted, 8.0).astype(np.float32)
        ranges *= rng.choice([1.0, 1.02, 0.6], beams).astype(np.float32)
        ranges[rng.random(beams) < 0.1] = np.inf
        ranges[rng.random(beams) < 0.1] = np.nan
        found = find_obstacles(pose, bearings, ranges, predicted, walls, grid)
        seen = np.isfinite(ranges)
        r, angle = ranges[seen], bearings[seen]
        points = np.column_stack([r * np.cos(angle), r * np.sin(angle)])
        ends, short = transform(pose, points), predicted[seen] - ranges[seen] > 0.2
        inside = np.isfinite(predicted[seen]) | (grid.at(ends) == FREE)
        on_it = short & inside & (walls.at(ends) > 0.2)
        wanted = np.full(beams, 255)
        wanted[seen] = np.where(on_it, 0, 1)
        assert found.mask.tolist() == wanted.tolist()
        assert np.allclose(found.in_sensor, points[on_it], atol=1e-5)
        assert np.allclose(found.in_map, ends[on_it], atol=1e-5)
        error = np.full(beams, np.nan, dtype=np.float32)
        both = seen & np.isfinite(predicted)
        error[both] = ranges[both] - predicted[both]
        assert np.array_equal(found.error, error, equal_nan=True)
        known = error[np.isfinite(error)].astype(np.float64)
        if not len(known):
            assert np.isnan(found.error_energy)
            assert found.confidence == 0.0
            continue
        bounded = np.minimum(np.abs(known), 1.0)
        assert np.isclose(found.error_energy, np.sqrt(np.mean(known**2)), rtol=1e-12)
        assert np.isclose(found.confidence, np.exp(-0.5 * np.mean(bounded**2) / 0.5**2), rtol=1e-12)
