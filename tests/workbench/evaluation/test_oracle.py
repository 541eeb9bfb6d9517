"""Scans of a room decide where the robot is only where no other room looks like it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pytest
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.pose import to_message
from eigenscan.geometry.raycast import RayCaster
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.workbench.evaluation.doubt import Walls
from eigenscan.workbench.evaluation.oracle import decides, soon_after
from eigenscan.workbench.evaluation.pipeline import Answer
from eigenscan.workbench.evaluation.reference import NS, Trajectory
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

BEAMS = 180
PERIOD = NS // 10
ALIKE = np.array([10.0, 0.0, 0.0])
WAY = np.array([[2.0 + 0.1 * k, 2.0, 0.05 * k] for k in range(10)])
"""Where the robot is at each scan, in the left room."""


def rooms(pillar: bool) -> GridMap:
    """Two rooms of 8 m x 6 m, 10 m apart; with a pillar in the left one they differ."""
    cells = np.full((80, 200), OCCUPIED, dtype=np.uint8)
    for left in (10, 110):
        cells[10:70, left : left + 80] = FREE
    if pillar:
        cells[30:40, 50:60] = OCCUPIED
    return GridMap(cells, 0.1, np.zeros(3))


def raw(at: int) -> Envelope:
    return Envelope(SCAN_RAW, {"site": "s", "robot": "r", "lidar": "l"}, RawScan(timestamp=stamp(at)))


def judged(grid: GridMap, listed: np.ndarray, returns: bool = True) -> bool | None:
    """Whether the scans along WAY decide; each is answered by its true pose and those `listed` (k, 3) off."""
    caster, angles = RayCaster.of(grid), np.arange(BEAMS) * 2 * np.pi / BEAMS
    stamps = np.arange(len(WAY)) * PERIOD
    pose_at = dict(zip(stamps.tolist(), WAY, strict=True))

    def canonical(scan: Envelope) -> Scan:
        ranges = caster.cast(pose_at[scan.stamp], angles, 30.0).ravel() if returns else np.full(BEAMS, 30.0)
        return Scan(
            ranges=ranges.tolist(),
            angle_increment=2 * np.pi / BEAMS,
            range_max=30.0,
            mount=to_message((0.0, 0.0, 0.0)),
        )

    def answers(scans: Iterable[Envelope]) -> Iterator[Answer]:
        for scan in scans:
            poses = pose_at[scan.stamp] + listed
            yield Answer(poses, np.tile(np.eye(3), (len(poses), 1, 1)), np.zeros(len(poses)), 0.0)

    walls = Walls(DistanceField.of(grid), canonical)
    return decides([raw(at) for at in stamps.tolist()], answers, Trajectory(stamps, WAY), walls)


def test_scans_decide_between_rooms_that_differ_and_not_between_rooms_that_are_alike() -> None:
    both = np.stack([np.zeros(3), ALIKE])
    assert judged(rooms(pillar=True), both) is True
    assert judged(rooms(pillar=False), both) is False


def test_a_place_that_no_scan_lists_counts_as_the_true_one_only() -> None:
    assert judged(rooms(pillar=False), np.empty((0, 3))) is True


def test_a_pose_that_is_nearly_right_is_no_other_place() -> None:
    # 0.7 m off is not right, and the scans may fit there as well
    assert judged(rooms(pillar=True), np.array([[0.7, 0.0, 0.0]])) is True


def test_scans_without_returns_decide_nothing() -> None:
    assert judged(rooms(pillar=True), np.zeros((1, 3)), returns=False) is None


@pytest.mark.parametrize("count", [8, 200])
def test_scans_are_chosen_evenly_from_the_three_seconds_after_the_jump(count: int) -> None:
    received = [raw(NS + k * 10 * NS // count) for k in range(count)]
    received.append(Envelope(ODOMETRY, {"site": "s", "robot": "r"}, Odometry(timestamp=stamp(NS))))
    chosen = [scan.stamp for scan in soon_after(received, NS)]
    within = [e.stamp for e in received[:-1] if e.stamp <= 4 * NS]
    assert len(chosen) == min(len(within), 15)
    assert (chosen[0], chosen[-1]) == (within[0], within[-1])
    assert np.diff(chosen).max() - np.diff(chosen).min() <= 10 * NS // count
