from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.mapbuilder.keeping.change import Change, find_change
from eigenscan.mapbuilder.keeping.picture import draw_change
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from tests.services.mapbuilder.floorplan import blank, box, room

VISITS = 4


@pytest.fixture
def hall() -> GridMap:
    """A room of 6 m x 4 m with a cabinet at its upper wall, known by its outline as lidars know it."""
    grid = blank(8.0, 6.0)
    room(grid, 1.0, 1.0, 7.0, 5.0)
    box(grid, 2.0, 4.4, 3.2, 5.0, OCCUPIED)
    box(grid, 2.1, 4.5, 3.1, 5.0, UNKNOWN)
    return grid


def seen(grid: GridMap, visits: int = VISITS) -> np.ndarray:
    """What visits show that see the whole of `grid`: its faces struck, its free ground looked through."""
    run = np.zeros(grid.cells.shape, np.int8)
    run[grid.cells == OCCUPIED] = visits
    run[grid.cells == FREE] = -visits
    return run


def emptied(grid: GridMap) -> GridMap:
    """The hall without its cabinet."""
    after = replace(grid, cells=grid.cells.copy())
    box(after, 2.0, 4.4, 3.2, 5.0, FREE)
    return after


def test_what_the_map_shows_is_no_change(hall: GridMap) -> None:
    change = find_change(hall, seen(hall), VISITS)
    assert not change
    np.testing.assert_array_equal(change.grid.cells, hall.cells)


def test_a_cabinet_that_went_leaves_free_ground(hall: GridMap) -> None:
    change = find_change(hall, seen(emptied(hall)), VISITS)
    np.testing.assert_array_equal(change.grid.cells, emptied(hall).cells)
    (place,) = change.places()
    assert not place.is_new
    assert place.centre == pytest.approx((2.6, 4.7), abs=0.06)
    assert place.sides == pytest.approx((1.2, 0.6), abs=0.06)


def test_things_far_apart_are_two_in_a_coarse_map_too() -> None:
    new = np.zeros((40, 40), dtype=bool)
    new[2, 2] = new[30, 30] = True
    grid = GridMap(np.zeros((40, 40), dtype=np.uint8), 0.6, np.zeros(3))
    centres = [place.centre for place in Change(grid, new, np.zeros_like(new)).places()]
    np.testing.assert_allclose(centres, [(1.5, 1.5), (18.3, 18.3)])


def test_a_cabinet_that_came_is_a_wall_around_what_nobody_knows(hall: GridMap) -> None:
    run = seen(emptied(hall))
    before = emptied(hall)
    run[hall.cells != before.cells] = 0
    run[(hall.cells == OCCUPIED) & (before.cells == FREE)] = VISITS
    change = find_change(before, run, VISITS)
    new = hall.cells == OCCUPIED
    assert (change.grid.cells[new] == OCCUPIED).all()
    inside = np.zeros_like(new)
    inside[93:97, 45:60] = True
    assert (change.grid.cells[inside] == UNKNOWN).all()
    assert [place.is_new for place in change.places()] == [True]


def test_a_closed_door_leaves_the_room_behind_it(hall: GridMap) -> None:
    grid = hall
    box(grid, 4.0, 1.0, 4.1, 5.0, OCCUPIED)
    box(grid, 4.0, 2.0, 4.1, 3.0, FREE)
    run = seen(grid)
    run[40:60, 81:82] = VISITS
    change = find_change(grid, run, VISITS)
    assert (change.grid.cells[40:60, 81] == OCCUPIED).all()
    assert (change.grid.cells[30:90, 90:130] == FREE).all()


@pytest.mark.parametrize("cells", [1, 2, 3])
def test_a_wall_that_was_mapped_a_little_off_is_no_change(hall: GridMap, cells: int) -> None:
    run = seen(hall)
    shifted = np.roll(hall.cells == OCCUPIED, -cells, axis=0) & (hall.cells == FREE)
    run[shifted] = VISITS
    run[hall.cells == OCCUPIED] = 0
    assert not find_change(hall, run, VISITS)


def test_what_is_smaller_than_a_hand_is_no_change(hall: GridMap) -> None:
    run = seen(hall)
    run[60:63, 60:63] = VISITS
    assert not find_change(hall, run, VISITS)
    run[60:64, 60:61] = VISITS
    assert find_change(hall, run, VISITS)


@given(arrays(np.int8, (120, 160), elements=st.sampled_from([-3, -2, -1, 0, 1, 2, 3]), fill=st.just(0)))
def test_fewer_visits_than_asked_for_change_nothing(run: np.ndarray) -> None:
    grid = blank(8.0, 6.0)
    room(grid, 1.0, 1.0, 7.0, 5.0)
    assert not find_change(grid, run, VISITS)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.5))
def test_a_change_is_where_visits_report_it_and_nowhere_else(seed: int, share: float) -> None:
    grid = blank(8.0, 6.0)
    room(grid, 1.0, 1.0, 7.0, 5.0)
    box(grid, 2.0, 2.0, 3.0, 3.0, OCCUPIED)
    rng = np.random.default_rng(seed)
    run = np.where(rng.random(grid.cells.shape) < share, rng.integers(-6, 7, grid.cells.shape), 0).astype(
        np.int8
    )
    change = find_change(grid, run, VISITS)
    assert (grid.cells[change.new] == FREE).all()
    assert (run[change.new] >= VISITS // 2).all()
    assert (grid.cells[change.gone] == OCCUPIED).all()
    assert (run[change.gone] <= 0).all()
    became_wall = (change.grid.cells == OCCUPIED) & (grid.cells != OCCUPIED)
    np.testing.assert_array_equal(became_wall, change.new)
    no_wall_now = (change.grid.cells != OCCUPIED) & (grid.cells == OCCUPIED)
    np.testing.assert_array_equal(no_wall_now, change.gone)


def test_the_picture_shows_red_what_came_and_blue_what_went(hall: GridMap, tmp_path: Path) -> None:
    run = seen(emptied(hall))
    run[40:60, 100:110] = VISITS
    (tmp_path / "change.png").write_bytes(draw_change(hall, find_change(hall, run, VISITS), "two things"))
    pixels = np.asarray(Image.open(tmp_path / "change.png").convert("RGB")).astype(int)
    red = (pixels[..., 0] > 180) & (pixels[..., 1:].max(axis=-1) < 60)
    blue = (pixels[..., 2] > 180) & (pixels[..., :2].max(axis=-1) < 90)
    assert np.nonzero(red)[1].mean() > np.nonzero(blue)[1].mean()
    assert red.sum() > 1000
    assert blue.sum() > 500
