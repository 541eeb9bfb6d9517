import numpy as np
import pytest
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, read_map
from eigenscan.mapbuilder.positions import free_positions, standable
from eigenscan.mapbuilder.regions import Division, Regions, divide
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.environment import DATASETS
from tests.services.mapbuilder.floorplan import blank, box, room


def core_at(regions: Regions, *points: tuple[float, float]) -> list[int]:
    """Number of the one region whose core holds each point."""
    column, row = np.floor(regions.grid.to_grid(points) / regions.block).astype(int).T
    return regions.core[row, column].tolist()


def regions_of(regions: Regions, point: tuple[float, float]) -> set[int]:
    """Numbers of all regions that hold a point."""
    return {n for n, inside in enumerate(regions.members(np.array([point])), 1) if len(inside)}


def test_each_room_and_the_hallway_is_a_region(office: GridMap) -> None:
    regions = divide(office, Division())
    hallway = core_at(regions, (1.5, 2.0), (7.0, 2.0), (12.5, 2.0), (6.0, 1.2))
    left = core_at(regions, (2.0, 4.0), (6.0, 6.5), (4.0, 5.0))
    right = core_at(regions, (7.5, 4.0), (11.5, 6.5), (9.0, 5.0))
    assert [set(hallway), set(left), set(right)] == [{hallway[0]}, {left[0]}, {right[0]}]
    assert {hallway[0], left[0], right[0]} == {1, 2, 3}
    assert regions.core.max() == 3


@pytest.mark.parametrize("quarters", range(4))
def test_a_piece_with_most_of_its_cells_at_one_end_is_halved_too(quarters: int) -> None:
    cells = np.full((7, 7), OCCUPIED, dtype=np.uint8)
    cells[1, 1:4] = cells[2:4, 2] = FREE
    grid = GridMap(np.ascontiguousarray(np.rot90(cells, quarters)), 1.0, np.zeros(3))
    sizes = np.bincount(divide(grid, Division(largest=3.0, smallest=0.0, clutter=0.0)).core.ravel())[1:]
    assert sizes.sum() == 5
    assert sizes.max() <= 3


def test_regions_overlap_by_the_margin_through_doors_and_not_through_walls(office: GridMap) -> None:
    regions = divide(office, Division(margin=1.0))
    hallway, room_left, room_right = core_at(regions, (7.0, 2.0), (4.0, 5.0), (9.0, 5.0))
    assert regions_of(regions, (3.45, 3.8)) == {hallway, room_left}
    assert regions_of(regions, (3.45, 2.6)) == {hallway, room_left}
    assert regions_of(regions, (9.45, 3.8)) == {hallway, room_right}
    assert regions_of(regions, (5.5, 2.9)) == {hallway}  # 0.3 m from the room, behind the wall
    assert regions_of(regions, (6.4, 5.0)) == {room_left}  # 0.6 m from the other room, behind the wall
    assert regions_of(regions, (3.45, 5.0)) == {room_left}  # 1.8 m into the room


def test_unknown_ground_around_changes_no_region(office: GridMap) -> None:
    alone = divide(office, Division())
    around = np.pad(office.cells, ((40, 300), (600, 20)), constant_values=UNKNOWN)
    found = divide(GridMap(around, office.resolution, office.origin), Division())
    top, left, (height, width) = 40 // found.block, 600 // found.block, alone.core.shape
    np.testing.assert_array_equal(found.core[top : top + height, left : left + width], alone.core)
    assert np.count_nonzero(found.core) == np.count_nonzero(alone.core)


@pytest.mark.parametrize("margin", [0.0, 0.5, 2.0])
def test_the_margin_is_what_was_asked_for(margin: float) -> None:
    grid = blank(42.0, 4.0)
    room(grid, 1.0, 1.0, 41.0, 3.0)
    regions = divide(grid, Division(margin=margin, largest=45.0))
    assert regions.core.max() == 2
    line = np.column_stack([np.arange(1.05, 41.0, 0.1), np.full(400, 2.0)])
    both = set.intersection(*(set(inside.tolist()) for inside in regions.members(line)))
    assert len(both) * 0.1 == pytest.approx(2 * margin, abs=0.11)


def test_what_stands_in_a_room_does_not_part_it(office: GridMap) -> None:
    before = divide(office, Division()).core
    for x, y in [(2.5, 5.0), (4.0, 6.0), (4.5, 4.5), (5.5, 5.5), (3.4, 5.4)]:
        box(office, x, y, x + 0.4, y + 0.4, OCCUPIED)
    after = divide(office, Division()).core
    np.testing.assert_array_equal(before > 0, after > 0)
    assert after.max() == 3


def test_a_huge_hall_is_cut_to_size_and_a_closet_joins_its_neighbour() -> None:
    grid = blank(64.0, 44.0)
    room(grid, 2.0, 2.0, 62.0, 40.0)
    room(grid, 30.0, 40.2, 31.5, 41.5)
    box(grid, 30.3, 39.9, 31.0, 40.3, FREE)
    division = Division(largest=150.0)
    regions = divide(grid, division)
    areas = np.bincount(regions.core.ravel())[1:] * division.raster**2
    assert areas.max() <= 150.0
    assert areas.min() >= 4.0
    assert areas.sum() == pytest.approx(60 * 38 + 1.5 * 1.3 + 0.7 * 0.2, rel=0.01)
    assert core_at(regions, (30.7, 41.0)) == core_at(regions, (30.7, 39.0))


