from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.distance_tiles import distance_tiles
from scipy.ndimage import distance_transform_edt


def whole(space: np.ndarray, **options: Any) -> np.ndarray:
    out = np.full(space.shape, np.nan)
    for part, distance in distance_tiles(space, **options):
        out[part] = distance
    return out


@pytest.mark.parametrize("share", [0.5, 0.01, 0.0005])
@pytest.mark.parametrize("tile", [16, 50, 1024])
def test_tiles_are_parts_of_the_whole_distance_transform(share: float, tile: int) -> None:
    space = np.random.default_rng(3).random((157, 211)) > share
    np.testing.assert_array_equal(whole(space, tile=tile), distance_transform_edt(space))


def test_a_void_wider_than_any_halo_is_exact_too() -> None:
    space = np.ones((40, 700), dtype=bool)
    space[20, 3] = False
    np.testing.assert_array_equal(whole(space, tile=32), distance_transform_edt(space))


def test_beyond_the_farthest_that_is_asked_for_only_that_is_known() -> None:
    space = np.ones((300, 400), dtype=bool)
    space[7, 9] = False
    exact, found = distance_transform_edt(space), whole(space, tile=64, farthest=50.0)
    near = exact <= 50.0
    np.testing.assert_array_equal(found[near], exact[near])
    assert (found[~near] > 50.0).all()


def test_a_tile_without_space_costs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    space = np.zeros((400, 500), dtype=bool)
    space[70:80, 110:130] = True
    exact, searched = distance_transform_edt(space), list[int]()

    def counted(crop: np.ndarray) -> np.ndarray:
        searched.append(crop.size)
        return distance_transform_edt(crop)

    monkeypatch.setattr("eigenscan.geometry.distance_tiles.distance_transform_edt", counted)
    np.testing.assert_array_equal(whole(space, tile=100), exact)
    assert len(searched) == 1


def test_where_there_is_nothing_to_be_near_to_all_is_infinitely_far() -> None:
    assert (whole(np.ones((30, 40), dtype=bool), tile=16) == np.inf).all()
