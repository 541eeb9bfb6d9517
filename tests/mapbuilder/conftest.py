import pytest
from eigenscan.geometry.gridmap import FREE, OCCUPIED

from tests.mapbuilder.floorplan import blank, box, room


@pytest.fixture
def office():
    """Two rooms of 5 m x 4 m above a hallway of 12 m x 2 m, a door of 0.9 m into each."""
    grid = blank(14.0, 9.0)
    room(grid, 1.0, 1.0, 13.0, 3.0)
    room(grid, 1.5, 3.2, 6.5, 7.2)
    room(grid, 7.0, 3.2, 12.0, 7.2)
    for left in (3.0, 9.0):
        box(grid, left, 2.9, left + 0.9, 3.3, FREE)
        for side in (left - 0.05, left + 0.9):
            box(grid, side, 3.0, side + 0.05, 3.2, OCCUPIED)
    return grid
