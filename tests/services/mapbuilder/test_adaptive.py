import itertools

import numpy as np
import pytest
from eigenscan.geometry.gridmap import GridMap
from eigenscan.mapbuilder.adaptive import adaptive_positions
from eigenscan.mapbuilder.positions import Positions, free_positions, standable, stands
from eigenscan.mapbuilder.site import Plan, build_site

DOORS = np.array([[3.45, 3.1], [9.45, 3.1]])


def places(positions: Positions) -> set[tuple[float, ...]]:
    return {tuple(point) for point in np.round(positions.points, 6).tolist()}


def test_the_even_grid_stays_and_others_come_between(office: GridMap) -> None:
    even = places(free_positions(office, 0.5, 0.15))
    found, share = adaptive_positions(office, Plan(error=0.5))
    assert even < places(found)
    assert places(found) < places(free_positions(office, 0.125, 0.15))
    assert len(places(found)) == len(found.index)
    assert found.spacing == 0.125
    assert stands(office, standable(office, 0.15), found.points).all()
    assert 0.5 < share <= 1.0


def test_they_crowd_in_doorways_not_in_the_middle_of_rooms(office: GridMap) -> None:
    points = adaptive_positions(office, Plan(error=0.5))[0].points
    closest = free_positions(office, 0.125, 0.15).points

    def share_near(place: np.ndarray | list[float], reach: float = 0.7) -> float:
        near = np.linalg.norm(points - place, axis=1) < reach
        return near.sum() / (np.linalg.norm(closest - place, axis=1) < reach).sum()

    assert min(share_near(door) for door in DOORS) > 0.8
    assert max(share_near(middle) for middle in ([4.0, 5.7], [9.5, 5.7])) < 0.3


def test_a_tighter_bound_only_adds_and_finer_squares_hold_more(office: GridMap) -> None:
    sets, shares = [], []
    for error in (2.0, 1.0, 0.5, 0.25):
        found, _ = adaptive_positions(office, Plan(error=error))
        sets.append(places(found))
        shares.append([adaptive_positions(office, Plan(error=error), halvings)[1] for halvings in (0, 1, 2)])
    assert all(loose <= tight for loose, tight in itertools.pairwise(sets))
    assert all(row == sorted(row) for row in shares)


def test_in_a_hall_whose_walls_are_out_of_sight_nothing_is_added() -> None:
    from eigenscan.geometry.gridmap import FREE, GridMap

    grid = GridMap(np.full((200, 240), FREE, np.uint8), 0.05, np.array([-0.01, -0.01, 0.0]))
    found, share = adaptive_positions(grid, Plan(error=0.1, range_max=1.0, range_cap=1.0))
    inner = np.all((found.points > 0.6) & (found.points < [11.3, 9.3]), axis=1)
    assert places(found.at(np.nonzero(inner)[0])) <= places(free_positions(grid, 0.5, 0.0))
    assert share > 0.95


@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_the_models_hold_the_positions_and_are_the_same_however_often_built(
    office: GridMap, yaw: float
) -> None:
    office.origin[2] = yaw
    plan = Plan(error=1.0, step=np.deg2rad(2.0))
    site = build_site(office, plan)
    held = np.unique(np.concatenate([model.positions for model in site.regions]).round(6), axis=0)
    assert len(held) == len(adaptive_positions(office, plan)[0].index)
    assert build_site(office, plan).to_message() == site.to_message()
