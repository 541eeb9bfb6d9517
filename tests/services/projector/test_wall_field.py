"""The packed field and the fit on it against plain formulas."""

from dataclasses import replace

import numpy as np
from eigenscan.geometry.circle import difference
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.geometry.pose import compose, inverse, transform
from eigenscan.projector.observation import observe
from eigenscan.projector.refinement import Schedule, cost_at, fit
from eigenscan.projector.wall_field import WallField, unpack

from tests.services.projector.office import free_poses, office, scan_at

# written out, not taken from what is tested: a change there must show here
REACH = 1.0


def test_a_cell_holds_distance_and_slope() -> None:
    grid = office()
    field = DistanceField.of(grid)
    packed = WallField.of(field)
    distance = np.full(np.add(field.distance.shape, 2), REACH)
    distance[1:-1, 1:-1] = np.minimum(field.distance, REACH)
    by_row, by_column = np.gradient(distance, grid.resolution)
    rng = np.random.default_rng(1)
    for row, column in rng.integers(1, np.array(distance.shape) - 1, (500, 2)):
        near, gx, gy = unpack(packed.cells[row, column])
        assert abs(near - distance[row, column]) <= 0.5001 / 4095
        assert abs(gx - np.clip(by_column[row, column], -1, 1)) <= 0.5001 / 511
        assert abs(gy - np.clip(by_row[row, column], -1, 1)) <= 0.5001 / 511
    border = [unpack(word) for word in (*packed.cells[0], *packed.cells[:, -1])]
    assert all(near == np.float32(REACH) and gx == gy == 0 for near, gx, gy in border)


def test_poses_lie_in_the_field_as_they_do_in_the_map() -> None:
    grid = replace(office(), origin=np.array([4.0, -7.0, 0.7]))
    field = WallField.of(DistanceField.of(grid), 0.1)
    poses = free_poses(20, 5)
    found, plain = field.cells_of(poses), compose(inverse(grid.origin), poses)
    assert np.allclose(found[:, :2], plain[:, :2] / 0.1 + 1.0, rtol=0, atol=1e-12)
    assert np.allclose(difference(found[:, 2], plain[:, 2]), 0.0, rtol=0, atol=1e-12)


def test_a_pose_costs_the_same_alone_and_among_others_that_share_headings() -> None:
    field = WallField.of(DistanceField.of(office()), 0.1)
    poses = free_poses(300, 6)
    turns = np.deg2rad(2.0) * np.arange(-3, 3)
    poses[:, 2] = np.concatenate([turns, turns + 2.0 * np.pi, turns + 1e-3])[np.arange(300) % 18]
    points = observe(scan_at(poses[0], seed=3)).points
    alone = [cost_at(field, pose[None], points, 0.5)[0] for pose in poses]
    assert np.array_equal(cost_at(field, poses, points, 0.5), alone)


def test_a_fit_that_does_not_move_is_the_sum_over_its_points() -> None:
    grid = office()
    field = DistanceField.of(grid)
    scale = 0.3
    for i, truth in enumerate(free_poses(10, 51)):
        points = observe(scan_at(truth, seed=i)).points
        pose = truth + np.array([0.05, -0.04, 0.03])
        found = fit(WallField.of(field), pose[None], points, Schedule(scale, scale, 1))
        assert np.allclose(found.poses[0], pose)
        assert np.allclose(cost_at(WallField.of(field), pose[None], points, scale), found.cost, atol=1e-5)

        world = transform(pose, points)
        cell = np.floor(grid.to_grid(world)).astype(int)
        distance = np.pad(np.minimum(field.distance, REACH), 1, constant_values=REACH)
        by_row, by_column = np.gradient(distance, grid.resolution)
        at = cell[:, 1] + 1, cell[:, 0] + 1
        slope = np.column_stack([by_column[at], by_row[at]])
        away = world - grid.to_map(cell + 0.5)
        d = distance[at] + (slope * away).sum(axis=1)
        arm = world - pose[:2]
        J = np.column_stack([slope, slope[:, 1] * arm[:, 0] - slope[:, 0] * arm[:, 1]])
        q = scale**2 / (scale**2 + d**2)
        reach = np.sqrt(np.hypot(*points.T))
        weight = reach / reach.mean()
        assert np.isclose(found.cost[0], np.mean(weight * (1 - q)), atol=2e-3)
        direct = (J * (weight * q**2)[:, None]).T @ J
        assert np.allclose(found.information[0], direct, rtol=5e-3, atol=5e-3 * np.abs(direct).max())
