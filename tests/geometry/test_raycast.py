import math

import numpy as np
import pytest
from eigenscan.geometry import raycast
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, read_map
from eigenscan.geometry.raycast import RayCaster
from eigenscan.geometry.trace import DARK
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.environment import DATASETS

# written out, not taken from what is tested: a change there must show here
DARK_CELLS = 2.0


def dark_cells(cells: np.ndarray) -> np.ndarray:
    """UNKNOWN cells whose centre is farther than DARK_CELLS from every known cell's centre, one by one."""
    known = np.argwhere(cells != UNKNOWN)
    dark = np.zeros(cells.shape, dtype=bool)
    for row, column in np.argwhere(cells == UNKNOWN):
        nearest = np.hypot(*(known - [row, column]).T).min() if len(known) else math.inf
        dark[row, column] = nearest > DARK_CELLS
    return dark


def traverse(cells: np.ndarray, dark: np.ndarray, x: float, y: float, angle: float, limit: float) -> float:
    """Exact grid traversal (Amanatides and Woo), cell by cell: cells travelled to the first wall, or inf."""
    height, width = cells.shape
    dx, dy = math.cos(angle), math.sin(angle)
    column, row = math.floor(x), math.floor(y)
    step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    next_x = ((column + (dx > 0)) - x) / dx if abs(dx) > 1e-12 else math.inf
    next_y = ((row + (dy > 0)) - y) / dy if abs(dy) > 1e-12 else math.inf
    travelled = 0.0
    while travelled <= limit and 0 <= column < width and 0 <= row < height and not dark[row, column]:
        if cells[row, column] == OCCUPIED:
            return travelled
        if next_x < next_y:
            travelled, next_x, column = next_x, next_x + abs(1 / dx), column + step_x
        else:
            travelled, next_y, row = next_y, next_y + abs(1 / dy), row + step_y
    return math.inf


def reference(
    grid: GridMap, dark: np.ndarray, poses: np.ndarray, bearings: np.ndarray, range_max: float
) -> np.ndarray:
    starts = grid.to_grid(poses[:, :2])
    return np.array(
        [
            [
                traverse(
                    grid.cells,
                    dark,
                    x,
                    y,
                    theta + bearing - grid.origin[2],
                    range_max / grid.resolution,
                )
                * grid.resolution
                for bearing in bearings
            ]
            for (x, y), theta in zip(starts, poses[:, 2], strict=True)
        ]
    )


def close(a: np.ndarray, b: np.ndarray, within: float) -> np.ndarray:
    """Where two sets of ranges agree; no wall only with no wall."""
    with np.errstate(invalid="ignore"):
        return (a == b) | (np.abs(a - b) <= within)


def random_map(
    seed: int, origin: tuple[float, float, float] = (0.0, 0.0, 0.0), resolution: float = 0.1
) -> GridMap:
    """Free space with walls, specks and bays of unknown, open at its edges."""
    rng = np.random.default_rng(seed)
    cells = np.full((40, 50), FREE, dtype=np.uint8)
    cells[rng.random(cells.shape) < 0.02] = OCCUPIED
    cells[rng.random(cells.shape) < 0.01] = UNKNOWN
    for _ in range(4):
        r, c = rng.integers(0, 34), rng.integers(0, 40)
        cells[r : r + rng.integers(1, 9), c : c + rng.integers(1, 12)] = rng.choice([OCCUPIED, UNKNOWN])
    return GridMap(cells, resolution, np.array(origin))