def test_regions_are_numbered_by_place_and_always_the_same(office: GridMap) -> None:
    one, two = divide(office, Division()), divide(office, Division())
    np.testing.assert_array_equal(one.core, two.core)
    assert core_at(one, (7.0, 2.0), (4.0, 5.0), (9.0, 5.0)) == [1, 2, 3]


def test_a_turned_map_has_the_same_regions(office: GridMap) -> None:
    turned = GridMap(office.cells, office.resolution, np.array([4.0, -7.0, 2.1]))
    regions, same = divide(office, Division()), divide(turned, Division())
    points = np.array([(7.0, 2.0), (4.0, 5.0), (3.45, 3.4), (9.0, 5.0)])
    moved = turned.to_map(points / office.resolution)
    for one, other in zip(regions.members(points), same.members(moved), strict=True):
        np.testing.assert_array_equal(one, other)


def test_outlines_go_round_the_region(office: GridMap) -> None:
    regions = divide(office, Division(margin=0.0))
    outline = regions.outline(core_at(regions, (4.0, 5.0))[0] - 1)
    x, y = outline.T
    area = 0.5 * abs(np.sum(x * np.roll(y, 1) - y * np.roll(x, 1)))
    assert area == pytest.approx(20.0, abs=1.0)
    np.testing.assert_allclose([x.min(), x.max(), y.max()], [1.5, 6.5, 7.2], atol=0.15)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 9999), walls=st.floats(0.0, 0.3))
def test_every_position_is_in_a_region_whatever_the_map(seed: int, walls: float) -> None:
    rng = np.random.default_rng(seed)
    cells = np.where(rng.random((60, 80)) < walls, OCCUPIED, FREE).astype(np.uint8)
    for _ in range(6):
        r, c = rng.integers(0, 55), rng.integers(0, 70)
        cells[r : r + rng.integers(1, 20), c : c + rng.integers(1, 20)] = rng.choice([0, 100, 255])
    cells[5, 5] = FREE
    grid = GridMap(cells, 0.05, np.array([0.3, 0.2, 0.4]))
    positions = free_positions(grid, 0.25, 0.0)
    regions = divide(grid, Division(largest=4.0, smallest=0.5))
    members = regions.members(positions.points)
    assert set(np.concatenate([[], *members]).astype(int)) == set(range(len(positions.index)))


@pytest.mark.dataset
@pytest.mark.parametrize("name", ["fr079", "intel", "jarvis", "guardian", "olin_mac"])
def test_every_position_of_a_real_building_is_in_a_region_of_a_rooms_size(name: str) -> None:
    grid = read_map(DATASETS / name / "map.yaml")
    positions, division = free_positions(grid, 0.25, 0.15), Division()
    regions = divide(grid, division)
    members = regions.members(positions.points)
    assert set(np.concatenate(members).tolist()) == set(range(len(positions.index)))
    areas = np.bincount(regions.core.ravel())[1:] * (regions.block * grid.resolution) ** 2
    assert areas.max() <= division.largest
    inhabited = [len(inside) * 0.25**2 for inside in members if len(inside)]
    # a building is more than one place, and its places are not crumbs
    assert 3 <= len(inhabited) < grid.free_area / 10
    assert np.median(inhabited) > 5.0


def test_positions_are_the_free_grid_points_clear_of_walls(office: GridMap) -> None:
    positions = free_positions(office, 0.5, 0.3)
    x, y = np.meshgrid(np.arange(0, 14.5, 0.5), np.arange(0, 9.5, 0.5))
    candidates = np.column_stack([x.ravel(), y.ravel()])
    walls = office.to_map(np.argwhere(office.cells == OCCUPIED)[:, ::-1] + 0.5)
    cell = office.to_map(np.floor(office.to_grid(candidates)) + 0.5)
    clear = np.linalg.norm(cell[:, None] - walls, axis=-1).min(axis=1) >= 0.3
    expected = candidates[clear & (office.at(candidates) == FREE)]
    np.testing.assert_allclose(positions.points, expected)
    assert len(expected) > 100


def test_positions_do_not_move_when_the_map_grows() -> None:
    small, large = blank(6.0, 6.0, origin=(1.03, 2.01, 0.0)), blank(26.0, 16.0, origin=(-8.97, -3.99, 0.0))
    room(small, 1.0, 1.0, 5.0, 5.0)
    room(large, 11.0, 7.0, 15.0, 11.0)
    room(large, 16.0, 2.0, 20.0, 6.0)
    before, after = free_positions(small, 0.25, 0.15), free_positions(large, 0.25, 0.15)
    assert set(map(tuple, before.index.tolist())) < set(map(tuple, after.index.tolist()))


def test_a_gap_between_walls_is_no_place() -> None:
    grid = blank(10.0, 10.0)
    room(grid, 1.0, 1.0, 6.0, 6.0)
    room(grid, 7.0, 7.0, 7.5, 7.5)
    assert standable(grid, 0.1)[60, 60]
    assert not standable(grid, 0.1)[140:150, 140:150].any()
    # but where there is nothing else it is all there is
    alone = blank(10.0, 10.0)
    room(alone, 7.0, 7.0, 7.5, 7.5)
    assert standable(alone, 0.1)[140:150, 140:150].any()
