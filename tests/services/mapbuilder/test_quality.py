"""What is published of a map before any robot drives in it."""

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.mapbuilder.backdrop import Backdrop
from eigenscan.mapbuilder.quality import quality


def room(thick: int) -> GridMap:
    """10 m by 6 m inside, in cells of 0.1 m, walls of so many cells."""
    cells = np.full((60 + 2 * thick, 100 + 2 * thick), OCCUPIED, dtype=np.uint8)
    cells[thick:-thick, thick:-thick] = FREE
    return GridMap(cells, 0.1, np.array([-0.1 * thick, -0.1 * thick, 0.0]))


POINTS = np.array([[2.0, 3.0], [5.0, 3.0], [8.0, 3.0]])


def test_thin_walls_promise_nothing_out_of_the_ordinary() -> None:
    found = quality(room(1), POINTS, 20.0)
    assert found.cell_m == 0.1
    assert found.wall_thickness_m == pytest.approx(0.1)
    assert not found.thinned
    assert not found.expectation
    assert found.walls_in_sight == 1.0
    assert found.usual_range_m == pytest.approx(3.4, abs=0.4)


def test_thick_walls_are_reported_and_what_follows() -> None:
    found = quality(room(5), POINTS, 20.0)
    assert found.wall_thickness_m == pytest.approx(0.5, abs=0.11)
    assert found.thinned
    assert "models use their middles, and fewer scans" in found.expectation
    assert "eigenscan map DRIVE --on MAP" in found.expectation


def test_where_no_wall_is_in_reach_none_is_in_sight() -> None:
    found = quality(room(1), POINTS, 1.0)
    assert found.walls_in_sight == 0.0
    assert np.isnan(found.usual_range_m)


def test_a_map_that_is_read_inside_out_is_suspected() -> None:
    """`negate: 1` on an ordinary map was built, of the insides of its walls."""
    usual = room(3)
    turned = np.where(usual.cells == FREE, OCCUPIED, FREE).astype(np.uint8)
    assert not quality(usual, POINTS, 20.0).strips
    assert quality(GridMap(turned, usual.resolution, usual.origin), POINTS, 20.0).strips


@pytest.mark.parametrize(("look", "most"), [(lambda grid: quality(grid, POINTS, 0.1), 25), (Backdrop, 2)])
def test_a_large_map_takes_a_few_bytes_a_cell(look: Callable[[GridMap], object], most: int) -> None:
    """Distances over all cells at once took 39 of each, the places of known cells 17."""
    cells = np.full((2000, 2000), OCCUPIED, dtype=np.uint8)
    cells[10:700, 10:700] = FREE
    tracemalloc.start()
    look(GridMap(cells, 0.05, np.zeros(3)))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < most * cells.size
