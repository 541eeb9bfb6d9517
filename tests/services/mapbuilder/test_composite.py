import gzip
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.circle import difference
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.pose import between, compose, transform
from eigenscan.geometry.raycast import cast
from eigenscan.mapbuilder.mapping.chain import Sweep
from eigenscan.mapbuilder.mapping.cloud import Outline
from eigenscan.mapbuilder.mapping.composite import composite
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
    ranges = cast(grid, pose[None], bearings, 30.0)[0].astype(float)
    return Outline.of(ranges + np.random.default_rng(seed).normal(0, noise, len(ranges)), bearings)


def joined(first: Outline, second: Outline) -> Registration:
    found = register(first, second)
    assert found is not None
    return found


def poses_in_the_room(seed: int, count: int = 4) -> np.ndarray:
    rng = np.random.default_rng(seed)
    places = np.array([[2.0, 2.2], [4.8, 2.4], [3.4, 4.6], [6.4, 2.0]]) + rng.uniform(-0.3, 0.3, (4, 2))
    return np.column_stack([places, rng.uniform(-np.pi, np.pi, 4)])[:count]


@pytest.mark.parametrize("seed", range(6))
def test_four_scans_of_one_office_at_unknown_poses_make_one_composite(furnished: GridMap, seed: int) -> None:
    poses = poses_in_the_room(seed)
    found = composite([scan(furnished, pose, seed + k) for k, pose in enumerate(poses)])
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
    assert np.hypot(*(found.pose - expected)[:2]) < 0.05
    assert abs(difference(found.pose[2], expected[2])) < np.deg2rad(0.7)
    assert found.score > found.runner_up


def test_the_order_of_two_scans_does_not_matter(furnished: GridMap) -> None:
    one, two = (scan(furnished, pose, k) for k, pose in enumerate(poses_in_the_room(3, 2)))
    there, back = joined(one, two), joined(two, one)
    there_and_back = compose(there.pose, back.pose)
    assert np.hypot(*there_and_back[:2]) < 0.03
    assert abs(there_and_back[2]) < np.deg2rad(0.5)


def test_a_scan_of_another_place_is_left_out(furnished: GridMap) -> None:
    elsewhere = blank(30.0, 6.0, 0.02)
    room(elsewhere, 1.0, 1.0, 28.0, 2.4)
    poses = poses_in_the_room(1, 3)
    outlines = [scan(furnished, pose, k) for k, pose in enumerate(poses)]
    outlines.insert(1, scan(elsewhere, np.array([14.0, 1.6, 0.4]), 9))
    found = composite(outlines)
    assert np.isnan(found[1]).all()
    expected = np.array([between(poses[0], pose) for pose in poses])
    assert np.abs((found[[0, 2, 3]] - expected)[:, :2]).max() < 0.04


def test_a_square_room_says_that_it_is_ambiguous() -> None:
    grid = blank(8.0, 8.0, 0.02)
    room(grid, 1.0, 1.0, 6.0, 6.0)
    one = scan(grid, np.array([2.0, 3.0, 0.3]), 1)
    two = scan(grid, np.array([4.0, 2.6, 1.1]), 2)
    found = joined(one, two)
    assert found.score - found.runner_up < 0.1


@pytest.mark.parametrize(
    "ranges", [np.full(720, np.inf), np.full(720, np.nan), np.zeros(720), np.full(720, -1.0)]
)
def test_scans_that_saw_nothing_join_nothing(furnished: GridMap, ranges: np.ndarray) -> None:
    good = scan(furnished, poses_in_the_room(0)[0], 0)
    assert register(good, Outline.of(ranges, BEARINGS)) is None
    assert np.isnan(composite([good, Outline.of(ranges, BEARINGS)])[1]).all()


def test_models_from_four_scans_alone_show_the_room(furnished: GridMap) -> None:
    poses = poses_in_the_room(2)
    outlines = [scan(furnished, pose, k) for k, pose in enumerate(poses)]
    grid = composite_map(outlines, composite(outlines))
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
        expected = cast(furnished, there, np.arange(180) * np.deg2rad(2.0), 30.0)
        assert np.median(np.abs(model.panoramas - expected)) < 0.06
        assert (np.abs(model.panoramas - expected) < 0.15).mean() > 0.85


def test_a_map_of_no_scans_is_refused(furnished: GridMap) -> None:
    one = scan(furnished, poses_in_the_room(0)[0], 0)
    with pytest.raises(ValueError, match="no scan"):
        composite_map([one], np.full((1, 3), np.nan))
    assert composite_map([one, one], np.array([[0.0, 0, 0], [np.nan] * 3])).free_area > 15


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
    sure: list[bool] = []
    while len(right) < 40:
        one = rng.integers(len(scans))
        away = np.hypot(*(poses[:, :2] - poses[one, :2]).T)
        near = (away > 0.5) & (away < 1.5) & (np.abs(difference(poses[:, 2], poses[one, 2])) < 0.8)
        if not near.any():
            continue
        other = rng.choice(np.nonzero(near)[0])
        outlines = []
        for k in (one, other):
            ranges = np.where(scans[k][1] < 25.0, scans[k][1], np.inf)
            outlines.append(Outline.of(ranges, np.deg2rad(np.arange(len(ranges)) * 0.5 - 90.0)))
        found, expected = joined(*outlines), between(poses[one], poses[other])
        close = np.hypot(*(found.pose - expected)[:2]) < 0.2
        right.append(close and abs(difference(found.pose[2], expected[2])) < np.deg2rad(3.0))
        if found.score - found.runner_up > 0.1 and found.score > 0.35:
            sure.append(right[-1])
    assert np.mean(right) > 0.8
    assert np.mean(sure) > 0.9
    assert len(sure) > 25
