"""Maps with fat walls: blurred ones, whose surfaces lie in the middle, and buildings with fat walls."""

from functools import cache

import numpy as np
import pytest
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.covariance import pose_covariances
from eigenscan.schemas.hypotheses_pb2 import (
    SURFACES_FACES,
    SURFACES_MIDDLE,
    SURFACES_UNSPECIFIED,
    Surfaces,
)
from scipy.ndimage import distance_transform_edt

from tests.services.projector.office import free_poses, is_right, office, poses_of, ready, receive, scan_at

SCANS = 20


@cache
def fat(by: float) -> GridMap:
    grid = office()
    far = distance_transform_edt(grid.cells != OCCUPIED) * grid.resolution
    return GridMap(np.where(far <= by, np.uint8(OCCUPIED), grid.cells), grid.resolution, grid.origin)


@cache
def projector(by: float) -> ProjectorCore:
    return ready(build_site(fat(by), Plan()))


def first_right(by: float, seen_in: GridMap) -> float:
    """Share of the scans of a building whose first pose is right in the map with walls fatter `by` m."""
    hits = []
    for i, truth in enumerate(free_poses(SCANS, 21, fat(0.2))):
        message, _ = receive(projector(by), scan_at(truth, seed=i, grid=seen_in))
        hits.append(bool(is_right(poses_of(message)[:1], truth).any()))
    return float(np.mean(hits))


@pytest.mark.parametrize("by", [0.1, 0.2])
def test_on_a_blurred_map_scans_are_found(by: float) -> None:
    assert first_right(by, office()) >= 0.8


@pytest.mark.parametrize("by", [0.1, 0.2])
def test_where_walls_are_as_fat_as_they_are_drawn_scans_are_found_too(by: float) -> None:
    assert first_right(by, fat(by)) >= 0.7


@pytest.mark.parametrize(
    ("by", "seen_in", "wanted"),
    [(0.0, 0.0, SURFACES_UNSPECIFIED), (0.2, 0.0, SURFACES_MIDDLE), (0.2, 0.2, SURFACES_FACES)],
)
def test_a_list_states_which_surfaces_of_thick_walls_its_poses_fit(
    by: float, seen_in: float, wanted: Surfaces
) -> None:
    lists = [
        receive(projector(by), scan_at(truth, seed=i, grid=fat(seen_in)))[0]
        for i, truth in enumerate(free_poses(SCANS, 21, fat(0.2)))
    ]
    assert np.mean([each.surfaces == wanted for each in lists]) > 0.7
    # anywhere in a wall 5 cm thick that is drawn `by` fatter on each side: an even distribution
    inexactness = (0.05 + 2.0 * by) / 12.0**0.5 if by else 0.0
    assert [each.inexactness for each in lists] == pytest.approx([inexactness] * len(lists), abs=0.02)


def warehouse(pitch: int, seed: int) -> GridMap:
    """32 m x 22 m: thin walls, and rows of racks 0.75 m thick, drawn filled: most of what scans meet."""
    cells = np.full((440, 640), UNKNOWN, dtype=np.uint8)
    cells[10:430, 10:630] = OCCUPIED
    cells[13:427, 13:627] = FREE
    rng = np.random.default_rng(seed)
    for row in range(pitch - 2, 392, pitch):
        column = 80
        while column < 540:
            end = column + int(rng.integers(80, 160))
            cells[row : row + 15, column : min(end, 560)] = OCCUPIED
            column = end + int(rng.choice([0, 44]))
    return GridMap(cells, 0.05, np.zeros(3))


def test_filled_racks_are_met_at_their_faces_also_where_their_middles_fit_one_place_alone() -> None:
    hits = []
    for grid in (warehouse(60, 2), warehouse(80, 1)):
        built = ready(build_site(grid, Plan()))
        for i, truth in enumerate(free_poses(SCANS, 5, grid)):
            message, _ = receive(built, scan_at(truth, seed=i, grid=grid))
            hits.append(bool(is_right(poses_of(message)[:1], truth).any()))
    assert np.mean(hits) >= 0.85


def test_a_thick_wall_makes_its_pose_less_sure() -> None:
    information = np.diag([40.0, 40.0, 90.0])[None]
    thin, thick = pose_covariances(information)[0], pose_covariances(information, 0.12)[0]
    # the surface's error beside a point's own 5 cm, before what the grid and the map's own error add
    assert np.all(np.diag(thick) > np.diag(thin))
    assert thick[0, 0] - thin[0, 0] == pytest.approx(0.12**2 / (0.25 * 40.0), rel=0.1)


def test_the_pose_is_not_drawn_to_the_faces_of_blurred_walls() -> None:
    off = []
    for i, truth in enumerate(free_poses(SCANS, 21, fat(0.2))):
        message, _ = receive(projector(0.2), scan_at(truth, seed=i))
        best = poses_of(message)[0]
        if is_right(best[None], truth)[0]:
            off.append(np.hypot(*(best - truth)[:2]))
    assert np.median(off) < 0.1
