import tracemalloc
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from eigenscan.geometry.circle import difference
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.pose import between, compose, transform
from eigenscan.mapbuilder.mapping.alignment import align
from eigenscan.mapbuilder.mapping.chain import Chain, Chainer, Step, Sweep
from eigenscan.mapbuilder.mapping.cloud import Cloud, Outline
from eigenscan.mapbuilder.mapping.correlation import Ground, correlate
from eigenscan.mapbuilder.mapping.drawing import draw_way
from eigenscan.mapbuilder.mapping.survey import Mapped, MappingError, survey
from eigenscan.mapbuilder.mapping.visits import visit_edges
from scipy.spatial import KDTree

from tests.services.mapbuilder.building import BEARINGS, building, drive, scans

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def grid() -> GridMap:
    return building()


@pytest.fixture(scope="module")
def way() -> np.ndarray:
    return drive()


def errors(mapped: Mapped, way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    truth = between(way[mapped.numbers[0]], way[mapped.numbers])
    step = between(truth, mapped.poses)
    return np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])


def test_a_return_from_the_horizon_is_named(grid: GridMap, way: np.ndarray) -> None:
    sweeps = scans(grid, way[:20])
    outline = sweeps[10].outline
    ranges = np.where(np.arange(len(outline.ranges)) == 5, 60_000.0, outline.ranges)
    sweeps[10] = replace(sweeps[10], outline=Outline(outline.bearings, ranges))
    with pytest.raises(MappingError, match="State range_max in the log"):
        survey(sweeps)


def odometry_of(sweep: Sweep) -> np.ndarray:
    assert sweep.odometry is not None
    return sweep.odometry


def chained(sweeps: Iterable[Sweep]) -> Chain:
    chainer = Chainer(Step())
    for number, sweep in enumerate(sweeps):
        chainer.add(number, sweep)
    return chainer.chain


@pytest.fixture(scope="module")
def with_odometry(grid: GridMap, way: np.ndarray) -> Mapped:
    # every metre is 5 cm too long, and turned by a degree: off by many metres at the end
    return survey(scans(grid, way, drift=(0.05, np.deg2rad(1.0))))


@pytest.mark.parametrize("odometry", [True, False])
def test_a_drive_around_a_block_becomes_one_true_map(
    grid: GridMap, way: np.ndarray, odometry: bool, with_odometry: Mapped
) -> None:
    mapped = with_odometry if odometry else survey(scans(grid, way, seed=1))
    assert len(mapped.numbers) == len(way)
    assert not mapped.unjoined
    assert mapped.closures > 20
    metres, radians = errors(mapped, way)
    assert metres.mean() < 0.1
    assert metres.max() < 0.25
    assert radians.max() < np.deg2rad(1.5)


def test_the_map_is_that_of_the_building(grid: GridMap, way: np.ndarray, with_odometry: Mapped) -> None:
    made = with_odometry.grid
    rows, columns = np.nonzero(made.cells == OCCUPIED)
    walls = transform(way[0], made.to_map(np.column_stack([columns, rows]) + 0.5))
    truth = grid.to_map(np.argwhere(grid.cells == OCCUPIED)[:, ::-1] + 0.5)
    nearest, _ = KDTree(truth).query(walls)
    assert np.quantile(nearest, 0.9) < 0.15
    rows, columns = np.nonzero(made.cells == FREE)
    free = grid.at(transform(way[0], made.to_map(np.column_stack([columns, rows]) + 0.5)))
    assert (free == FREE).mean() > 0.97
    assert made.free_area > 100


def test_the_same_scans_give_the_same_map(grid: GridMap, way: np.ndarray) -> None:
    some = scans(grid, way[:120], drift=(0.02, 0.01))
    one, other = survey(some), survey(some)
    assert one.grid.version == other.grid.version
    np.testing.assert_array_equal(one.poses, other.poses)


