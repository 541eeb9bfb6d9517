"""Where a reference is in doubt, and where a similar place is none of that."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.pose import to_message
from eigenscan.geometry.raycast import RayCaster
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.workbench.evaluation.doubt import Walls, doubtful
from eigenscan.workbench.evaluation.metrics import Judged, Stream, judge
from eigenscan.workbench.evaluation.reference import NS, Trajectory

BEAMS = 180


def _hall() -> GridMap:
    """Two rooms of 8 m x 6 m that look alike, 10 m apart."""
    cells = np.full((80, 200), OCCUPIED, dtype=np.uint8)
    for left in (10, 110):
        cells[10:70, left : left + 80] = FREE
        cells[30:40, left + 20 : left + 24] = OCCUPIED
    return GridMap(cells, 0.1, np.zeros(3))


def _scan_at(pose: tuple[float, float, float]) -> Scan:
    angles = np.arange(BEAMS) * 2 * np.pi / BEAMS
    ranges = RayCaster.of(_hall()).cast(np.array(pose), angles, 30.0)
    return Scan(
        ranges=ranges.astype(np.float32).ravel().tolist(),
        angle_increment=2 * np.pi / BEAMS,
        range_max=30.0,
        mount=to_message((0.0, 0.0, 0.0)),
    )


def _run(claims: list[tuple[float, float, float]], reference: list[tuple[float, float, float]]) -> Judged:
    count = len(claims)
    stamps = np.arange(count) * NS // 10
    stream = Stream(
        stamps=stamps,
        poses=np.array(claims),
        states=np.full(count, 3),
        localized=np.ones(count, dtype=np.bool_),
        tracked=np.ones(count, dtype=np.bool_),
        confidence=np.ones(count),
        covariances=np.tile(np.eye(3), (count, 1, 1)),
        nis=np.full(count, np.nan),
        cpu_s=np.zeros(count),
        scans=np.arange(count),
    )
    return judge(stream, Trajectory(stamps, np.array(reference)))


def test_a_reference_that_is_off_is_in_doubt_and_a_similar_place_is_not() -> None:
    true = (4.0, 4.5, 0.3)
    off = (4.9, 4.9, 0.3)  # the reference's own error
    alike = (14.0, 4.5, 0.3)
    judged = _run([true, alike, off], [off, off, true])
    scans = [
        Envelope(SCAN_RAW, {"site": "s", "robot": "r", "lidar": "l"}, RawScan(timestamp=stamp(int(at))))
        for at in judged.stream.stamps
    ]
    walls = Walls(DistanceField.of(_hall()), lambda _: _scan_at(true))
    assert judged.false_claims.tolist() == [True, True, True]
    assert list(doubtful(judged, scans, walls)) == [0]


def test_a_lidar_that_states_no_maximum_shows_as_much() -> None:
    scan, place = _scan_at((4.0, 4.5, 0.3)), np.array([4.0, 4.5, 0.3])
    walls = Walls(DistanceField.of(_hall()), lambda _: None)
    stated = walls.share(scan, place)
    scan.range_max = 0.0
    assert walls.share(scan, place) == stated > 0.9
