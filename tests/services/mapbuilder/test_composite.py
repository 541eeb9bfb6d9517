import gzip
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.circle import difference
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.pose import between, compose, transform
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.mapping.chain import Sweep
from eigenscan.mapbuilder.mapping.cloud import Outline
from eigenscan.mapbuilder.mapping.composite import composite
from eigenscan.mapbuilder.mapping.submap import Agreement, Submap, compare
from eigenscan.mapbuilder.mapping.survey import Mapped, MappingError
from eigenscan.mapbuilder.site import Plan, build_site

from tests.environment import DATASETS
from tests.services.mapbuilder.floorplan import blank, box, room

BEARINGS = np.deg2rad(np.arange(-180, 180, 0.5))


@pytest.fixture
def furnished() -> GridMap:
    """One office, as in the paper's figure 2: not square, a cupboard, desks, a niche."""
    grid = blank(10.0, 9.0, 0.02)
    room(grid, 1.0, 1.0, 7.4, 6.0)
    room(grid, 5.0, 5.9, 7.4, 7.5)
    box(grid, 1.0, 4.8, 1.6, 6.0, OCCUPIED)
    box(grid, 3.0, 1.0, 4.4, 1.7, OCCUPIED)
    box(grid, 5.6, 3.4, 6.2, 4.6, OCCUPIED)
    box(grid, 2.2, 3.4, 2.5, 3.7, OCCUPIED)
    return grid


def scan(
    grid: GridMap, pose: np.ndarray, seed: int, bearings: np.ndarray = BEARINGS, noise: float = 0.02
) -> Outline:
    ranges = RayCaster.of(grid).cast(pose[None], bearings, 30.0)[0].astype(float)
    return Outline.of(ranges + np.random.default_rng(seed).normal(0, noise, len(ranges)), bearings)


def joined(*outlines: Outline, mount: np.ndarray | None = None) -> Mapped:
    where = np.zeros(3) if mount is None else mount
    return composite([Sweep(k, outline, where) for k, outline in enumerate(outlines)])


def poses_in_the_room(seed: int, count: int = 4) -> np.ndarray:
    rng = np.random.default_rng(seed)
    places = np.array([[2.0, 2.2], [4.8, 2.4], [3.4, 4.6], [6.4, 2.0]]) + rng.uniform(-0.3, 0.3, (4, 2))
    return np.column_stack([places, rng.uniform(-np.pi, np.pi, 4)])[:count]


@pytest.mark.parametrize("seed", range(6))
def test_four_scans_of_one_office_at_unknown_poses_make_one_composite(furnished: GridMap, seed: int) -> None:
    poses = poses_in_the_room(seed)
    found = joined(*(scan(furnished, pose, seed + k) for k, pose in enumerate(poses))).poses
    expected = np.array([between(poses[0], pose) for pose in poses])
    assert np.hypot(*(found - expected)[:, :2].T).max() < 0.04
    assert np.rad2deg(np.abs(difference(found[:, 2], expected[:, 2]))).max() < 0.5
    # all points of the composite lie on the walls
    walls = furnished.to_map(np.argwhere(furnished.cells == OCCUPIED)[:, ::-1] + 0.5)
    for k, pose in enumerate(found):
        points = transform(compose(poses[0], pose), scan(furnished, poses[k], seed + k, noise=0.0).points)
        nearest = np.sqrt(((points[::9, None] - walls) ** 2).sum(axis=-1)).min(axis=1)
        assert np.quantile(nearest, 0.95) < 0.08


@pytest.mark.parametrize("seed", range(4))
def test_scans_of_half_a_turn_that_overlap(furnished: GridMap, seed: int) -> None:
    half = np.deg2rad(np.arange(-90, 90.25, 0.5))
    rng = np.random.default_rng(seed)
    first = np.array([2.0, 2.4, rng.uniform(0.2, 0.6)])
    second = np.array([2.8, 2.6, first[2] + rng.uniform(-0.6, 0.6)])
    found = joined(scan(furnished, first, seed, half), scan(furnished, second, seed + 1, half))
    expected = between(first, second)
    assert np.hypot(*(found.poses[1] - expected)[:2]) < 0.05
    assert abs(difference(found.poses[1, 2], expected[2])) < np.deg2rad(0.7)


def test_the_order_of_two_scans_does_not_matter(furnished: GridMap) -> None:
    one, two = (scan(furnished, pose, k) for k, pose in enumerate(poses_in_the_room(3, 2)))
    there, back = joined(one, two), joined(two, one)
    there_and_back = compose(there.poses[1], back.poses[1])
    assert np.hypot(*there_and_back[:2]) < 0.03
    assert abs(there_and_back[2]) < np.deg2rad(0.5)


def test_a_scan_of_another_place_is_left_out(furnished: GridMap) -> None:
    elsewhere = blank(30.0, 6.0, 0.02)
    room(elsewhere, 1.0, 1.0, 28.0, 2.4)
    poses = poses_in_the_room(1, 3)
    outlines = [scan(furnished, pose, k) for k, pose in enumerate(poses)]
    outlines.insert(1, scan(elsewhere, np.array([14.0, 1.6, 0.4]), 9))
    found = joined(*outlines)
    assert found.numbers.tolist() == [0, 2, 3]
    assert found.unjoined == ((1, 1),)
    expected = np.array([between(poses[0], pose) for pose in poses])
    assert np.abs((found.poses - expected)[:, :2]).max() < 0.04


