"""The simulated world: repeatable, and true to geometry and to its own noise model."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap, MapError, read_map, write_map
from eigenscan.geometry.pose import between, compose, from_pose3, inverse
from eigenscan.geometry.raycast import RayCaster
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW, TRUTH
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.simulation.lidar import Lidar, to_discs
from eigenscan.workbench.simulation.people import PERSONAL_SPACE, RADIUS, draw_walkers, positions
from eigenscan.workbench.simulation.robot import OdometryNoise, odometry
from eigenscan.workbench.simulation.route import plan
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import Box, Disc, FloorPlan, office
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from tests.environment import DATASETS

pytestmark = pytest.mark.slow

SIMULATE = [sys.executable, "-m", "eigenscan.cli.main", "simulate"]
SQUARE = FloorPlan(rooms={"square": Box(0.0, 0.0, 6.0, 6.0)}, doors=(), furniture=(Disc(2.0, 3.0, 0.25),))


@pytest.fixture(scope="module")
def grid() -> GridMap:
    return office().render()


@pytest.fixture(scope="module")
def stage(grid: GridMap) -> Stage:
    return Stage(grid, Scenario(seconds=40.0, kidnap=20.0, seed=3))


def _simulate(*arguments: object) -> None:
    subprocess.run([*SIMULATE, *map(str, arguments)], check=True, timeout=600)


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in "ab":
        _simulate("-o", tmp_path / f"{name}.mcap", "--truth", tmp_path / f"{name}.tum",
                  "--seconds", 8, "--kidnap", 4, "--seed", 5)  # fmt: skip
    for kind in ("mcap", "tum"):
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()


def test_another_seed_gives_another_drive_and_more_people_the_same(grid: GridMap) -> None:
    first = Stage(grid, Scenario(seconds=5.0, seed=5))
    assert not np.allclose(Stage(grid, Scenario(seconds=5.0, seed=6)).poses, first.poses)
    crowd = Stage(grid, Scenario(seconds=5.0, seed=5, people=20))
    np.testing.assert_array_equal(crowd.poses, first.poses)
    np.testing.assert_array_equal(crowd.odometry, first.odometry)


def test_the_recording_holds_what_the_truth_file_states(tmp_path: Path) -> None:
    _simulate("-o", tmp_path / "r.mcap", "--truth", tmp_path / "r.tum", "--save-map", tmp_path / "m.yaml",
              "--seconds", 5, "--rate", 7, "--beams", 90, "--fov", 360)  # fmt: skip
    truth = np.loadtxt(tmp_path / "r.tum")
    records = [record.envelope for record in read(tmp_path / "r.mcap")]
    published = [record.open(PoseInFrame) for record in records if record.channel is TRUTH]
    scans = [record.open(RawScan) for record in records if record.channel is SCAN_RAW]
    assert len(scans) == len(published) == len(truth) == 35
    np.testing.assert_allclose([nanoseconds(scan.timestamp) * 1e-9 for scan in scans], truth[:, 0])
    headings = 2 * np.arctan2(truth[:, 6], truth[:, 7])
    expected = compose(np.zeros(3), np.column_stack([truth[:, 1:3], headings]))
    np.testing.assert_allclose([from_pose3(pose.pose) for pose in published], expected, atol=2e-6)
    assert len(scans[0].ranges) == 90
    assert scans[0].angle_increment * 90 == pytest.approx(2 * np.pi)
    assert read_map(tmp_path / "m.yaml").version == office().render().version


def test_messages_come_in_order_and_scans_never_on_an_odometry_stamp(stage: Stage) -> None:
    times: dict[str, list[int]] = {}
    last = 0
    for timed in stage.messages():
        assert timed.time >= last
        last = timed.time
        times.setdefault(timed.envelope.channel.name, []).append(timed.time)
    assert times[TRUTH.name] == times[SCAN_RAW.name]
    assert not set(times[ODOMETRY.name]) & set(times[SCAN_RAW.name])
    assert len(times[SCAN_RAW.name]) == 400
    assert len(times[ODOMETRY.name]) == 2000


def test_the_robot_drives_and_never_touches_a_wall(grid: GridMap) -> None:
    clearance = distance_transform_edt(grid.cells != OCCUPIED) * grid.resolution
    for seed in range(4):
        poses = Stage(grid, Scenario(seconds=120.0, seed=seed, people=0)).poses
        column, row = np.floor(grid.to_grid(poses[:, :2])).astype(int).T
        assert np.all(grid.cells[row, column] == FREE)
        assert clearance[row, column].min() > 0.2
        steps = between(poses[:-1], poses[1:])
        assert np.hypot(steps[:, 0], steps[:, 1]).max() <= 0.5 * 0.01 + 1e-9
        assert np.abs(steps[:, 2]).max() <= 1.0 * 0.01 + 1e-9
        assert np.hypot(steps[:, 0], steps[:, 1]).sum() > 30.0


def test_rooms_are_all_reachable_and_differ(grid: GridMap) -> None:
    planner = plan(grid, 0.25)
    for name, room in office().rooms.items():
        inside = room.grown(-0.3)
        points = planner.points(np.argwhere(planner.cost > 0))
        assert np.any(inside.covers(points[:, 0], points[:, 1])), name
    assert 200 < grid.free_area < 400


def test_kidnap_is_in_the_truth_and_not_in_the_odometry(stage: Stage) -> None:
    jump = int(stage.jumps[0])
    true_step = between(stage.poses[jump - 1], stage.poses[jump])
    assert np.hypot(*true_step[:2]) >= 5.0
    odometry_steps = between(stage.odometry[:-1], stage.odometry[1:])
    assert np.abs(odometry_steps[jump - 1]).max() < 1e-12
    assert np.hypot(*odometry_steps[:, :2].T).max() < 0.03
    assert stage.kidnap_time == stage.times[0] + 20 * 10**9


def test_without_noise_odometry_is_the_drive(stage: Stage) -> None:
    still = OdometryNoise(distance=0.0, heading_travel=0.0, heading_turn=0.0, scale=0.0)
    poses = stage.poses[: int(stage.jumps[0])]
    published = odometry(poses, np.empty(0, dtype=np.int64), still, np.random.default_rng(0))
    np.testing.assert_allclose(published, compose(inverse(poses[0]), poses), atol=1e-9)


@pytest.mark.parametrize("ticks", [400, 4000])
def test_odometry_variance_grows_with_the_way_and_not_with_the_rate(ticks: int) -> None:
    metres, radians = 10.0, 2.0
    headings = np.linspace(0.0, radians, ticks + 1)
    step = metres / ticks
    x = np.concatenate([[0.0], np.cumsum(step * np.cos(headings[:-1]))])
    y = np.concatenate([[0.0], np.cumsum(step * np.sin(headings[:-1]))])
    poses = compose(np.zeros(3), np.column_stack([x, y, headings]))
    noise = OdometryNoise(distance=0.05, heading_travel=0.02, heading_turn=0.04, scale=0.0)
    random = np.random.default_rng(1)
    ways, turns = [], []
    for _ in range(600):
        steps = odometry(poses, np.empty(0, dtype=np.int64), noise, random)
        local = between(steps[:-1], steps[1:])
        ways.append(local[:, 0].sum() - metres)
        turns.append(local[:, 2].sum() - radians)
    # 600 draws: the variance's relative standard deviation is sqrt(2 / 599) = 5.8 %
    assert np.var(ways) == pytest.approx(0.05**2 * metres, rel=0.25)
    assert np.var(turns) == pytest.approx(0.02**2 * metres + 0.04**2 * radians, rel=0.25)
    assert abs(np.mean(turns)) < 4 * np.std(turns) / np.sqrt(600)


def test_lidar_against_walls_worked_out_by_hand() -> None:
    perfect = Lidar(beams=181, noise=0.0, missing=0.0, mount=(0.0, 0.0, 0.0))
    base = np.array([4.0, 4.5, 0.3])
    ranges = perfect.measure(
        RayCaster.of(SQUARE.render(0.01)), base, np.empty((0, 2)), np.random.default_rng(0)
    )
    expected = [_to_square(base, bearing) for bearing in perfect.bearings]
    # cells of 1 cm: a grazing beam may meet the pillar one cell earlier or later
    assert np.mean(np.abs(ranges - expected) < 0.03) > 0.97
    assert np.quantile(np.abs(ranges - expected), 0.5) < 0.01


def _to_square(base: np.ndarray, bearing: float) -> float:
    """Slowly, along the beam: the first point in a wall or in the pillar."""
    angle = base[2] + bearing
    along = np.arange(0.0, 12.0, 0.002)
    x, y = base[0] + along * np.cos(angle), base[1] + along * np.sin(angle)
    wall = (np.minimum(x, y) <= 0.05) | (np.maximum(x, y) >= 5.95)
    pillar = np.hypot(x - 2.0, y - 3.0) <= 0.25
    return float(along[np.argmax(wall | pillar)])


@settings(max_examples=60, deadline=None)
@given(
    st.floats(-3.0, 3.0),
    st.floats(-3.0, 3.0),
    st.floats(-4.0, 4.0),
    st.integers(0, 2**32 - 1),
    st.integers(0, 5),
)
def test_beams_end_on_the_nearest_disc(x: float, y: float, theta: float, seed: int, count: int) -> None:
    centres = np.random.default_rng(seed).uniform(-4.0, 4.0, (count, 2))
    bearings = np.linspace(-np.pi, np.pi, 73)
    found = to_discs(np.array([x, y, theta]), bearings, centres, RADIUS)
    along = np.arange(0.0, 14.0, 0.004)
    for bearing, distance in zip(bearings, found, strict=True):
        px, py = x + along * np.cos(theta + bearing), y + along * np.sin(theta + bearing)
        gaps = [np.hypot(px - cx, py - cy) for cx, cy in centres if np.hypot(x - cx, y - cy) > RADIUS]
        if np.isinf(distance):
            # sampled points may not find a disc that was not found: 0.4 mm covers the grazing chord
            assert all(gap.min() > RADIUS - 4e-4 for gap in gaps)
        else:
            end = np.array([x + distance * np.cos(theta + bearing), y + distance * np.sin(theta + bearing)])
            assert np.abs(np.hypot(*(end - centres).T) - RADIUS).min() < 1e-6
            assert all(gap[along < distance - 0.004].min(initial=np.inf) >= RADIUS - 1e-9 for gap in gaps)


def test_people_hide_walls_and_keep_out_of_the_robots_way(grid: GridMap) -> None:
    walls = RayCaster.of(grid)
    lidar = Lidar(noise=0.0, missing=0.0)
    base = np.array([10.0, 6.5, 0.0])
    alone = lidar.measure(walls, base, np.empty((0, 2)), np.random.default_rng(0))
    among = lidar.measure(walls, base, np.array([[12.0, 6.5]]), np.random.default_rng(0))
    hidden = among < alone
    assert 0 < hidden.sum() < 40
    assert among[180] == pytest.approx(12.0 - RADIUS - 10.1, abs=1e-9)
    np.testing.assert_array_equal(among[~hidden], alone[~hidden])
    walkers = draw_walkers(plan(grid, 0.25), 4, np.random.default_rng(2))
    for time in np.arange(0.0, 60.0, 0.5):
        here = walkers[0].at(time) + np.array([0.1, 0.0])
        places = positions(walkers, time, here)
        assert np.hypot(*(places - here).T).min() >= PERSONAL_SPACE - 1e-9
    # they walk: nobody is where he was
    assert all(np.hypot(*(walker.at(0.0) - walker.at(1.0))) > 0.3 for walker in walkers)


def test_range_noise_and_missing_beams_have_the_declared_size(grid: GridMap) -> None:
    walls, base = RayCaster.of(grid), np.array([10.0, 6.5, 1.0])
    exact = Lidar(noise=0.0, missing=0.0).measure(walls, base, np.empty((0, 2)), np.random.default_rng(0))
    noisy = Lidar(noise=0.03, missing=0.05)
    random = np.random.default_rng(4)
    scans = np.stack([noisy.measure(walls, base, np.empty((0, 2)), random) for _ in range(200)])
    assert np.isnan(scans).mean() == pytest.approx(0.05, abs=0.005)
    assert np.nanstd(scans - exact) == pytest.approx(0.03, rel=0.03)


def test_a_lidar_that_sweeps_sees_from_where_the_robot_is_by_then(grid: GridMap) -> None:
    lidar = Lidar(noise=0.0, missing=0.0, sweep=0.1)
    stage = Stage(grid, Scenario(seconds=10.0, people=0, seed=4, lidar=lidar))
    walls, still, nobody = RayCaster.of(grid), replace(lidar, sweep=0.0), np.empty((0, 2))
    off = []
    for timed in stage.messages():
        if timed.envelope.channel is SCAN_RAW:
            raw = timed.envelope.open(RawScan)
            assert raw.time_increment == pytest.approx(0.1 / 360)
            for beam, later in ((0, 0), (180, 50_000_000), (360, 100_000_000)):
                base = stage.pose_at(timed.time + later)
                seen = still.measure(walls, base, nobody, np.random.default_rng(0))
                off.append(abs(raw.ranges[beam] - seen[beam]))
    # stored in single precision; at the end of a wall a beam may pass
    assert np.quantile(off, 0.95) < 1e-5


def test_beyond_the_reach_a_beam_comes_back_empty(grid: GridMap) -> None:
    short = Lidar(range_max=3.0, noise=0.0, missing=0.0)
    base = np.array([10.0, 6.5, 0.0])
    ranges = short.measure(RayCaster.of(grid), base, np.empty((0, 2)), np.random.default_rng(0))
    assert np.isinf(ranges[180])
    assert np.all(np.isinf(ranges) | (ranges <= 3.0))


def test_any_ros_map_will_do(tmp_path: Path) -> None:
    grid = read_map(DATASETS / "fr079/map.yaml")
    stage = Stage(grid, Scenario(seconds=20.0, kidnap=10.0))
    assert np.all(grid.at(stage.poses[:, :2]) == FREE)


def test_a_map_that_the_robot_does_not_fit_in_is_an_error() -> None:
    closet = FloorPlan(rooms={"closet": Box(0.0, 0.0, 0.4, 0.4)}, doors=(), furniture=())
    with pytest.raises(MapError, match="fits nowhere"):
        Stage(closet.render(), Scenario(seconds=1.0))


def test_a_written_map_reads_back_the_same(tmp_path: Path, grid: GridMap) -> None:
    write_map(grid, tmp_path / "office.yaml")
    np.testing.assert_array_equal(read_map(tmp_path / "office.yaml").cells, grid.cells)
