import numpy as np
import pytest
from eigenscan.geometry.distance_field import FAR, DistanceField
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from scipy.interpolate import RegularGridInterpolator


def grid_with(seed: int, origin: tuple[float, float, float]) -> GridMap:
    rng = np.random.default_rng(seed)
    cells = rng.choice(np.array([FREE, OCCUPIED, UNKNOWN], dtype=np.uint8), (30, 41), p=[0.9, 0.05, 0.05])
    return GridMap(cells, 0.05, np.array(origin))


def test_distance_at_cell_centres_is_to_the_nearest_wall_and_unknown_is_none() -> None:
    grid = grid_with(1, (2.0, -3.0, 0.7))
    field = DistanceField.of(grid)
    centres = grid.to_map(np.stack(np.meshgrid(np.arange(41), np.arange(30)), axis=-1) + 0.5)
    walls = centres[grid.cells == OCCUPIED]
    expected = np.linalg.norm(centres[:, :, None] - walls, axis=-1).min(axis=-1)
    distance, _ = field.at(centres)
    np.testing.assert_allclose(distance, expected, atol=1e-6)
    np.testing.assert_array_equal(field.known, grid.cells != UNKNOWN)


def test_between_centres_it_is_bilinear() -> None:
    grid = grid_with(2, (0.0, 0.0, 0.0))
    field = DistanceField.of(grid)
    axes = [(np.arange(30) + 0.5) * 0.05, (np.arange(41) + 0.5) * 0.05]
    interpolate = RegularGridInterpolator(axes, field.distance)
    points = np.random.default_rng(3).uniform([0.03, 0.03], [2.0, 1.45], (500, 2))
    distance, _ = field.at(points)
    np.testing.assert_allclose(distance, interpolate(points[:, ::-1]), atol=1e-6)


def test_the_gradient_is_the_slope_in_the_map_frame() -> None:
    grid = grid_with(4, (1.0, 2.0, -2.1))
    field = DistanceField.of(grid)
    inside = np.random.default_rng(5).uniform([1, 1], [40, 29], (400, 2))
    points, tiny = grid.to_map(inside), 1e-6
    _, gradient = field.at(points)
    slopes = [
        (field.at(points + tiny * axis)[0] - field.at(points - tiny * axis)[0]) / (2 * tiny)
        for axis in np.eye(2)
    ]
    np.testing.assert_allclose(gradient, np.stack(slopes, axis=-1), atol=1e-4)


def test_beyond_the_map_the_border_counts_and_nothing_pulls() -> None:
    grid = grid_with(6, (0.0, 0.0, 0.0))
    field = DistanceField.of(grid)
    distance, gradient = field.at([[-5.0, -5.0], [99.0, 99.0]])
    np.testing.assert_allclose(distance, [field.distance[0, 0], field.distance[-1, -1]])
    assert (gradient == 0).all()


def test_points_that_are_no_points_and_maps_without_walls() -> None:
    grid = GridMap(np.zeros((3, 4), np.uint8), 0.1, np.zeros(3))
    distance, gradient = DistanceField.of(grid).at([[[np.nan, 0.0], [0.2, np.inf]], [[0.2, 0.1], [0.0, 0.0]]])
    assert distance.shape == (2, 2)
    assert np.isnan(distance[0]).all()
    assert np.isnan(gradient[0]).all()
    assert (distance[1] == pytest.approx(FAR)) if np.isscalar(distance[1]) else (distance[1] == FAR).all()


def test_a_map_of_one_cell() -> None:
    field = DistanceField.of(GridMap(np.full((1, 1), OCCUPIED, np.uint8), 0.1, np.zeros(3)))
    distance, gradient = field.at([[0.05, 0.05], [3.0, 3.0]])
    assert (distance == 0).all()
    assert (gradient == 0).all()