def test_scans_of_a_square_room_that_fit_four_ways_are_not_joined() -> None:
    grid = blank(8.0, 8.0, 0.02)
    room(grid, 1.0, 1.0, 6.0, 6.0)
    one = scan(grid, np.array([2.0, 3.0, 0.3]), 1)
    two = scan(grid, np.array([4.0, 2.6, 1.1]), 2)
    with pytest.raises(MappingError, match="overlap"):
        joined(one, two)


@pytest.mark.parametrize(
    "ranges", [np.full(720, np.inf), np.full(720, np.nan), np.zeros(720), np.full(720, -1.0)]
)
def test_scans_that_saw_nothing_join_nothing(furnished: GridMap, ranges: np.ndarray) -> None:
    good = scan(furnished, poses_in_the_room(0)[0], 0)
    with pytest.raises(MappingError, match="no two of 2 scans"):
        joined(good, Outline.of(ranges, BEARINGS))


def test_no_scans_make_no_map() -> None:
    with pytest.raises(MappingError, match="of 0 scans fit"):
        composite([])


def test_models_from_four_scans_alone_show_the_room(furnished: GridMap) -> None:
    poses = poses_in_the_room(2)
    outlines = [scan(furnished, pose, k) for k, pose in enumerate(poses)]
    grid = joined(*outlines).grid
    # the composite's frame is the first scan's
    site = build_site(grid, Plan(step=np.deg2rad(2.0), clearance=0.3))
    positions = np.concatenate([model.positions for model in site.regions])
    assert len(positions) > 50
    truly = transform(poses[0], positions)
    assert (furnished.at(truly) == FREE).all()
    for model in site.regions:
        there = np.column_stack(
            [transform(poses[0], model.positions), np.full(len(model.positions), poses[0, 2])]
        )
        expected = RayCaster.of(furnished).cast(there, np.arange(180) * np.deg2rad(2.0), 30.0)
        assert np.median(np.abs(model.panoramas - expected)) < 0.06
        assert (np.abs(model.panoramas - expected) < 0.15).mean() > 0.85


def test_poses_are_of_the_robot_wherever_its_lidar_is(furnished: GridMap) -> None:
    mount, poses = np.array([0.3, -0.1, 0.7]), poses_in_the_room(4)
    outlines = [scan(furnished, compose(pose, mount), k) for k, pose in enumerate(poses)]
    expected = np.array([between(poses[0], pose) for pose in poses])
    assert np.abs((joined(*outlines, mount=mount).poses - expected)[:, :2]).max() < 0.04


def carmen_scans(path: Path) -> Iterator[tuple[float, np.ndarray]]:
    """Stamp and ranges of every ROBOTLASER1 line; half a degree from -90 degrees on."""
    with gzip.open(path, "rt") as file:
        for line in file:
            words = line.split()
            if words and words[0] == "ROBOTLASER1":
                count = int(words[8])
                stamp = words[9 + count + 1 + int(words[9 + count]) + 11]
                yield float(stamp), np.array(words[9 : 9 + count], dtype=float)


@pytest.mark.dataset
def test_scans_of_a_real_building_a_metre_apart_join_without_odometry() -> None:
    reference = np.loadtxt(DATASETS / "fr079/log.tum")
    yaw = 2 * np.arctan2(reference[:, 6], reference[:, 7])
    truth = compose(np.column_stack([reference[:, 1:3], yaw]), [-0.04, 0.0, 0.0])
    scans = list(carmen_scans(DATASETS / "fr079/log.clf.gz"))
    at = np.clip(np.searchsorted(reference[:, 0], [stamp for stamp, _ in scans]), 0, len(truth) - 1)
    poses, rng = truth[at], np.random.default_rng(4)
    right: list[bool] = []
    tried = 0
    while tried < 40:
        one = rng.integers(len(scans))
        away = np.hypot(*(poses[:, :2] - poses[one, :2]).T)
        near = (away > 0.5) & (away < 1.5) & (np.abs(difference(poses[:, 2], poses[one, 2])) < 0.8)
        if not near.any():
            continue
        tried += 1
        other = rng.choice(np.nonzero(near)[0])
        outlines = []
        for k in (one, other):
            ranges = np.where(scans[k][1] < 25.0, scans[k][1], np.inf)
            outlines.append(Outline.of(ranges, np.deg2rad(np.arange(len(ranges)) * 0.5 - 90.0)))
        try:
            found = joined(*outlines).poses[1]
        except MappingError:
            continue
        expected = between(poses[one], poses[other])
        close = np.hypot(*(found - expected)[:2]) < 0.2
        right.append(close and abs(difference(found[2], expected[2])) < np.deg2rad(3.0))
    # two scans of a hallway may not show where they are: then they are not joined, rather than wrongly
    assert len(right) >= 0.75 * tried
    assert np.mean(right) > 0.95


def test_each_pair_is_compared_once_as_it_joins_and_once_at_the_end(
    furnished: GridMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared = []

    def counted(one: Submap, other: Submap, pose: np.ndarray) -> Agreement:
        compared.append({one.first, other.first})
        return compare(one, other, pose)

    monkeypatch.setattr("eigenscan.mapbuilder.mapping.composite.compare", counted)
    joined(*(scan(furnished, pose, k) for k, pose in enumerate(poses_in_the_room(0))))
    pairs = [set(pair) for pair in combinations(range(4), 2)]
    assert [compared.count(pair) for pair in pairs] == [2] * 6
    assert len(compared) == 12