def free_poses(grid: GridMap, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rows, columns = np.nonzero(grid.cells == FREE)
    chosen = rng.integers(0, len(rows), count)
    cells = np.column_stack([columns[chosen], rows[chosen]]) + rng.random((count, 2))
    return np.column_stack([grid.to_map(cells), rng.uniform(-np.pi, np.pi, count)])


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), yaw=st.floats(-4.0, 4.0), range_max=st.floats(0.3, 6.0))
def test_a_cast_is_exact_grid_traversal(seed: int, yaw: float, range_max: float) -> None:
    grid = random_map(seed, (3.0, -7.5, yaw))
    poses = free_poses(grid, 8, seed)
    bearings = np.linspace(-np.pi, np.pi, 40) + 0.0123
    expected = reference(grid, dark_cells(grid.cells), poses, bearings, range_max)
    ranges = RayCaster.of(grid).cast(poses, bearings, range_max)
    # a ray that grazes a corner to 1e-6 cells may fall on either side
    assert close(ranges, expected, 1e-4).mean() > 0.995


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), yaw=st.floats(-4.0, 4.0), range_max=st.floats(0.3, 6.0))
def test_a_panorama_is_exact_grid_traversal(seed: int, yaw: float, range_max: float) -> None:
    grid = random_map(seed, (3.0, -7.5, yaw))
    poses = free_poses(grid, 30, seed) * [1.0, 1.0, 0.0]
    directions = np.arange(72) * (2 * np.pi / 72)
    expected = reference(grid, dark_cells(grid.cells), poses, directions, range_max)
    ranges = RayCaster.of(grid).panoramas(poses[:, :2], 72, range_max)
    assert close(ranges, expected, 1e-4).mean() > 0.995


@pytest.mark.dataset
@pytest.mark.parametrize("name", ["fr079", "intel", "guardian"])
def test_rays_on_real_maps_are_exact(name: str) -> None:
    grid = read_map(DATASETS / name / "map.yaml")
    caster = RayCaster.of(grid)
    poses = free_poses(grid, 1500, 5) * [1.0, 1.0, 0.0]
    directions = np.arange(720) * (2 * np.pi / 720)
    swept = caster.panoramas(poses[:, :2], 720, 60.0)
    cast = caster.cast(poses, directions, 60.0)
    assert close(swept, cast, 0.01).mean() > 0.9995
    dark = caster.leap[1:-1, 1:-1] == DARK
    few = poses[:40]
    expected = reference(grid, dark, few, directions[::9], 60.0)
    assert close(cast[:40, ::9], expected, 1e-3).mean() > 0.999