def test_a_stretch_without_overlap_is_named_and_the_rest_is_kept(grid: GridMap, way: np.ndarray) -> None:
    sweeps = scans(grid, way, seed=2)
    # no odometry, and the robot was carried: these scans lie in a room that no other scan shows
    elsewhere = np.array([[26.0 + 0.05 * k, 26.0, 0.05 * k] for k in range(30)])
    carried = scans(grid, elsewhere, seed=3)
    start = len(way) // 2
    after = [replace(s, stamp=s.stamp + 6_000_000_000) for s in sweeps[start:]]
    carried = [replace(s, stamp=s.stamp + sweeps[start].stamp) for s in carried]
    mapped = survey([*sweeps[:start], *carried, *after])
    inside = np.isin(np.arange(start, start + 30), mapped.numbers)
    assert not inside.any()
    assert any(first == start for first, _ in mapped.unjoined)
    assert len(mapped.numbers) > 0.45 * len(way)
    kept = mapped.numbers
    truth = way[np.where(kept >= start + 30, kept - 30, kept)]
    step = between(between(truth[0], truth), mapped.poses)
    assert np.hypot(step[:, 0], step[:, 1]).max() < 0.4


def test_odometry_that_jumps_is_not_followed(grid: GridMap, way: np.ndarray) -> None:
    jumped = [
        replace(s, odometry=compose([40.0, -9.0, 2.0], odometry_of(s))) if k >= 60 else s
        for k, s in enumerate(scans(grid, way[:150], drift=(0.0, 0.0)))
    ]
    mapped = survey(jumped)
    assert mapped.jumps == 1
    assert errors(mapped, way)[0].max() < 0.3


def test_a_robot_that_was_carried_does_not_spoil_the_map(grid: GridMap, way: np.ndarray) -> None:
    # from a hallway into a room that it never drives into; odometry does not notice and goes on
    elsewhere = np.array([[26.0 + 0.05 * k, 26.0, 0.05 * k] for k in range(40)])
    before, after = scans(grid, way[:150], drift=(0.0, 0.0)), scans(grid, elsewhere, drift=(0.0, 0.0))
    shift = compose(odometry_of(before[-1]), between(odometry_of(after[0]), np.zeros(3)))
    after = [
        replace(s, stamp=s.stamp + before[-1].stamp + 200_000_000, odometry=compose(shift, odometry_of(s)))
        for s in after
    ]
    mapped = survey([*before, *after])
    assert mapped.numbers.tolist() == list(range(150))
    assert errors(mapped, way)[0].max() < 0.3
    ((first, last),) = mapped.unjoined
    assert mapped.left_out + last - first + 1 == 40


@pytest.mark.parametrize("odometry", [True, False])
def test_two_lidars_back_to_back_make_one_map(grid: GridMap, way: np.ndarray, odometry: bool) -> None:
    drift = (0.0, 0.0) if odometry else None
    true = way[:160]
    front = scans(grid, true, seed=1, drift=drift, mount=(0.2, 0.0, 0.0))
    rear = scans(grid, true, seed=2, drift=drift, mount=(-0.2, 0.0, np.pi))
    rear = [
        replace(s, stamp=s.stamp + 10_000_000, odometry=f.odometry) for s, f in zip(rear, front, strict=True)
    ]
    mapped = survey([s for pair in zip(front, rear, strict=True) for s in pair])
    assert len(mapped.numbers) == 2 * len(true)
    assert errors(mapped, np.repeat(true, 2, axis=0))[0].max() < 0.4
    # what only the rear lidar faces is on the map: the wall behind the start
    assert (mapped.grid.at([[-0.5, 0.0], [-0.8, 0.3]]) == FREE).all()


def test_scans_of_nothing_are_left_out(grid: GridMap, way: np.ndarray) -> None:
    sweeps = scans(grid, way[:60], drift=(0.0, 0.0))
    empty = Outline.of(np.full(len(BEARINGS), np.nan), BEARINGS)
    mapped = survey([replace(s, outline=empty) if k % 3 == 1 else s for k, s in enumerate(sweeps)])
    assert mapped.left_out == 20
    assert (mapped.numbers % 3 != 1).all()
    assert errors(mapped, way)[0].max() < 0.08


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_scans_are_refused(grid: GridMap, way: np.ndarray, count: int) -> None:
    with pytest.raises(MappingError, match=f"{count} of {count} scans show walls"):
        survey(scans(grid, way[:1])[:count])


