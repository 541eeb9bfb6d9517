"""Each real log against its map: at the reference poses the scans must fall on the walls.

This holds mounts, directions of beams, stamps and limits at once: any of them wrong, and it fails.
"""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.logs import LogOptions, open_log

from tests.environment import DATASETS

pytestmark = [pytest.mark.dataset, pytest.mark.slow]
Judging = Callable[[str], Any]


@pytest.mark.parametrize(
    ("dataset", "log", "reference", "every", "expected"),
    [
        ("intel", "log.clf.gz", "log.tum", 60, {"front": 0.9}),
        ("fr079", "log.clf.gz", "log.tum", 30, {"front": 0.9}),
        ("jarvis", "jarvis_complex_path_fast.bag", None, 10, {"driver_laser_navigation": 0.95}),
        ("jarvis", "jarvis_circular_path_fast.bag", None, 5, {"driver_laser_navigation": 0.9}),
        ("guardian", "guardian_3.bag", None, 20, {"scan": 0.9, "hokuyo_back_scan": 0.8}),
        ("guardian", "guardian_controller_2.bag", None, 20, {"scan": 0.95, "hokuyo_back_scan": 0.93}),
        ("olin_mac", "rosbag2", None, 8, {"scan": 0.95}),
    ],
)
def test_scans_fall_on_the_walls(
    judge: Judging, dataset: str, log: str, reference: str | None, every: int, expected: dict[str, float]
) -> None:
    judging = judge(dataset)
    at = judging.pose_at(reference or log.removesuffix(".bag") + ".tum")
    shares = judging.shares(open_log(DATASETS / dataset / log), at, every)
    assert shares.keys() == expected.keys()
    assert {name: share for name, share in shares.items() if share < expected[name]} == {}


def test_the_judge_sees_a_mount_that_is_three_degrees_off(judge: Judging) -> None:
    judging = judge("olin_mac")
    log = open_log(DATASETS / "olin_mac/rosbag2")
    right = judging.shares(log, judging.pose_at("rosbag2.tum"), 8)["scan"]
    wrong = judging.shares(log, judging.pose_at("rosbag2.tum"), 8, np.radians(3.0))["scan"]
    assert wrong < right - 0.1


def first_lines(source: Path, lines: int, target: Path) -> Path:
    with bz2.open(source, "rb") as file, bz2.open(target, "wb") as out:
        out.writelines(islice(file, lines))
    return target


def scans_of(path: Path) -> Iterator[tuple[int, RawScan]]:
    for envelope in open_log(path).envelopes():
        if envelope.channel is SCAN_RAW:
            yield envelope.stamp, envelope.open(RawScan)


def signature(scan: RawScan) -> bytes:
    """The ranges below the limit that both files keep."""
    return np.minimum(np.round(np.array(scan.ranges[:]), 2), 49.0).astype(np.float32).tobytes()


@pytest.mark.parametrize(("dataset", "lines", "mount"), [("intel", 6000, 0.0), ("fr079", 5000, -0.04)])
def test_the_original_logs_show_the_same(
    judge: Judging, tmp_path: Path, dataset: str, lines: int, mount: float
) -> None:
    """Without a reference of their own: their scans are found in the converted log by their ranges."""
    judging = judge(dataset)
    at = judging.pose_at("log.tum")
    converted = open_log(DATASETS / dataset / "log.clf.gz")
    known = {}
    for envelope in converted.envelopes():
        if envelope.channel is SCAN_RAW:
            stamp = envelope.stamp
            known[signature(envelope.open(RawScan))] = converted.logged.get(stamp, stamp)
    original = first_lines(DATASETS / dataset / f"{dataset}.clf.bz2", lines, tmp_path / "original.clf.bz2")
    shares, stamps, matched = [], [], []
    for stamp, scan in scans_of(original):
        stamps.append(stamp)
        found = known.get(signature(scan))
        if found is not None:
            matched.append((stamp, found))
            base = at(found)
            if len(matched) % 10 == 0 and base is not None:
                shares.append(judging.share(scan, base))
        assert abs(scan.mount.x - mount) < 1e-3
        assert abs(scan.mount.theta) < 1e-3
    assert np.all(np.diff(stamps) > 0)
    assert len(matched) > 0.9 * len(stamps)
    assert np.mean(shares) > 0.88
    # most stamps are as in the converted log, up to where its clock starts
    lag = np.diff(np.array(matched), axis=1)[:, 0]
    assert np.mean(np.abs(lag - np.median(lag)) < 2_000_000) > 0.85


def test_odometry_goes_with_the_scans(tmp_path: Path) -> None:
    """Interpolated at a scan, odometry moves as the reference does: the shape of the way is the same."""
    for dataset, name in (("olin_mac", "rosbag2"), ("jarvis", "jarvis_complex_path_fast")):
        log = DATASETS / dataset / (name if dataset == "olin_mac" else f"{name}.bag")
        way = []
        for envelope in open_log(log).envelopes():
            if envelope.channel is ODOMETRY:
                position = envelope.message.pose.position  # type: ignore[attr-defined]
                way.append((envelope.stamp * 1e-9, position.x, position.y))
        times, x, y = np.array(way).T
        rows = np.loadtxt(DATASETS / dataset / f"{name}.tum")
        inside = (rows[:, 0] > times[0]) & (rows[:, 0] < times[-1])
        rows = rows[inside][::10]
        steps = np.hypot(*np.diff([np.interp(rows[:, 0], times, x), np.interp(rows[:, 0], times, y)]))
        truth = np.hypot(*np.diff(rows[:, 1:3].T))
        assert truth.sum() > 2.0
        assert np.corrcoef(steps, truth)[0, 1] > 0.95
        assert abs(steps.sum() / truth.sum() - 1.0) < 0.1


def test_the_security_lidar_of_jarvis_is_there_for_the_asking() -> None:
    log = DATASETS / "jarvis/jarvis_circular_path_fast.bag"
    names = {
        envelope.address["lidar"]
        for envelope in open_log(log, LogOptions(lidars=("/driver_laser_security/laser_scan",))).envelopes()
        if envelope.channel is SCAN_RAW
    }
    assert names == {"driver_laser_security"}
    plain = open_log(log)
    assert sum(envelope.channel is SCAN_RAW for envelope in plain.envelopes()) == 204
    assert plain.counters["lidars_at_another_height"] == 1
