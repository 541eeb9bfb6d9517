"""Motion between two scans, and lidars that are frozen, covered or not one alone."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.motion import Points, motion_between, points_of
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.ingest.watch import Watch, alike
from eigenscan.schemas.channels import FOLLOWS, SCAN, SCAN_MOTION, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.scan_pb2 import RawScan, ScanMotion
from hypothesis import given
from hypothesis import strategies as st

from tests.services.scan_ingest import room
from tests.services.scan_ingest.room import MOUNT

BEAMS, FIRST, STEP = 361, -math.pi / 2, math.radians(0.5)


def composed(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, float, float]:
    c, s = math.cos(a[2]), math.sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2]


def seen(base: tuple[float, ...], rng: np.random.Generator, noise: float = 0.01) -> np.ndarray:
    """Ranges from a base pose, with noise."""
    bases, bearings = np.broadcast_to(base, (BEAMS, 3)), FIRST + STEP * np.arange(BEAMS)
    return room.seen(bases, bearings) + noise * rng.standard_normal(BEAMS)


@given(st.integers(0, 1000), st.floats(-0.25, 0.25), st.floats(-0.1, 0.1), st.floats(-0.5, 0.5))
def test_the_motion_between_two_scans_is_found_without_a_guess(
    seed: int, x: float, y: float, turn: float
) -> None:
    rng, start = np.random.default_rng(seed), (0.0, 0.5, 0.3)
    before, after = (
        points_of(seen(pose, rng), FIRST, STEP, MOUNT, time)
        for time, pose in enumerate((start, composed(start, (x, y, turn))))
    )
    moved = motion_between(before, after, (0.0, 0.0, 0.0))
    assert moved.fits
    assert moved.delta == pytest.approx((x, y, turn), abs=0.03)


def test_a_first_beam_that_trembles_about_half_a_turn_is_of_one_lidar() -> None:
    """At 180 and at -180 deg: such scans had nothing in common, as if the robot had been carried off."""
    rng, start, beams = np.random.default_rng(0), (0.0, 0.5, 0.3), 720
    before, after = (
        points_of(
            room.seen(np.broadcast_to(pose, (beams, 3)), first + STEP * np.arange(beams))
            + 0.01 * rng.standard_normal(beams),
            first,
            STEP,
            MOUNT,
            time,
        )
        for time, (first, pose) in enumerate(
            [(-math.pi, start), (math.pi - 1e-4, composed(start, (0.1, 0.0, 0.2)))]
        )
    )
    moved = motion_between(before, after, (0.0, 0.0, 0.0))
    assert moved.explained > FOLLOWS
    assert moved.delta == pytest.approx((0.1, 0.0, 0.2), abs=0.03)


def test_along_a_hallway_the_covariance_states_that_nothing_is_known() -> None:
    angles = -math.pi + STEP * np.arange(720)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(np.abs(1.0 / np.sin(angles)), 20.0)
    ranges[ranges >= 20.0] = np.nan
    points = points_of(ranges, -math.pi, STEP, (0.0, 0.0, 0.0), 0)
    covariance = motion_between(points, points, (0.0, 0.0, 0.0)).covariance
    assert covariance[0, 0] > 0.5
    assert covariance[1, 1] < 0.01


def hall(walked: float, rng: np.random.Generator) -> np.ndarray:
    """Ranges in a round hall of 5 m radius, 1 m beside its middle; three people walk around it."""
    angles = FIRST + STEP * np.arange(BEAMS)
    ranges = np.sqrt(25.0 - np.sin(angles) ** 2) - np.cos(angles) + 0.02 * rng.standard_normal(BEAMS)
    for bearing in (-0.9, 0.1, 1.0):
        # seen from 1 m beside the middle, 3 m from it
        x, y = 3.0 * math.cos(bearing + walked) - 1.0, 3.0 * math.sin(bearing + walked)
        off, away = angles - math.atan2(y, x), math.hypot(x, y)
        ranges = np.where(np.abs(off) < 0.25 / away, away + 0.01 * rng.standard_normal(BEAMS), ranges)
    return ranges


@pytest.mark.parametrize("walked", [-0.08, 0.08])
def test_in_a_round_hall_people_do_not_fix_the_turn(walked: float) -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        before, after = (
            points_of(hall(each, rng), FIRST, STEP, (0.0, 0.0, 0.0), 0) for each in (0.0, walked)
        )
        found = motion_between(before, after, (0.0, 0.0, 0.0))
        assert math.sqrt(found.covariance[2, 2]) > abs(found.delta[2]) / 3.0


def test_in_a_room_the_turn_stays_known() -> None:
    rng = np.random.default_rng(0)
    before, after = (points_of(seen((0.0, 0.5, 0.3), rng), FIRST, STEP, MOUNT, 0) for _ in range(2))
    assert motion_between(before, after, (0.0, 0.0, 0.0)).covariance[2, 2] < math.radians(0.3) ** 2


def racks(x: float, rng: np.random.Generator) -> np.ndarray:
    """Ranges, 5.6 m at most, between two rows of posts that stand every 0.4 m before a wall."""
    angles = FIRST + STEP * np.arange(BEAMS)
    with np.errstate(divide="ignore", invalid="ignore"):
        walls = np.abs(1.2 / np.sin(angles))
        posts = np.abs(1.0 / np.sin(angles))
        along = x + posts * np.cos(angles)
        ranges = np.where(along % 0.4 < 0.1, posts, walls) + 0.01 * rng.standard_normal(BEAMS)
    return np.where(ranges < 5.6, ranges, np.nan)


@pytest.mark.parametrize("moved", [0.1, 0.2])
@pytest.mark.parametrize("seed", range(5))
def test_between_rows_that_look_alike_the_way_is_right_or_not_known(moved: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    before, after = (points_of(racks(x, rng), FIRST, STEP, (0.0, 0.0, 0.0), 0) for x in (0.0, moved))
    found = motion_between(before, after, (0.0, 0.0, 0.0))
    assert abs(found.delta[0] - moved) < 0.05 or found.covariance[0, 0] > 0.5
    assert abs(found.delta[2]) < 0.02


@pytest.mark.parametrize("ahead", [0.8, 1.0, 1.5])
@pytest.mark.parametrize("moved", [-0.3, 0.2, 0.4])
def test_somebody_who_walks_ahead_along_a_hallway_does_not_fix_the_way(ahead: float, moved: float) -> None:
    """Who stays as far away shows a robot that stands; who comes nearer one that is faster."""
    rng, angles = np.random.default_rng(3), FIRST + STEP * np.arange(BEAMS)
    for nearer in (0.0, 0.5, -0.4):
        scans = []
        for distance in (ahead, ahead - nearer):
            ranges = hallway(1.0, rng)
            ranges[np.abs(angles) < math.atan2(0.25, distance)] = distance + 0.01 * rng.standard_normal()
            scans.append(points_of(ranges, FIRST, STEP, (0.0, 0.0, 0.0), 0))
        found = motion_between(scans[0], scans[1], (moved, 0.0, 0.0))
        assert found.covariance[0, 0] > 0.5
        assert found.covariance[1, 1] < 0.01


def test_scans_of_two_places_do_not_fit() -> None:
    rng = np.random.default_rng(2)
    before = points_of(seen((0.0, 0.5, 0.3), rng), FIRST, STEP, MOUNT, 0)
    after = points_of(rng.uniform(1.0, 9.0, BEAMS), FIRST, STEP, MOUNT, 1)
    assert not motion_between(before, after, (0.0, 0.0, 0.0)).fits


class Lidar:
    """Publishes raw scans, ten a second, to a core."""

    def __init__(self) -> None:
        self.core, self.time = ScanIngestCore(ScanIngestSettings()), 0

    def publish(
        self, ranges: np.ndarray, mount: tuple[float, ...] = MOUNT, after: int = 100_000_000
    ) -> list[Envelope]:
        self.time += after
        raw = RawScan(
            timestamp=stamp(self.time),
            mount=Pose2(x=mount[0], y=mount[1], theta=mount[2]),
            angle_min=FIRST,
            angle_increment=STEP,
            ranges=ranges.tolist(),
        )
        return [*self.core.handle(Envelope(SCAN_RAW, {"site": "s", "robot": "r", "lidar": "front"}, raw))]

    @property
    def fault(self) -> str:
        condition = self.core.condition()
        return condition.detail if condition.status == Health.STATUS_DEGRADED else ""


def test_a_drive_is_reported_piece_by_piece() -> None:
    lidar, rng, reported, since = Lidar(), np.random.default_rng(5), (0.0, 0.0, 0.0), 100_000_000
    pose = start = (-1.0, 0.5, 0.0)
    for _ in range(40):
        for envelope in lidar.publish(seen(pose, rng)):
            if envelope.channel is SCAN_MOTION:
                message = envelope.open(ScanMotion)
                assert message.since == stamp(since)
                since, last = lidar.time, pose
                reported = composed(reported, (message.motion.x, message.motion.y, message.motion.theta))
        pose = composed(pose, (0.04, 0.0, 0.02))
    assert composed(start, reported) == pytest.approx(last, abs=0.1)
    assert not lidar.fault


def test_scans_that_a_driver_publishes_at_once_show_the_turn_between_them() -> None:
    lidar, rng, reported = Lidar(), np.random.default_rng(5), 0.0
    pose = (-1.0, 0.5, 0.0)
    for burst in range(5):  # it stands until the scans' mean rate is known
        for after in (2_000_000_000, *[1_000_000] * 9):
            for envelope in lidar.publish(seen(pose, rng), after=after):
                if envelope.channel is SCAN_MOTION:
                    message, last = envelope.open(ScanMotion), pose
                    assert message.HasField("motion")
                    reported += message.motion.theta
            pose = composed(pose, (0.0, 0.0, 0.09 if burst else 0.0))
    assert reported == pytest.approx(last[2], abs=0.05)
    assert reported > 3.0


def test_of_a_fast_lidar_not_every_scan_is_laid_on_an_earlier_one() -> None:
    slow, fast = (Lidar() for _ in range(2))
    rng, published = np.random.default_rng(5), Counter[str]()
    for lidar, name, period in ((slow, "slow", 100_000_000), (fast, "fast", 25_000_000)):
        for scan in range(10_000_000_000 // period):
            pose = (-1.0, 0.5, 0.3 * scan * period * 1e-9)
            output = lidar.publish(seen(pose, rng), after=period)
            published[name] += sum(envelope.channel is SCAN_MOTION for envelope in output)
    assert published["fast"] <= 1.2 * published["slow"]


@pytest.mark.parametrize("scans", range(20, 26))
def test_a_fast_lidar_that_is_carried_off_is_reported_with_its_first_scan(scans: int) -> None:
    lidar, rng, output = Lidar(), np.random.default_rng(5), list[Envelope]()
    for scan in range(scans + 1):
        pose = (-1.0, 0.5, 0.3) if scan < scans else (3.5, 1.5, -2.0)
        output = lidar.publish(seen(pose, rng), after=25_000_000)
    message = output[0].open(ScanMotion)
    assert message.timestamp == stamp(lidar.time)
    assert message.watched
    assert not message.HasField("motion")


def hallway(left: float, rng: np.random.Generator) -> np.ndarray:
    """Ranges between two parallel walls, 1 m to the right and `left` m to the left, up to 20 m."""
    angles = FIRST + STEP * np.arange(BEAMS)
    reach = np.where(angles < 0.0, 1.0, left) / np.maximum(np.abs(np.sin(angles)), 1e-6)
    return np.where(reach < 20.0, reach + 0.01 * rng.standard_normal(BEAMS), np.inf)


@pytest.mark.parametrize("scans", [20, 21])
def test_a_lidar_that_is_carried_off_to_half_the_same_view_is_reported_with_its_first_scan(
    scans: int,
) -> None:
    lidar, rng, output = Lidar(), np.random.default_rng(5), list[Envelope]()
    for scan in range(scans + 1):
        output = lidar.publish(hallway(1.0 if scan < scans else 3.5, rng), after=25_000_000)
    message = output[0].open(ScanMotion)
    assert message.timestamp == stamp(lidar.time)
    assert message.HasField("motion")
    assert message.explained < FOLLOWS


@pytest.mark.parametrize(("returns", "reported"), [(0.1, False), (0.2, True)])
def test_scans_that_show_next_to_nothing_are_not_compared(returns: float, reported: bool) -> None:
    """In a hall wider than the lidar sees a few beams meet something, now here, now there."""
    lidar, rng, motions = Lidar(), np.random.default_rng(5), 0
    for scan in range(30):
        ranges = np.full(BEAMS, np.inf)
        first = rng.integers(0, round((1.0 - returns) * BEAMS)) if scan else 0
        few = slice(first, first + round(returns * BEAMS))
        ranges[few] = seen((-1.0, 0.5, 0.3), rng)[few]
        motions += sum(one.channel is SCAN_MOTION for one in lidar.publish(ranges, after=200_000_000))
    assert (motions > 0) == reported
    first_whole = lidar.publish(seen((3.5, 1.5, -2.0), rng), after=200_000_000)
    assert any(one.channel is SCAN_MOTION for one in first_whole) == reported


def test_who_walks_by_is_no_sign_that_a_scan_does_not_follow_from_the_one_before() -> None:
    """After three scans half of the first one is hidden, and a fifth at most of each neighbour."""
    lidar, rng, reported = Lidar(), np.random.default_rng(5), list[ScanMotion]()
    for hidden in (0.0, 0.19, 0.37, 0.55):
        ranges = seen((-1.0, 0.5, 0.3), rng)
        ranges[: round(hidden * len(ranges))] = 0.4
        output = lidar.publish(ranges, after=200_000_000)
        reported += [one.open(ScanMotion) for one in output if one.channel is SCAN_MOTION]
    (message,) = reported
    assert message.HasField("motion")
    assert message.explained > 0.7


@given(st.integers(-30, 30), st.integers(20, 400))
def test_a_turn_alone_leaves_the_ranges_alike(turned: int, count: int) -> None:
    ring = np.random.default_rng(count).uniform(1.0, 9.0, count + 60).astype(np.float32)
    before, after = ring[30 : 30 + count], ring[30 + turned : 30 + turned + count]
    if abs(turned) < count:
        assert alike(before, after, turned) == 1.0
    assert alike(before, before + np.float32(0.3), 0) == 0.0
    assert alike(before, before[:-1], 0) == 0.0
    assert alike(np.full(count, np.inf, np.float32), np.full(count, np.nan, np.float32), 0) == 0.0


def test_identical_scans_are_counted_and_named() -> None:
    lidar, still = Lidar(), seen((0.0, 0.5, 0.3), np.random.default_rng(1))
    published = [lidar.publish(still) for _ in range(25)]
    assert all(envelopes[-1].channel is SCAN for envelopes in published)
    repeats = [each[0].open(ScanMotion).repeats for each in published[1:]]
    assert repeats == list(range(1, 25))
    assert lidar.fault.startswith("lidar r/front frozen: 20 or more scans repeat earlier ones")
    lidar.publish(seen((0.0, 0.5, 0.3), np.random.default_rng(2)))
    assert not lidar.fault


def test_scans_of_some_time_ago_that_come_again_are_repeats() -> None:
    lidar, rng = Lidar(), np.random.default_rng(1)
    drive = [seen((0.02 * k, 0.5, 0.01 * k), rng) for k in range(30)]
    for scan in drive:
        lidar.publish(scan)
    assert not lidar.fault
    again = [lidar.publish(scan)[0].open(ScanMotion) for scan in drive]
    assert [each.repeats for each in again] == list(range(1, 31))
    assert not any(each.HasField("motion") for each in again)
    assert lidar.fault.startswith("lidar r/front frozen: 20 or more scans repeat earlier ones")


@pytest.mark.parametrize("pause_s", [-100.0, 1.5])
def test_a_recording_that_is_played_again_is_no_frozen_lidar(pause_s: float) -> None:
    lidar, rng = Lidar(), np.random.default_rng(1)
    lidar.time = 10**12
    drive = [seen((0.02 * k, 0.5, 0.01 * k), rng) for k in range(30)]
    for scan in drive:
        lidar.publish(scan)
    lidar.time += round(pause_s * 1e9)
    for scan in drive:
        for published in lidar.publish(scan):
            assert published.channel is SCAN or not published.open(ScanMotion).repeats
    assert "frozen" not in lidar.fault


def test_scans_with_few_returns_may_be_alike_by_chance() -> None:
    lidar, empty = Lidar(), np.full(BEAMS, np.inf)
    for k in range(60):
        scan = empty.copy()
        scan[k % 2] = 2.0
        lidar.publish(scan)
    assert not lidar.fault


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_covered_lidar_publishes_nothing_and_is_named(noise: float) -> None:
    lidar, rng = Lidar(), np.random.default_rng(1)
    for _ in range(6):
        assert not lidar.publish(0.7 + noise * rng.standard_normal(BEAMS))
    assert "lidar r/front covered" in lidar.fault
    lidar.publish(seen((0.0, 0.5, 0.3), rng))
    assert "lidar r/front covered" not in lidar.fault


def test_a_wall_close_ahead_is_no_cover() -> None:
    angles = FIRST + STEP * np.arange(BEAMS)
    wall = np.minimum(0.2 / np.maximum(np.cos(angles), 0.01), 3.0)
    assert Lidar().publish(wall)


def test_two_lidars_of_one_name_are_named_and_set_aside() -> None:
    lidar, rng = Lidar(), np.random.default_rng(1)
    published = [
        lidar.publish(seen((0.0, 0.5, 0.3), rng), MOUNT if scan % 2 else (-0.3, 0.0, math.pi))
        for scan in range(20)
    ]
    assert not any(published[8:])
    assert "two lidars" in lidar.fault


@pytest.mark.parametrize("first", [-0.75, -math.pi])
def test_a_first_beam_that_trembles_is_no_second_lidar(first: float) -> None:
    watch = Watch()
    for scan in range(20):
        tremble = 1e-3 if scan % 2 else -1e-3
        watch.receive_layout(MOUNT, (first + tremble + math.pi) % (2.0 * math.pi) - math.pi)
    assert not watch.two_lidars


def test_scans_of_two_clocks_are_named() -> None:
    lidar, rng = Lidar(), np.random.default_rng(1)
    for scan in range(30):
        lidar.time += (3 if scan % 2 else -3) * 1_000_000_000
        lidar.publish(seen((0.0, 0.5, 0.3), rng))
    assert "two clocks" in lidar.fault


@pytest.mark.parametrize("seed", range(10))
def test_noise_does_not_fix_the_way_along_a_bare_hallway(seed: int) -> None:
    """Walls' lines that noise turned once showed a robot that drives as standing, exactly."""
    rng = np.random.default_rng(seed)
    angles = np.radians(np.linspace(-135.0, 135.0, 541))
    step = float(angles[1] - angles[0])

    def scan(stamp: int) -> Points:
        ranges = 1.5 / np.maximum(np.abs(np.sin(angles)), 1e-9) + rng.normal(0.0, 0.03, len(angles))
        return points_of(
            np.where(ranges < 20.0, ranges, np.inf), float(angles[0]), step, (0.0, 0.0, 0.0), stamp
        )

    motion = motion_between(scan(0), scan(1), (0.3, 0.0, 0.0))
    assert motion.covariance[0, 0] > 0.1
    assert motion.covariance[1, 1] < 0.01
