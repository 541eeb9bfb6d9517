"""`eigenscan map`: on a part of a real log, and on logs that no map can be made of."""

import gzip
import json
import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.gridmap import FREE, OCCUPIED, read_map
from eigenscan.geometry.pose import between
from eigenscan.workbench.evaluation.reference import read_trajectory

from tests.command import eigenscan
from tests.environment import DATASETS

pytestmark = pytest.mark.slow


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return eigenscan("map", *arguments)


def robotlaser(ranges: np.ndarray, second: int, x: float = 0.0) -> str:
    """One CARMEN line, beams of a degree from -90 degrees on."""
    numbers = " ".join(f"{value:.3f}" for value in ranges)
    pose = f"{x} 0 0"
    return (
        f"ROBOTLASER1 0 -1.570796327 3.124139447 0.017453293 49.0 0.01 0 {len(ranges)} {numbers} 0 "
        f"{pose} {pose} 0 0 0 0 0 {second} robot 0"
    )


def write(path: Path, lines: Iterable[str]) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.dataset
@pytest.mark.parametrize("odometry", [True, False])
def test_a_part_of_a_real_log_becomes_a_map_and_a_trajectory(tmp_path: Path, odometry: bool) -> None:
    with gzip.open(DATASETS / "fr079/log.clf.gz", "rt") as file:
        lines = [line.rstrip() for line in file][:900]
    out = tmp_path / "part.yaml"
    flags = [] if odometry else ["--no-odometry"]
    done = run(write(tmp_path / "part.clf", lines), "-o", out, *flags)
    assert done.returncode == 0, done.stderr
    assert "in the map" in done.stdout
    assert (tmp_path / "part.png").read_bytes().startswith(b"\x89PNG")

    found, truth = read_trajectory(out.with_suffix(".tum")), read_trajectory(DATASETS / "fr079/log.tum")
    reference, known = truth.at(found.stamps)
    assert len(found.stamps) > 880
    # relative poses over 30 s, which need no alignment
    pairs = np.arange(0, len(found.stamps) - 140, 5)
    pairs = pairs[known[pairs] & known[pairs + 140]]
    step = between(
        between(reference[pairs], reference[pairs + 140]),
        between(found.poses[pairs], found.poses[pairs + 140]),
    )
    assert np.hypot(step[:, 0], step[:, 1]).mean() < 0.15
    assert np.rad2deg(np.abs(step[:, 2])).mean() < 1.5
    grid = read_map(out)
    assert grid.free_area > 50
    assert (grid.cells == OCCUPIED).any()
    assert (grid.at(found.poses[:, :2]) == FREE).mean() > 0.99


@pytest.mark.dataset
def test_a_few_scans_of_a_drive_are_joined_without_odometry(tmp_path: Path) -> None:
    with gzip.open(DATASETS / "fr079/log.clf.gz", "rt") as file:
        lines = [line.rstrip() for line in file if line.startswith("ROBOTLASER1")][:160]
    out = tmp_path / "few.yaml"
    done = run(write(tmp_path / "few.clf", lines), "-o", out, "--composite", "8", "--no-odometry")
    assert done.returncode == 0, done.stderr
    found, truth = read_trajectory(out.with_suffix(".tum")), read_trajectory(DATASETS / "fr079/log.tum")
    reference, known = truth.at(found.stamps)
    assert known.sum() >= 4
    step = between(between(reference[0], reference[known]), between(found.poses[0], found.poses[known]))
    assert np.hypot(step[:, 0], step[:, 1]).max() < 0.2
    assert read_map(out).free_area > 10


@pytest.mark.parametrize("seed", ["1", "3"])
def test_scans_whose_walls_fit_elsewhere_too_are_left_out_of_a_composite(tmp_path: Path, seed: str) -> None:
    """Of 12 scans of rooms of equal corners, all were joined, five of them turned or metres off."""
    log, out = tmp_path / "drive.mcap", tmp_path / "few.yaml"
    true = tmp_path / "drive.tum"
    eigenscan("simulate", "--seconds", "20", "--seed", seed, "-o", log, "--truth", true)
    done = run(log, "-o", out, "--composite", "12")
    assert done.returncode == 0, done.stderr
    assert "not joined to the rest: the scan at" in done.stderr
    assert "pairs of scans fit otherwise, as in rooms alike: check" in done.stderr
    found = read_trajectory(out.with_suffix(".tum"))
    reference, known = read_trajectory(true).at(found.stamps)
    assert known.sum() >= 3
    step = between(between(reference[0], reference[known]), between(found.poses[0], found.poses[known]))
    assert np.hypot(step[:, 0], step[:, 1]).max() < 0.2
    assert np.abs(step[:, 2]).max() < 0.1