def room(
    width: int = 60,
    height: int = 40,
    resolution: float = 0.05,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> GridMap:
    """A room with walls of one pixel."""
    cells = np.full((height, width), FREE, dtype=np.uint8)
    cells[[0, -1], :] = cells[:, [0, -1]] = OCCUPIED
    return GridMap(cells, resolution, np.array(origin))


def test_a_rectangle_from_its_middle() -> None:
    grid = room()
    pose = np.array([[1.5, 1.0, 0.0]])
    ranges = RayCaster.of(grid).cast(pose, [0.0, np.pi / 2, np.pi, -np.pi / 2], 10.0)
    np.testing.assert_allclose(ranges, [[1.45, 0.95, 1.45, 0.95]], atol=1e-5)
    np.testing.assert_allclose(RayCaster.of(grid).panoramas(pose[:, :2], 4, 10.0), ranges, atol=1e-5)


@pytest.mark.parametrize("angle", np.linspace(0, 2 * np.pi, 37))
def test_a_diagonal_wall_of_one_pixel_does_not_leak(angle: float) -> None:
    cells = np.full((60, 60), FREE, dtype=np.uint8)
    ring = np.linspace(0, 2 * np.pi, 2000)
    # 8-connected: neighbours may touch at a corner only
    cells[np.round(30 + 20 * np.sin(ring)).astype(int), np.round(30 + 20 * np.cos(ring)).astype(int)] = (
        OCCUPIED
    )
    grid = GridMap(cells, 0.1, np.zeros(3))
    pose = np.array([[3.0321, 3.0517, angle]])
    bearings = np.linspace(0, 0.2, 200)
    assert (RayCaster.of(grid).cast(pose, bearings, 50.0) < 2.2).all()
    assert (RayCaster.of(grid).panoramas(pose[:, :2], 720, 50.0) < 2.2).all()


def test_unknown_is_looked_through_where_it_is_thin_and_ends_a_ray_where_it_is_deep() -> None:
    cells = np.full((21, 100), FREE, dtype=np.uint8)
    cells[:, 40:44] = UNKNOWN
    cells[:, 90] = OCCUPIED
    thin = GridMap(cells, 0.1, np.zeros(3))
    cells = cells.copy()
    cells[:, 40:47] = UNKNOWN
    deep = GridMap(cells, 0.1, np.zeros(3))
    pose = np.array([[1.0, 1.05, 0.0]])
    assert RayCaster.of(thin).cast(pose, [0.0], 50.0)[0, 0] == pytest.approx(8.0, abs=1e-4)
    assert RayCaster.of(deep).cast(pose, [0.0], 50.0)[0, 0] == np.inf
    assert RayCaster.of(thin).panoramas(pose[:, :2], 4, 50.0)[0, 0] == pytest.approx(8.0, abs=1e-4)
    assert RayCaster.of(deep).panoramas(pose[:, :2], 4, 50.0)[0, 0] == np.inf


def test_no_wall_beyond_range_max_or_the_edge() -> None:
    grid = GridMap(
        np.pad(np.full((20, 20), FREE, np.uint8), ((0, 0), (0, 1)), constant_values=OCCUPIED),
        0.1,
        np.zeros(3),
    )
    pose = np.array([[0.55, 0.55, 0.0]])
    for range_max, expected in ((1.44, np.inf), (1.46, 1.45)):
        assert RayCaster.of(grid).cast(pose, [0.0], range_max)[0, 0] == pytest.approx(expected, abs=1e-4)
        assert RayCaster.of(grid).panoramas(pose[:, :2], 8, range_max)[0, 0] == pytest.approx(
            expected, abs=1e-4
        )
    assert np.isinf(RayCaster.of(grid).cast(pose, [2.0, 3.0, 4.5], 50.0)).all()


def test_starts_in_a_wall_outside_and_nowhere() -> None:
    grid = room()
    poses = np.array(
        [[0.01, 1.0, 0.0], [-5.0, 1.0, 0.0], [500.0, 1.0, 0.0], [np.nan, 1.0, 0.0], [1.0, 1.0, np.inf]]
    )
    ranges = RayCaster.of(grid).cast(poses, [0.0, 1.0], 10.0)
    assert (ranges[0] == 0).all()
    assert np.isinf(ranges[1:3]).all()
    assert np.isnan(ranges[3:]).all()
    swept = RayCaster.of(grid).panoramas(poses[:3, :2], 8, 10.0)
    assert (swept[0] == 0).all()
    assert np.isinf(swept[1:]).all()
    with pytest.raises(ValueError, match="not finite"):
        RayCaster.of(grid).panoramas(poses[:, :2], 8, 10.0)
    with pytest.raises(ValueError, match="0 beams"):
        RayCaster.of(grid).panoramas(poses[:1, :2], 0, 10.0)
    assert RayCaster.of(grid).panoramas(np.empty((0, 2)), 8, 10.0).shape == (0, 8)


@pytest.mark.parametrize("value", [FREE, UNKNOWN, OCCUPIED])
def test_maps_of_one_kind_of_cell(value: int) -> None:
    grid = GridMap(np.full((10, 12), value, dtype=np.uint8), 0.1, np.zeros(3))
    expected = 0.0 if value == OCCUPIED else np.inf
    assert (RayCaster.of(grid).cast([[0.55, 0.55, 0.3]], [0.0, 1.0], 10.0) == expected).all()
    assert (RayCaster.of(grid).panoramas([[0.55, 0.55]], 8, 10.0) == expected).all()


def test_threads_do_not_change_panoramas() -> None:
    grid = random_map(3)
    points = free_poses(grid, 200, 1)[:, :2]
    one = RayCaster.of(grid).panoramas(points, 90, 5.0)
    np.testing.assert_array_equal(RayCaster.of(grid).panoramas(points, 90, 5.0, threads=3), one)


@pytest.mark.parametrize("yaw", [0.0, 0.3])
def test_a_position_sees_the_same_alone_as_among_others(yaw: float) -> None:
    grid = random_map(8, (1.0, 2.0, yaw))
    # on the corners of cells, where a ray along the axes runs between two rows
    inside = np.argwhere(grid.cells[2:-2:5, 2:-2:5] == FREE)[:, ::-1] * 5 + 2
    points = grid.to_map(inside)
    together = RayCaster.of(grid).panoramas(points, 90, 1.0)
    alone = np.vstack([RayCaster.of(grid).panoramas(point[None], 90, 1.0) for point in points])
    np.testing.assert_allclose(together, alone, atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_a_ray_goes_on_beyond_what_is_swept(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    grid = random_map(seed, (1.0, 2.0, 0.3))
    points = free_poses(grid, 6, seed)[:, :2]
    points = points[np.linalg.norm(points - points[0], axis=1) < 1.5]
    whole = RayCaster.of(grid).panoramas(points, 180, 6.0)
    monkeypatch.setattr(raycast, "SWEPT", 0.4)
    part = RayCaster.of(grid).panoramas(points, 180, 6.0)
    assert close(part, whole, 1e-5).mean() > 0.999
    assert np.isfinite(part[part > 2.0]).any()


@pytest.mark.parametrize("swept", [0.4, 1.1, 20.0])
@pytest.mark.parametrize("yaw", [0.0, 0.3])
def test_what_is_seen_does_not_depend_on_how_the_positions_are_shared_out(
    swept: float, yaw: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(raycast, "SWEPT", swept)
    grid = random_map(11, (1.0, 2.0, yaw))
    points = free_poses(grid, 300, 11)[:, :2]
    together = RayCaster.of(grid).panoramas(points, 180, 6.0)
    parts = [RayCaster.of(grid).panoramas(part, 180, 6.0) for part in np.array_split(points, 9)]
    np.testing.assert_array_equal(np.vstack(parts), together)


def test_each_ray_may_end_at_its_own_range() -> None:
    grid = random_map(4, (3.0, -7.5, 0.4))
    poses, bearings = free_poses(grid, 20, 4), np.linspace(-np.pi, np.pi, 40)
    limits = np.random.default_rng(4).uniform(0.2, 5.0, 40)
    far, near = (
        RayCaster.of(grid).cast(poses, bearings, 50.0),
        RayCaster.of(grid).cast(poses, bearings, limits),
    )
    assert np.array_equal(near, np.where(far <= limits.astype(np.float32), far, np.float32(np.inf)))


def test_off_the_map_and_deep_in_the_unknown_it_is_dark() -> None:
    cells = np.full((30, 30), UNKNOWN, dtype=np.uint8)
    cells[10:20, 10:20] = FREE
    cells[10, 10:20] = OCCUPIED
    caster = RayCaster.of(GridMap(cells, 0.1, np.zeros(3)))
    points = [[1.5, 1.5], [1.5, 1.05], [1.5, 2.05], [1.5, 2.5], [-1.0, 1.5]]
    # free, in a wall, in a speck's depth of the unknown, deep in it, off the map
    assert caster.in_dark(points).tolist() == [False, False, False, True, True]


def test_points_lie_among_the_cells_as_on_the_grid() -> None:
    grid = GridMap(np.zeros((4, 5), dtype=np.uint8), 0.05, np.array([3.0, -2.0, 0.4]))
    points = np.random.default_rng(1).normal(size=(3, 7, 2))
    found = RayCaster.of(grid).to_cells(points)
    assert np.allclose(found, grid.to_grid(points) + 1.0, rtol=0, atol=1e-12)