def test_the_picture_shows_the_way(with_odometry: Mapped) -> None:
    picture = draw_way(with_odometry)
    assert picture.startswith(b"\x89PNG")
    assert len(picture) > 5000


@pytest.mark.parametrize("seed", range(5))
def test_a_cloud_is_found_on_another_at_any_heading(grid: GridMap, way: np.ndarray, seed: int) -> None:
    rng = np.random.default_rng(seed)
    chain = chained(scans(grid, way[:40], seed=seed))
    cloud = Cloud.joined([frame.cloud.moved(frame.pose) for frame in chain.keyframes]).thinned(0.1)
    moved = np.array([*rng.uniform(-30, 30, 2), rng.uniform(-np.pi, np.pi)])
    away = cloud.moved(moved)
    poses, heights = correlate(Ground(away, np.zeros((0, 2))), cloud, np.zeros(3), [np.inf, np.pi])
    assert (np.diff(heights) <= 0).all()
    found = align(away, cloud, poses[0])
    assert found.share > 0.98
    step = between(moved, found.pose)
    assert np.hypot(*step[:2]) < 0.02
    assert abs(step[2]) < np.deg2rad(0.2)


def test_alignment_takes_from_the_prior_what_the_walls_do_not_show() -> None:
    # two long parallel walls: nothing fixes the place along them
    x = np.linspace(-8, 8, 400)
    walls = Cloud(
        np.column_stack([np.r_[x, x[::-1]], np.r_[np.full(400, -1.0), np.full(400, 1.0)]]),
        np.r_[np.zeros(400), np.full(400, np.pi)],
        np.full(800, 0.04),
    )
    seen = Cloud(walls.points[50:750], walls.directions[50:750], walls.lengths[50:750])
    prior = np.diag([0.05, 0.3, 0.1]) ** 2
    found = align(walls, seen, [0.4, 0.2, 0.05], prior)
    np.testing.assert_allclose(found.pose, [0.4, 0.0, 0.0], atol=0.03)
    assert found.covariance[0, 0] > 25 * found.covariance[1, 1]
    assert difference(found.pose[2], 0.0) < 1e-3


def test_a_robot_that_drove_where_the_log_has_no_scans_begins_a_new_part(
    grid: GridMap, way: np.ndarray
) -> None:
    # hallways look alike: a scan after the gap would fit the walls of the one before it
    sweeps = scans(grid, way, drift=(0.0, 0.0))
    gap = [replace(s, stamp=s.stamp + 60_000_000_000) for s in sweeps[90:120]]
    assert {frame.part for frame in chained([*sweeps[:40], *gap]).keyframes} == {0, 1}
    # one that stood meanwhile goes on
    stood = [replace(s, stamp=s.stamp + 60_000_000_000) for s in sweeps[40:70]]
    assert {frame.part for frame in chained([*sweeps[:40], *stood]).keyframes} == {0}


def test_all_scans_of_a_robot_that_stands_draw_the_map(grid: GridMap, way: np.ndarray) -> None:
    """One was drawn, of 400 that were said to be in the map: far walls had too few rays."""
    stand = np.repeat(way[:1], 40, axis=0)
    whole = survey([replace(one, odometry=np.zeros(3)) for one in scans(grid, stand)])
    alone = survey([replace(one, odometry=np.zeros(3)) for one in scans(grid, stand[:2])])
    walls = [np.count_nonzero(each.grid.cells == OCCUPIED) for each in (whole, alone)]
    assert walls[0] > 1.3 * walls[1]


def test_visits_of_hours_in_one_room_are_not_all_held_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """All pairs of 6,000 keyframes took 430 MB, and four times as much of each further double."""
    monkeypatch.setattr("eigenscan.mapbuilder.mapping.visits._met", lambda *_: [])
    poses = np.column_stack([np.random.default_rng(0).uniform(0, 4, (1500, 2)), np.zeros(1500)])
    tracemalloc.start()
    assert visit_edges([], poses) == []
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2_000_000
