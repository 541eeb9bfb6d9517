"""Several robots, boxes that the map lacks, lidars by name."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap, read_map
from eigenscan.geometry.pose import transform
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import SCAN_RAW, TRUTH
from eigenscan.workbench.simulation.lidar import LIDARS
from eigenscan.workbench.simulation.people import RADIUS
from eigenscan.workbench.simulation.stage import Fleet, Scenario, Stage
from eigenscan.workbench.simulation.world import office, put_boxes
from scipy.ndimage import label

from tests.command import eigenscan


@pytest.fixture(scope="module")
def grid() -> GridMap:
    return office().render()


def _simulate(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    return eigenscan("simulate", *arguments, cwd=folder)


def test_a_fleet_is_one_recording_with_a_truth_for_each(tmp_path: Path) -> None:
    done = _simulate(
        tmp_path, "-o", "f.mcap", "--truth", "f.tum", "--robots", 3, "--robot", "r", "--seconds", 2
    )
    assert done.returncode == 0, done.stderr
    records = list(read(tmp_path / "f.mcap"))
    assert [r.log_time for r in records] == sorted(r.log_time for r in records)
    for name in ("r1", "r2", "r3"):
        own = [r.envelope for r in records if r.envelope.address["robot"] == name]
        assert sum(e.channel is SCAN_RAW for e in own) == sum(e.channel is TRUTH for e in own) == 20
        assert len((tmp_path / f"f-{name}.tum").read_text().splitlines()) == 20


def test_robots_see_each_other_among_the_same_people(grid: GridMap) -> None:
    fleet = Fleet(grid, Scenario(seconds=2.0, people=2), 3)
    first, second, third = fleet.stages
    time = int(first.times[50])
    for stage, others in ((first, (second, third)), (third, (first, second))):
        seen = stage.people_at(time)
        assert len(seen) == 4
        assert np.array_equal(seen[2:], [other.pose_at(time)[:2] for other in others])
    assert not np.allclose(first.poses[:100], second.poses[:100])
    alone = Stage(grid, Scenario(seconds=2.0, people=2))
    assert np.array_equal(first.poses, alone.poses)
    assert np.array_equal(first.odometry, alone.odometry)


def test_a_robot_in_the_way_is_in_the_scan(grid: GridMap) -> None:
    """Another robot 0.8 m ahead cuts the beams short at its rim."""
    fleet = Fleet(grid, Scenario(seconds=1.0, people=0, start=(3.0, 6.5)), 2)
    first, second = fleet.stages
    second.poses[:] = np.append(transform(first.poses[1], (0.8, 0.0)), 0.0)
    scans = [t.envelope for t in first.messages() if t.envelope.channel is SCAN_RAW]
    ranges = np.array(scans[0].message.ranges)  # type: ignore[attr-defined]
    ahead = ranges[len(ranges) // 2 - 3 : len(ranges) // 2 + 4]
    expected = 0.8 - first.scenario.lidar.mount[0] - RADIUS
    assert np.nanmedian(ahead) == pytest.approx(expected, abs=0.05)


def test_boxes_are_in_the_building_and_not_in_the_map(tmp_path: Path, grid: GridMap) -> None:
    done = _simulate(tmp_path, "-o", "b.mcap", "--save-map", "map.yaml", "--boxes", 6, "--seconds", 1)
    assert done.returncode == 0, done.stderr
    assert np.array_equal(read_map(tmp_path / "map.yaml").cells, grid.cells)
    real = put_boxes(grid, 6, np.random.default_rng([1, 6]))
    added = (real.cells == OCCUPIED) & (grid.cells != OCCUPIED)
    assert label(added)[1] == 6
    # what was free hangs together as before
    assert label(real.cells == FREE)[1] == label(grid.cells == FREE)[1]


def test_too_many_boxes_are_refused(tmp_path: Path) -> None:
    done = _simulate(tmp_path, "-o", "b.mcap", "--boxes", 5000)
    assert done.returncode == 2
    assert "ask for fewer" in done.stderr


def test_drift_scales_the_noise_of_odometry(tmp_path: Path) -> None:
    assert _simulate(tmp_path, "-o", "d.mcap", "--drift", 0, "--seconds", 2).returncode == 0
    records = [r.envelope for r in read(tmp_path / "d.mcap")]
    stage = Stage(office().render(), Scenario(seconds=2.0))
    odometry = [e for e in records if e.channel.name == "odometry"]
    travelled = stage.poses[(len(odometry) - 1) * 2, :2] - stage.poses[0, :2]
    end = odometry[-1].message.pose.position  # type: ignore[attr-defined]
    assert np.hypot(end.x, end.y) == pytest.approx(np.hypot(*travelled), abs=1e-9)


@pytest.mark.parametrize("name", LIDARS)
def test_every_lidar_measures_as_it_states(grid: GridMap, name: str) -> None:
    lidar = LIDARS[name]
    stage = Stage(grid, Scenario(seconds=1.0, lidar=lidar))
    scans = [t.envelope for t in stage.messages() if t.envelope.channel is SCAN_RAW]
    assert len(scans) == pytest.approx(lidar.rate, abs=1)
    ranges = np.array(scans[0].message.ranges)  # type: ignore[attr-defined]
    assert len(ranges) == lidar.beams
    finite = ranges[np.isfinite(ranges)]
    assert finite.min() >= lidar.range_min - 1e-6
    assert finite.max() <= lidar.range_max + 1e-6
    assert lidar.fov + lidar.angle_increment <= 2 * np.pi + 1e-9


def test_a_lidar_that_is_none_names_those_that_are(tmp_path: Path) -> None:
    done = _simulate(tmp_path, "-o", "a.mcap", "--lidar", "sonar")
    assert done.returncode == 2
    assert "rplidar-a2" in done.stderr
