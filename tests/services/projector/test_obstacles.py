"""Obstacles that the map does not have, against the simulator's truth, and along walls that it does have."""

from dataclasses import replace

import numpy as np
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.obstacles import find_obstacles
from eigenscan.projector.wall_field import WallField
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.workbench.simulation.lidar import Lidar, unexpected
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office as furnished

from tests.services.projector.office import hear, is_right, poses_of, ready

# written out, not taken from what is tested: a change there must show here
REACH = 1.0

NEAR = 8.0


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
        message, obstacles = hear(core, _canonical(raw))
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


def test_where_no_wall_is_in_sight_free_ground_tells() -> None:
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


def test_the_error_energy_tells_how_far_to_trust_the_mask() -> None:
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
