"""Walls thinned to their middle, where they are thick, and left alone where they are thin."""

import numpy as np
import pytest
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.geometry.raycast import RayCaster
from eigenscan.geometry.surfaces import Surfaces, faces_of
from scipy.ndimage import binary_dilation, distance_transform_edt

ORIGIN = np.array([-1.0, 2.0, 0.3])


def two_rooms(cell: float = 0.05) -> GridMap:
    """Two rooms and a door between them, a cupboard of a metre in one; nobody saw what is outside."""
    cells = np.full((100, 200), UNKNOWN, dtype=np.uint8)
    cells[10:90, 10:190] = OCCUPIED
    cells[11:89, 11:100] = FREE
    cells[11:89, 101:189] = FREE
    cells[40:60, 100] = FREE
    cells[11:31, 140:160] = OCCUPIED
    return GridMap(cells, cell, ORIGIN)


def fatter(grid: GridMap, by: float) -> GridMap:
    far = distance_transform_edt(grid.cells != OCCUPIED) * grid.resolution
    return GridMap(np.where(far <= by, np.uint8(OCCUPIED), grid.cells), grid.resolution, grid.origin)


def test_thin_walls_are_their_own_surfaces() -> None:
    grid = two_rooms()
    found = Surfaces.of(grid)
    assert found.grid is grid
    assert found.thickness == pytest.approx(0.05)
    assert found.inexactness == 0.0


@pytest.mark.parametrize("left", [900, 1018])
def test_a_wall_across_a_tiles_edge_is_as_thick_as_elsewhere(left: int) -> None:
    cells = np.full((60, 1200), FREE, dtype=np.uint8)
    cells[:, left : left + 13] = OCCUPIED  # at 1018 the tile of its left face has none of its middle
    assert Surfaces.of(GridMap(cells, 0.05, ORIGIN)).thickness == pytest.approx(0.65)


@pytest.mark.parametrize("by", [0.1, 0.2])
def test_fat_walls_are_thinned_to_where_they_were(by: float) -> None:
    grid = two_rooms()
    found = Surfaces.of(fatter(grid, by))
    assert found.thickness == pytest.approx(2 * by + 0.05, abs=0.06)
    # a uniform distribution over the wall
    assert found.inexactness == pytest.approx(found.thickness / np.sqrt(12))
    wall, was = found.grid.cells == OCCUPIED, grid.cells == OCCUPIED
    # within a cell of where they were, and nowhere else
    assert np.all(binary_dilation(was, np.ones((3, 3), dtype=bool))[wall])
    far = distance_transform_edt(~wall)[was]
    assert np.percentile(far, 95) <= 2.0


def test_ranges_are_those_of_the_true_walls() -> None:
    grid = two_rooms()
    bearings = np.deg2rad(np.arange(0, 360, 7.0))
    pose = RayCaster.of(grid).grid.to_map(np.array([50.0, 50.0]))
    at = np.array([[*pose, 0.1]])
    true, thinned = (
        RayCaster.of(g).cast(at, bearings, 20.0) for g in (grid, Surfaces.of(fatter(grid, 0.2)).grid)
    )
    both = np.isfinite(true) & np.isfinite(thinned)
    assert both.mean() > 0.9
    assert np.median(np.abs(true - thinned)[both]) <= 0.05


def test_what_was_wall_is_free_only_on_the_side_of_free_ground() -> None:
    grid = two_rooms()
    found = Surfaces.of(fatter(grid, 0.2)).grid
    outside = grid.cells == UNKNOWN
    assert not np.any(found.cells[outside & (distance_transform_edt(outside) > 1.5)] == FREE)
    free = found.cells == FREE
    assert np.count_nonzero(free) >= 0.97 * np.count_nonzero(grid.cells == FREE)


def test_what_is_thicker_than_a_wall_loses_half_a_wall_on_each_side() -> None:
    found = Surfaces.of(fatter(two_rooms(), 0.2))
    # the cupboard of 1 m grew to 1.4 m; it is a metre again, and whole
    row, column = 20, 150
    solid = found.grid.cells[row, column - 25 : column + 25] == OCCUPIED
    assert np.count_nonzero(solid) == pytest.approx(20, abs=3)
    assert np.all(solid[16:34])


@pytest.mark.parametrize("outside", [UNKNOWN, OCCUPIED])
def test_racks_and_ground_outside_that_are_drawn_filled_make_no_thick_walls(outside: int) -> None:
    cells = np.full((340, 340), outside, dtype=np.uint8)
    cells[30:310, 30:310] = OCCUPIED
    cells[31:309, 31:309] = FREE
    for row in range(60, 280, 60):
        cells[row : row + 22, 60:280] = OCCUPIED
    found = Surfaces.of(GridMap(cells, 0.05, ORIGIN))
    assert found.thickness == pytest.approx(0.05)
    assert not found.thinned


def test_a_given_thickness_holds_and_a_map_without_walls_is_as_it_was() -> None:
    fat = fatter(two_rooms(), 0.2)
    assert Surfaces.of(fat, 0.05).grid is fat
    empty = GridMap(np.full((20, 20), FREE, dtype=np.uint8), 0.1, np.zeros(3))
    assert Surfaces.of(empty).grid is empty


def test_faces_are_what_a_ray_meets() -> None:
    fat = fatter(two_rooms(), 0.2)
    faces = faces_of(fat)
    pose = fat.to_map(np.array([50.0, 50.0]))
    bearings = np.deg2rad(np.arange(0, 360, 3.0))
    full, thin = (RayCaster.of(g).cast(np.array([*pose, 0.0]), bearings, 20.0) for g in (fat, faces))
    assert np.array_equal(full, thin)
    assert np.count_nonzero(faces.cells == OCCUPIED) < 0.5 * np.count_nonzero(fat.cells == OCCUPIED)


@pytest.mark.parametrize("before", [(0, 0), (1024, 0), (300, 1024)])
def test_unknown_ground_around_changes_nothing(before: tuple[int, int]) -> None:
    grid = fatter(two_rooms(), 0.1)
    alone, (top, left) = Surfaces.of(grid), before
    around = np.pad(grid.cells, ((top, 50), (left, 900)), constant_values=UNKNOWN)
    found = Surfaces.of(GridMap(around, grid.resolution, grid.origin))
    assert found.thickness == alone.thickness
    np.testing.assert_array_equal(found.grid.cells[top : top + 100, left : left + 200], alone.grid.cells)
    assert (np.delete(found.grid.cells, np.s_[top : top + 100], axis=0) == UNKNOWN).all()
