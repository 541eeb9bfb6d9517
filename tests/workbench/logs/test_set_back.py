from __future__ import annotations

from collections import Counter

import pytest
from eigenscan.schemas.channels import ODOMETRY
from eigenscan.schemas.envelope import Envelope
from eigenscan.workbench.logs.log import LogOptions, in_order, odometry, raw_scan

S = 1_000_000_000
ARRIVAL = tuple[str, float]


def ordered(*arrivals: ARRIVAL) -> tuple[dict[str, list[float]], dict[str, int], dict[float, float]]:
    """Times by kind, what was counted, and the times as logged of scans by their new ones, all in s."""
    counters, logged = Counter[str](), dict[int, int]()
    times: dict[str, list[float]] = {}
    for envelope in in_order(map(message, arrivals), 2 * S, counters, logged):
        name = "odometry" if envelope.channel is ODOMETRY else envelope.address["lidar"]
        times.setdefault(name, []).append(envelope.stamp / S)
    return times, dict(counters), {new / S: old / S for new, old in logged.items()}


def message(arrival: ARRIVAL) -> Envelope:
    name, time = arrival
    if name == "odometry":
        return odometry(LogOptions(), round(time * S), (0, 0, 0))
    return raw_scan(LogOptions(), name, round(time * S), (0, 0, 0), ranges=[1.0])


def drive(begins: float, seconds: int, lidar: float = 0.0) -> list[ARRIVAL]:
    """Odometry twice a second and a scan in each; the lidar's clock is `lidar` s ahead."""
    found = list[ARRIVAL]()
    for second in range(seconds):
        now = begins + second
        found += [("odometry", now), ("scan", now + 0.25 + lidar), ("odometry", now + 0.5)]
    return found


def test_scans_and_odometry_go_on_together_after_the_clock_was_set_back() -> None:
    times, counters, logged = ordered(*drive(1000.0, 20), *drive(100.0, 20))
    assert counters == {"clock_set_back": 1}
    assert times["odometry"] == [1000.0 + half / 2 for half in range(80)]
    assert times["scan"] == [1000.25 + second for second in range(40)]
    assert logged == {1020.25 + second: 100.25 + second for second in range(20)}


def test_a_clock_that_is_set_back_again_goes_on_again() -> None:
    times, counters, _ = ordered(*drive(1000.0, 20), *drive(100.0, 20), *drive(900.0, 20), *drive(50.0, 20))
    assert counters == {"clock_set_back": 2}  # from 900 s on it was set ahead
    assert times["odometry"] == sorted(times["odometry"])
    assert (len(times["odometry"]), len(times["scan"])) == (160, 80)


def test_a_lidar_whose_own_clock_was_set_back_moves_no_odometry() -> None:
    times, counters, _ = ordered(*drive(1000.0, 20), *drive(1020.0, 20, lidar=-1000.0))
    assert counters == {"clock_set_back": 1}
    assert times["odometry"] == [1000.0 + half / 2 for half in range(80)]
    assert times["scan"] == [1000.25 + second for second in range(40)]


@pytest.mark.parametrize("strays", [1, 9])
def test_lone_late_stamps_are_left_out(strays: int) -> None:
    late = [("scan", 5.0 + k) for k in range(strays)]
    times, counters, _ = ordered(*drive(1000.0, 20), *late, *drive(1020.0, 20))
    assert counters == {"scan_raw_out_of_order": strays}
    assert len(times["scan"]) == 40


def test_a_lone_stamp_ahead_makes_no_other_late() -> None:
    times, counters, _ = ordered(*drive(1000.0, 20), ("scan", 1027.0), *drive(1020.0, 20))
    assert counters == {}
    assert len(times["scan"]) == 41


def test_a_clock_that_was_set_back_just_before_the_end_is_not_known() -> None:
    _, counters, _ = ordered(*drive(1000.0, 20), *drive(100.0, 2))
    assert counters == {"odometry_out_of_order": 4, "scan_raw_out_of_order": 2}
