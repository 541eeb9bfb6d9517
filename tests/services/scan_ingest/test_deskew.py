"""Scans that a lidar sweeps while the robot moves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.normalize import Sweep
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.deskew import Timing, deskewed
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.schemas.channels import SCAN, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.services.scan_ingest.room import MOUNT, seen

Array = NDArray[Any]

ADDRESS = {"site": "s", "robot": "r", "lidar": "front"}
PERIOD_S, SWEEP_S = 0.1, 0.08


def driven(velocity: tuple[float, float, float], seconds: Array) -> Array:
    """Base poses (n, 3) after some seconds (n,) at a velocity, in ten small steps each."""
    middles = velocity[2] * seconds[:, None] * (np.arange(10) + 0.5) / 10
    ahead, left = np.cos(middles).mean(axis=1), np.sin(middles).mean(axis=1)
    x, y = velocity[0] * ahead - velocity[1] * left, velocity[0] * left + velocity[1] * ahead
    return np.stack([seconds * x, seconds * y, velocity[2] * seconds], axis=1)


def grid(beams: int, turn: float) -> tuple[float, float, Array]:
    """First bearing and step, rad, and all bearings of a lidar that sees a `turn`, rad."""
    step = 2.0 * math.pi / beams if turn >= 2.0 * math.pi else turn / (beams - 1)
    first = -turn / 2.0
    return first, step, first + step * np.arange(beams)


def swept(
    start: Array,
    velocity: tuple[float, float, float],
    bearings: Array,
    order: int,
    mount: Array | None = None,
) -> Array:
    """Ranges of a scan that is swept in `order` while the base moves on from `start` (3,)."""
    count = len(bearings)
    since = SWEEP_S * np.arange(count) / (count - 1)
    own = driven(velocity, since[::order] if order else 0.0 * since)
    cos, sin = math.cos(start[2]), math.sin(start[2])
    bases = np.stack(
        [
            start[0] + cos * own[:, 0] - sin * own[:, 1],
            start[1] + sin * own[:, 0] + cos * own[:, 1],
            start[2] + own[:, 2],
        ],
        axis=1,
    )
    return seen(bases, bearings, MOUNT if mount is None else (mount[0], mount[1], mount[2]))


def off(one: Array, other: Array) -> float:
    """Distance, m, below which nine tenths of two scans' ranges differ: edges may differ by a beam."""
    return float(np.nanquantile(np.abs(one - other), 0.9))


@given(
    st.floats(-1.5, 1.5), st.floats(-1.0, 1.0), st.floats(-2.5, 2.5), st.sampled_from([1, -1]),
    st.sampled_from([2.0 * math.pi, math.radians(270.0)]),
)  # fmt: skip
def test_a_deskewed_scan_is_that_of_a_robot_that_stood_at_its_first_beam(
    ahead: float, left: float, turn: float, order: int, sees: float
) -> None:
    first, step, bearings = grid(720, sees)
    velocity = ahead, left, turn
    skewed = swept(np.zeros(3), velocity, bearings, order)
    still = seen(np.zeros((len(bearings), 3)), bearings)
    timing = Timing(order * SWEEP_S / (len(bearings) - 1))
    straight = deskewed(Sweep(skewed.astype(np.float32), first, step), timing, velocity, MOUNT)
    assert (straight.angle_min, straight.angle_increment) == (first, step)
    assert off(straight.ranges, still) < 0.01
    # no gaps but where the robot turned away meanwhile
    assert np.isnan(straight.ranges).mean() <= 0.01 + abs(turn) * SWEEP_S / sees


@pytest.mark.parametrize("order", [1, -1])
def test_a_scan_that_is_stamped_at_its_end_is_moved_to_there(order: int) -> None:
    first, step, bearings = grid(720, 2.0 * math.pi)
    velocity, timing = (0.5, 0.0, 1.0), Timing(order * SWEEP_S / 719, SWEEP_S)
    skewed = swept(np.zeros(3), velocity, bearings, order)
    end = np.broadcast_to(driven(velocity, np.array([SWEEP_S]))[0], (720, 3))
    straight = deskewed(Sweep(skewed.astype(np.float32), first, step), timing, velocity, MOUNT)
    assert off(straight.ranges, seen(end, bearings)) < 0.01


def test_a_robot_that_stands_keeps_its_ranges() -> None:
    first, step, bearings = grid(360, 2.0 * math.pi)
    ranges = seen(np.zeros((360, 3)), bearings).astype(np.float32)
    ranges[10], ranges[20] = np.nan, np.inf
    straight = deskewed(Sweep(ranges, first, step), Timing(1e-4, 0.02), (0.0, 0.0, 0.0), MOUNT)
    assert np.allclose(straight.ranges, ranges, atol=1e-5, equal_nan=True)


def test_beams_without_a_return_turn_with_the_robot() -> None:
    first, step, _ = grid(360, 2.0 * math.pi)
    ranges = np.full(360, 3.0, dtype=np.float32)
    ranges[100:111], ranges[300:311] = np.inf, np.nan
    # while ten beams are measured, the robot turns by one
    straight = deskewed(Sweep(ranges, first, step), Timing(0.002), (0.0, 0.0, step / 0.02), (0.0, 0.0, 0.0))
    assert np.flatnonzero(np.isinf(straight.ranges)).mean() == pytest.approx(105.0 + 10.5, abs=0.6)
    missing = np.flatnonzero(np.isnan(straight.ranges))
    assert missing[missing > 200].mean() == pytest.approx(305.0 + 30.5, abs=0.6)


