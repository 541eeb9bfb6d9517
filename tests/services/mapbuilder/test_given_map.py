"""A given map made better by a drive: its frame stays, its walls become true, and what was not seen stays."""

from dataclasses import replace

import numpy as np
import pytest
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.geometry.pose import between, compose
from eigenscan.mapbuilder.mapping.chain import Keyframe
from eigenscan.mapbuilder.mapping.cloud import Cloud
from eigenscan.mapbuilder.mapping.given_map import INEXACT, LEAST, Located, filled, frame_on, located_edges
from eigenscan.mapbuilder.mapping.survey import MappingError, survey
from scipy.ndimage import binary_dilation
from scipy.spatial import KDTree

from tests.services.mapbuilder.building import building, drive, scans

FRAME = np.array([7.0, -3.0, 2.0])
NOTHING = GridMap(np.full((4, 4), UNKNOWN, np.uint8), 0.1, np.zeros(3))


def keyframes(count: int) -> list[Keyframe]:
    empty = Cloud(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    return [Keyframe(k, 0, np.array([0.25 * k, 0.0, 0.0]), empty, None) for k in range(count)]


def located_at(poses: np.ndarray, covariance: float = 1e-4) -> Located:
    return Located(
        NOTHING, np.arange(len(poses)), poses, np.broadcast_to(covariance * np.eye(3), (len(poses), 3, 3))
    )


def test_a_part_lies_where_most_of_its_located_poses_agree() -> None:
    own = np.array([frame.pose for frame in keyframes(30)])
    on_map = compose(FRAME, own)
    on_map[:10] += [20.0, 0.0, 1.0]  # a lookalike was claimed for a third of the way
    found = frame_on(located_edges(keyframes(30), located_at(on_map), 30), own)
    assert found is not None
    np.testing.assert_allclose(found, FRAME, atol=1e-9)


@pytest.mark.parametrize("agreeing", [LEAST - 1, 14])
def test_few_or_contradicting_poses_place_nothing(agreeing: int) -> None:
    own = np.array([frame.pose for frame in keyframes(30)])
    on_map = compose(FRAME, own)
    rest = np.arange(agreeing, 30)
    on_map[rest, :2] += 10.0 * rest[:, None]
    count = agreeing if agreeing < LEAST else 30
    edges = located_edges(keyframes(count), located_at(on_map[:count]), count)
    assert frame_on(edges, own[:count]) is None


def test_an_edge_is_as_inexact_as_the_pose_and_the_map_together() -> None:
    ((edge),) = located_edges(keyframes(1), located_at(FRAME[None], covariance=0.5), 1)
    assert (edge.first, edge.second, edge.trusted) == (1, 0, False)
    np.testing.assert_allclose(edge.covariance, INEXACT + 0.5 * np.eye(3))


def test_cells_that_no_ray_saw_come_from_the_given_map_in_any_frame() -> None:
    # a wall at x = 1 m, in a map that is turned by a right angle and has cells twice as large
    cells = np.full((30, 20), FREE, np.uint8)
    cells[:, 10] = OCCUPIED
    given = GridMap(cells, 0.1, np.array([2.0, 0.0, np.pi / 2]))
    carved = np.full((40, 60), UNKNOWN, np.uint8)
    carved[:, :20] = FREE
    made = filled(GridMap(carved, 0.05, np.array([-1.0, 0.0, 0.0])), given)
    assert (made.cells[:, :20] == FREE).all()
    points = made.to_map(np.argwhere(made.cells == OCCUPIED)[:, ::-1] + 0.5)
    assert len(points)
    np.testing.assert_allclose(points[:, 1], 1.05, atol=0.051)
    assert (points[:, 0] > 0.0).all()


def test_a_thick_wall_keeps_its_middle_where_nothing_was_seen_and_only_its_seen_face_elsewhere() -> None:
    # a wall from x = 1.0 to 1.6 m; the drive saw its face at 1.2 m, below y = 1.5 m
    cells = np.full((60, 60), FREE, np.uint8)
    cells[:, 20:32] = OCCUPIED
    given = GridMap(cells, 0.05, np.zeros(3))
    carved = np.full((60, 60), UNKNOWN, np.uint8)
    carved[:30, :24], carved[:30, 24] = FREE, OCCUPIED
    made = filled(GridMap(carved, 0.05, np.zeros(3)), given).cells
    assert (made[:30] == OCCUPIED).sum() == 30
    assert (made[:30, 24] == OCCUPIED).all()
    assert (made[10:28, 25:27] == UNKNOWN).all()  # the middle: nothing is known of it
    unseen = made[45:50]
    assert np.array_equal(np.unique(np.nonzero(unseen == OCCUPIED)[1]), [25, 26])
    assert (unseen[:, :24] == FREE).all()
    assert (unseen[:, 32:] == FREE).all()


def test_thin_walls_beside_a_seen_surface_stay() -> None:
    cells = np.full((40, 40), FREE, np.uint8)
    cells[:, 20] = OCCUPIED
    carved = np.full((40, 40), UNKNOWN, np.uint8)
    carved[:20, :20], carved[:20, 19] = FREE, OCCUPIED
    made = filled(GridMap(carved, 0.05, np.zeros(3)), GridMap(cells, 0.05, np.zeros(3))).cells
    assert (made[:, 20] == OCCUPIED).all()


@pytest.mark.slow
def test_thick_walls_become_true_ones_in_the_frame_of_the_map() -> None:
    grid, way = building(), drive()
    true_walls = grid.cells == OCCUPIED
    thick = grid.cells.copy()
    thick[binary_dilation(true_walls, iterations=round(0.25 / grid.resolution))] = OCCUPIED
    rng = np.random.default_rng(5)
    claims = compose(way, rng.normal(0, [0.15, 0.15, 0.02], way.shape))
    claims[40:60, :2] += 6.0  # false claims
    sweeps = scans(grid, way, drift=(0.05, np.deg2rad(1.0)))
    located = Located(
        GridMap(thick, grid.resolution, grid.origin),
        np.arange(len(way)),
        claims,
        np.broadcast_to(np.diag([0.1, 0.1, 0.02]) ** 2, (len(way), 3, 3)),
    )
    mapped = survey(sweeps, located=located)
    step = between(way[mapped.numbers], mapped.poses)
    assert np.hypot(step[:, 0], step[:, 1]).max() < 0.2
    assert (mapped.grid.at(way[:, :2]) == FREE).all()
    # of the false walls along the way next to none are left
    before = grid.to_map(np.argwhere((thick == OCCUPIED) & (grid.cells == FREE))[:, ::-1] + 0.5)
    before = before[KDTree(way[:, :2]).query(before)[0] < 1.0]
    assert len(before) > 1000
    assert (mapped.grid.at(before) == OCCUPIED).mean() < 0.1
    # rooms that the drive never entered stay as they were given
    room = np.array([[26.0, 6.5], [20.0, 5.0]])
    assert (mapped.grid.at(room) == located.grid.at(room)).all()
    with pytest.raises(MappingError, match="fits the log"):
        survey(sweeps[:60], located=replace(located, numbers=np.arange(3)))
