"""Two floors in one set: a robot is found on the right one, also after a lift."""

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from eigenscan.eigenspace.folder import read_models
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.gridmap import FREE, GridMap, MapError, write_map
from eigenscan.geometry.pose import compose
from eigenscan.geometry.raycast import RayCaster
from eigenscan.localize import Localizer, Scan
from eigenscan.mapbuilder.floors import stack
from numpy.typing import NDArray

from tests.command import eigenscan
from tests.services.projector.office import free_poses, office

pytestmark = pytest.mark.slow

STEP, BEAMS = np.deg2rad(1.0), 271


def upstairs() -> GridMap:
    """The ground floor mirrored, with a wall less, in a map that is turned and lies elsewhere."""
    cells = office().cells[:, ::-1].copy()
    cells[12:88, 215:226] = FREE
    return replace(office(), cells=cells, origin=np.array([40.0, -7.0, 0.6]))


FLOORS = {"ground": office(), "first": upstairs()}


def build(folder: Path, *files: str) -> subprocess.CompletedProcess[str]:
    return eigenscan("build", *files, "-o", "model", cwd=folder)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("floors")
    for name, grid in FLOORS.items():
        write_map(grid, folder / f"{name}.yaml")
    done = build(folder, "ground.yaml", "first.yaml")
    assert done.returncode == 0, done.stderr
    assert "ground, first" in done.stdout
    return folder / "model"


@pytest.fixture(scope="module")
def localizer(model: Path) -> Localizer:
    return Localizer.from_map(model)


def seen(floor: str, pose: NDArray[np.float64], time: float = 0.0) -> Scan:
    """What a lidar of 270 degrees sees on a floor, by that floor's own map."""
    angle_min = -0.5 * STEP * (BEAMS - 1)
    ranges = RayCaster.of(FLOORS[floor]).cast(pose, angle_min + np.arange(BEAMS) * STEP, 30.0)[0]
    return Scan(ranges, angle_min, STEP, 30.0, time=time)


def off(found: NDArray[np.float64], truth: NDArray[np.float64]) -> tuple[float, float]:
    return float(np.hypot(*(found - truth)[:2])), float(abs(wrap(found[2] - truth[2])))


@pytest.mark.parametrize("floor", FLOORS)
def test_a_scan_is_found_on_its_floor_in_that_floors_own_frame(localizer: Localizer, floor: str) -> None:
    truths = free_poses(20, 5, FLOORS[floor])
    right = 0
    for truth in truths:
        on = localizer.floor(localizer.localize(seen(floor, truth)).poses[0])
        assert on is not None
        right += on[0] == floor and off(on[1], truth) < (0.3, 0.1)
    assert right >= 18


def test_after_a_lift_the_robot_is_on_the_other_floor(localizer: Localizer) -> None:
    localizer.forget()
    start, drive, time = np.array([-1.0, 7.4, 0.0]), np.zeros(3), 0.0
    where = []
    for floor in ("ground", "first"):
        begin = start if floor == "ground" else compose(FLOORS["first"].origin, [12.0, 5.4, np.pi])
        for step in range(45):
            truth = compose(begin, [0.1 * step, 0.0, 0.0])
            time, drive = time + 0.2, compose(drive, [0.1 if step else 0.0, 0.0, 0.0])
            estimate = localizer.track(seen(floor, truth, time), drive)
        where.append((localizer.floor(estimate.pose), truth, estimate.state))
    for expected, (found, truth, state) in zip(FLOORS, where, strict=True):
        assert state == "localized"
        assert found is not None
        assert found[0] == expected
        assert off(found[1], truth) < (0.2, 0.1)


def test_the_floors_are_one_set_with_every_region_on_one_of_them(model: Path) -> None:
    site = read_models(model)
    assert [floor.name for floor in site.floors] == ["ground", "first"]
    assert list(site.to_message().floors) == [floor.to_message() for floor in site.floors]
    np.testing.assert_allclose(site.floors[0].origin, 0.0, atol=1e-12)
    names = {region.region.partition(".")[0] for region in site.regions}
    assert names == {"ground", "first"}
    for region in site.regions:
        (home,) = [floor for floor in site.floors if floor.name == region.region.partition(".")[0]]
        poses = np.column_stack([region.positions, np.zeros(len(region.positions))])
        assert all(home.holds(pose) for pose in poses)
        assert (FLOORS[home.name].at(home.own(poses)[:, :2]) == FREE).all()


@pytest.mark.parametrize(
    ("name", "grid", "stated"),
    [
        ("coarse", replace(office(), resolution=0.1), "coarse: resolution = 0.1, that of ground is 0.05"),
        ("ground", office(), "ground: two floors have this name"),
        ("a b", office(), "a b: cannot be a floor's name"),
    ],
)
def test_floors_that_do_not_fit_are_named(name: str, grid: GridMap, stated: str) -> None:
    with pytest.raises(MapError, match=stated):
        stack([("ground", office()), (name, grid)])


def test_a_user_reads_it_in_one_line(tmp_path: Path) -> None:
    write_map(office(), tmp_path / "ground.yaml")
    write_map(office(), tmp_path / "other" / "ground.yaml")
    done = build(tmp_path, "ground.yaml", "other/ground.yaml")
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert line == "eigenscan build: ground: two floors have this name: rename a file"
    assert not (tmp_path / "model").exists()