def drive(
    scans: int, order: int, beams: int = 360, noise: float = 0.005, seed: int = 1
) -> Iterator[tuple[Array, Array]]:
    """Of a robot that turns to and fro in the room: each scan as swept in `order`, and as if it had stood."""
    _, _, bearings = grid(beams, 2.0 * math.pi)
    rng, pose = np.random.default_rng(seed), np.array([0.0, 0.5, 0.3])
    for number in range(scans):
        velocity = 0.1, 0.0, 1.2 * math.sin(1.5 * number * PERIOD_S)
        errors = noise * rng.standard_normal(beams)
        still = seen(np.broadcast_to(pose, (beams, 3)), bearings)
        yield swept(pose, velocity, bearings, order) + errors, still + errors
        step = driven(velocity, np.array([PERIOD_S]))[0]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        pose = pose + np.array([cos * step[0] - sin * step[1], sin * step[0] + cos * step[1], step[2]])


def published(
    ingest: ScanIngestCore, number: int, ranges: Array, increment: float, **fields: object
) -> Array:
    first, step, _ = grid(len(ranges), 2.0 * math.pi)
    given: dict[str, object] = {
        "mount": Pose2(x=MOUNT[0], y=MOUNT[1], theta=MOUNT[2]),
        "angle_min": first,
        "angle_increment": step,
        "range_max": 20.0,
        "time_increment": increment,
        "ranges": ranges.tolist(),
    }
    time = stamp(1_000_000_000 + number * round(PERIOD_S * 1e9))
    raw = RawScan(timestamp=time, **(given | fields))  # type: ignore[arg-type]
    scan = next(e for e in ingest.handle(Envelope(SCAN_RAW, ADDRESS, raw)) if e.channel is SCAN)
    return np.array(scan.open(Scan).ranges)


@pytest.mark.parametrize("order", [1, -1])
def test_a_lidar_that_sweeps_is_deskewed_whatever_order_its_driver_states(order: int) -> None:
    """rplidar_ros reverses the beams, and states a positive time between them all the same."""
    ingest, increment = ScanIngestCore(ScanIngestSettings()), SWEEP_S / 359
    errors = [
        (off(published(ingest, number, skewed, increment), still), off(skewed, still))
        for number, (skewed, still) in enumerate(drive(100, order))
    ]
    after, before = np.array(errors[60:]).T
    assert np.median(before) > 0.06
    assert np.median(after) < 0.02
    assert np.quantile(after, 0.9) < 0.04
    assert ingest.condition().counters["deskewed"] > 60


def test_a_lidar_that_takes_all_beams_at_once_is_left_alone() -> None:
    """Simulators state a time between beams that they cast at once."""
    ingest = ScanIngestCore(ScanIngestSettings())
    for number, (ranges, _) in enumerate(drive(100, 0)):
        found = published(ingest, number, ranges, SWEEP_S / 359)
        assert np.array_equal(found, ranges.astype(np.float32))
    assert "deskewed" not in ingest.condition().counters


def test_a_lidar_that_turns_clockwise_or_hangs_head_down_is_deskewed_too() -> None:
    clockwise, hanging = ScanIngestCore(ScanIngestSettings()), ScanIngestCore(ScanIngestSettings())
    first, step, _ = grid(360, 2.0 * math.pi)
    increment = SWEEP_S / 359
    for number, (skewed, _) in enumerate(drive(80, -1)):
        turned = skewed[::-1]
        one = published(
            clockwise, number, turned, increment, angle_min=first + 359 * step, angle_increment=-step
        )
        other = published(
            hanging, number, turned, increment, angle_min=-(first + 359 * step), upside_down=True
        )
        assert np.allclose(one, other, atol=1e-3, equal_nan=True)
    assert clockwise.condition().counters["deskewed"] == hanging.condition().counters["deskewed"] > 40


@pytest.mark.parametrize("increment", [0.0, math.nan, math.inf, 1e-9, -1.0])
def test_without_a_time_between_beams_nothing_is_moved(increment: float) -> None:
    ingest = ScanIngestCore(ScanIngestSettings())
    for number, (skewed, _) in enumerate(drive(60, 1)):
        assert np.array_equal(published(ingest, number, skewed, increment), skewed.astype(np.float32))


def test_a_scan_after_a_pause_is_left_as_it_is() -> None:
    """How the robot moves is not known any more."""
    ingest, scans = ScanIngestCore(ScanIngestSettings()), list(drive(100, 1))
    for number, (skewed, _) in enumerate(scans[:80]):
        published(ingest, number, skewed, SWEEP_S / 359)
    before = ingest.condition().counters["deskewed"]
    assert before > 0
    skewed = scans[95][0]
    assert np.array_equal(published(ingest, 95, skewed, SWEEP_S / 359), skewed.astype(np.float32))
    assert ingest.condition().counters["deskewed"] == before