def test_a_log_whose_beams_all_came_back_empty_is_refused_by_name(tmp_path: Path) -> None:
    log = write(tmp_path / "blind.clf", [robotlaser(np.full(180, 81.0), k) for k in range(1, 20)])
    done = run(log, "-o", tmp_path / "map.yaml")
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()[-1:]) == 1
    assert "blind.clf" in done.stderr
    assert "0 of 19 scans show walls" in done.stderr
    assert not (tmp_path / "map.yaml").exists()


def test_what_the_reader_counted_is_reported_as_by_import(tmp_path: Path) -> None:
    log = write(tmp_path / "a.clf", [robotlaser(np.full(180, 81.0), k) for k in (1, 2, 9, 4, 5)])
    assert "stamps repaired: 1 (by the order of the lines)" in run(log, "-o", tmp_path / "a.yaml").stderr


def test_one_scan_is_no_map(tmp_path: Path) -> None:
    log = write(tmp_path / "one.clf", [robotlaser(np.linspace(2.0, 3.0, 180), 1)])
    done = run(log, "-o", tmp_path / "map.yaml")
    assert done.returncode == 2
    assert "1 of 1 scans show walls" in done.stderr
    assert "two or more" in done.stderr


def test_scans_without_a_single_range_are_refused(tmp_path: Path) -> None:
    log = write(tmp_path / "nan.clf", [robotlaser(np.full(180, np.nan), k) for k in range(1, 5)])
    done = run(log, "-o", tmp_path / "map.yaml")
    assert done.returncode == 2
    assert "nan.clf" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_log_that_is_not_there_and_a_name_that_is_no_yaml(tmp_path: Path) -> None:
    done = run(tmp_path / "none.bag")
    assert done.returncode == 2
    assert "none.bag" in done.stderr
    log = write(tmp_path / "one.clf", [robotlaser(np.linspace(2.0, 3.0, 180), 1)])
    done = run(log, "-o", tmp_path / "map.pgm")
    assert done.returncode == 2
    assert "name a .yaml file" in done.stderr


def test_a_place_that_cannot_be_written_is_named_before_the_log_is_read(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = run(tmp_path / "none.clf", "-o", tmp_path / "file/part.yaml")
    assert done.returncode == 2
    assert "none.clf" not in done.stderr
    assert str(tmp_path / "file") in done.stderr


@pytest.mark.dataset
def test_a_drive_improves_a_given_map_and_keeps_its_frame(tmp_path: Path) -> None:
    with gzip.open(DATASETS / "fr079/log.clf.gz", "rt") as file:
        lines = [line.rstrip() for line in file][:700]
    given, out, figures = DATASETS / "fr079/map.yaml", tmp_path / "better.yaml", tmp_path / "figures.json"
    log = write(tmp_path / "part.clf", lines)
    done = run(log, "--on", given, "-o", out, "--json", figures)
    assert done.returncode == 0, done.stderr
    assert "on the given map" in done.stdout
    shown = json.loads(figures.read_text())
    assert shown["scans_located"] > 0.8 * shown["scans_heard"]
    found, truth = read_trajectory(out.with_suffix(".tum")), read_trajectory(DATASETS / "fr079/log.tum")
    reference, known = truth.at(found.stamps)
    step = between(reference[known], found.poses[known])
    assert np.hypot(step[:, 0], step[:, 1]).max() < 0.3
    # what the drive did not see is as it was
    before, after = read_map(given), read_map(out)
    assert after.free_area > 0.95 * before.free_area


def test_a_given_map_that_cannot_be_improved_is_refused(tmp_path: Path) -> None:
    log = write(tmp_path / "one.clf", [robotlaser(np.linspace(2.0, 3.0, 180), k) for k in range(1, 9)])
    done = run(log, "--on", tmp_path / "map.yaml", "-o", tmp_path / "map.yaml")
    assert done.returncode == 2
    assert "name another file" in done.stderr
    done = run(log, "--on", tmp_path / "map.yaml", "-o", tmp_path / "out.yaml", "--composite", "4")
    assert done.returncode == 2
    assert "--composite" in done.stderr
    done = run(log, "--on", tmp_path / "none.yaml", "-o", tmp_path / "out.yaml")
    assert done.returncode == 2
    assert "none.yaml" in done.stderr
    assert "Traceback" not in done.stderr
