import math
import re
from collections import Counter
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry import normalize
from eigenscan.ingest import core as ingest_core
from eigenscan.ingest.core import WHY, ScanIngestCore
from eigenscan.ingest.options import ScanIngestOptions
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.runtime.settings import SettingsError, load
from eigenscan.schemas import recently_used
from eigenscan.schemas.channels import ODOMETRY, SCAN, SCAN_MOTION, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from hypothesis import given
from hypothesis import strategies as st

ADDRESS = {"site": "s", "robot": "r", "lidar": "front"}
SECOND = 1_000_000_000


def raw(time: int = SECOND, **fields: object) -> RawScan:
    given: dict[str, object] = {
        "angle_min": -1.5,
        "angle_increment": 0.01,
        "range_min": 0.1,
        "range_max": 30.0,
        "ranges": [2.0 + 0.002 * beam + time % 97 * 1e-4 for beam in range(300)],
    }
    return RawScan(timestamp=stamp(time), **(given | fields))  # type: ignore[arg-type]


def core(**settings: object) -> ScanIngestCore:
    return ScanIngestCore(ScanIngestSettings.model_validate(settings))


def received(message: RawScan, lidar: str = "front", robot: str = "r") -> Envelope:
    return Envelope(SCAN_RAW, ADDRESS | {"lidar": lidar, "robot": robot}, message)


def scans(published: Iterable[Envelope]) -> list[Scan]:
    return [envelope.open(Scan) for envelope in published if envelope.channel is SCAN]


def one(ingest: ScanIngestCore, message: RawScan) -> Scan:
    (scan,) = scans(ingest.handle(received(message)))
    return scan


def aside(ingest: ScanIngestCore) -> dict[str, int]:
    counters = ingest.condition().counters
    return {
        name.removeprefix("set_aside_"): n for name, n in counters.items() if name.startswith("set_aside")
    }


def test_a_grid_finer_than_the_lidar_is_the_lidars_own() -> None:
    """Each second beam of 600 is empty: the scan is the one of 300 beams, and so is its deskewing's time."""
    ingest, plain = core(), core()
    for number in range(1, 4):
        own = raw(number * SECOND)
        for empty in (math.nan, 0.0, math.inf):
            fine = [value for reach in own.ranges for value in (empty, reach)]
            message = raw(number * SECOND, ranges=fine, angle_increment=0.005, angle_min=-1.505)
            published = one(ingest if math.isnan(empty) else core(), message)
            assert list(published.ranges) == list(own.ranges)
            assert published.angle_min == pytest.approx(-1.5)
            assert published.angle_increment == pytest.approx(0.01)
        one(plain, own)
    assert ingest.condition().status == plain.condition().status == Health.STATUS_OK


def test_a_scan_passes_with_its_limits_mount_and_number() -> None:
    ingest = core(base_frame="base_footprint")
    mount = Pose2(x=0.2, y=-0.1, theta=0.5)
    for number in range(3):
        *motion, published = ingest.handle(received(raw((number + 1) * SECOND, mount=mount, gathered=3.0)))
        assert [each.channel for each in motion] == [SCAN_MOTION] * bool(number)
        assert published.channel is SCAN
        # the scan carries it: so the tracker has it with the scan's hypotheses
        assert [published.open(Scan).motion] * bool(number) == [each.message for each in motion]
        assert published.key == "s/robot/r/scan/front"
        scan = published.open(Scan)
        assert (scan.sequence, scan.frame_id, scan.mount) == (number, "base_footprint", mount)
        assert (scan.range_min, scan.range_max, scan.gathered) == (0.1, 30.0, 3.0)
        assert nanoseconds(scan.timestamp) == (number + 1) * SECOND
    assert ingest.condition().status == Health.STATUS_OK


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"ranges": []}, "no_beams"),
        ({"ranges": [math.nan] * 300}, "no_valid_range"),
        ({"ranges": [0.0] * 300}, "no_valid_range"),
        ({"ranges": [1.0] * 2000, "angle_increment": 0.003}, "too_many_beams"),
        ({"angle_increment": 0.0}, "angle_increment_zero"),
        ({"angle_min": math.inf}, "angles_not_finite"),
        ({"angle_increment": 1.0}, "over_a_turn"),
        ({"mount": Pose2(x=math.nan)}, "mount_not_finite"),
        ({"mount": Pose2(y=-1e308)}, "mount_too_far"),
        ({"range_min": 5.0, "range_max": 2.0}, "limits_inconsistent"),
        ({"range_max": math.nan}, "limits_inconsistent"),
        ({"range_max": -1.0}, "limits_inconsistent"),
    ],
)
def test_what_cannot_be_used_is_counted_by_reason(fields: dict[str, Any], reason: str) -> None:
    ingest = core(max_beams=1000)
    assert not list(ingest.handle(received(raw(**fields))))
    assert aside(ingest) == {reason: 1}
    assert ingest.condition().status == Health.STATUS_DEGRADED
    # and it does not stand in the way of the next, of the same stamp
    assert one(ingest, raw()).sequence == 0


def test_another_message_on_its_key_is_counted() -> None:
    ingest = core()
    assert not list(ingest.handle(Envelope(ODOMETRY, ADDRESS, Odometry())))
    assert aside(ingest) == {"other_message": 1}


def test_duplicate_and_late_stamps_are_set_aside() -> None:
    ingest = core()
    times = [10, 12, 12, 11, 13, 5, 14]
    published = [n for n in times for _ in scans(ingest.handle(received(raw(n * SECOND))))]
    assert published == [10, 12, 13, 14]
    assert aside(ingest) == {"duplicate_stamp": 1, "out_of_order": 2}


def test_lidars_and_robots_do_not_disturb_each_other() -> None:
    ingest = core()
    for time in (3, 2, 1):
        for robot in ("a", "b"):
            lidar = f"lidar{time}"
            (scan,) = scans(ingest.handle(received(raw(time * SECOND), lidar, robot)))
            assert scan.sequence == 0
    assert ingest.condition().counters["lidars"] == 6


def test_a_clock_that_was_set_back_is_followed_after_some_scans() -> None:
    ingest = core(clock_step_scans=4)
    times = [100, 101, 10, 11, 12, 13, 14]
    published = [n for n in times for _ in scans(ingest.handle(received(raw(n * SECOND))))]
    assert published == [100, 101, 13, 14]
    assert ingest.condition().counters["clock_steps"] == 1


def test_one_stamp_far_ahead_does_not_blind_for_good() -> None:
    ingest = core(clock_step_scans=5)
    times = [1, 2, 2_000_000_000, *range(3, 20)]
    published = [n for n in times for _ in scans(ingest.handle(received(raw(n * SECOND))))]
    assert published == [1, 2, 2_000_000_000, *range(7, 20)]


@given(st.lists(st.integers(1, 30), max_size=60))
def test_stamps_increase_but_where_the_clock_stepped(times: list[int]) -> None:
    ingest = core(clock_step_scans=3)
    published = [
        nanoseconds(s.timestamp) for n in times for s in scans(ingest.handle(received(raw(n * SECOND))))
    ]
    back = sum(b <= a for a, b in pairwise(published))
    counters = ingest.condition().counters
    assert back == counters.get("clock_steps", 0)
    assert counters["heard"] == len(times) == len(published) + sum(aside(ingest).values())


def test_each_reason_for_which_a_scan_is_set_aside_has_words() -> None:
    folders = (Path(str(module.__file__)).parent for module in (ingest_core, normalize))
    sources = [path.read_text(encoding="utf-8") for folder in folders for path in folder.glob("*.py")]
    raised = r'(?:ScanError|_set_aside)\("(\w+)"\)'
    reasons = {reason for source in sources for reason in re.findall(raised, source)}
    assert len(reasons) > 10
    assert reasons <= WHY.keys()


def test_a_lidar_that_is_set_aside_is_named_while_another_one_is_sound() -> None:
    """Half of all scans were published, and health was OK."""
    ingest = core()
    for number in range(1, 60):
        assert len(scans(ingest.handle(received(raw(number * SECOND))))) == 1
        limits: dict[str, object] = {"range_min": 5.0, "range_max": 1.0}
        assert not list(ingest.handle(received(raw(number * SECOND, **limits), lidar="rear")))
    condition = ingest.condition()
    assert condition.status == Health.STATUS_DEGRADED
    assert condition.detail == (
        "lidar r/rear has most of its latest scans set aside (limits_inconsistent): "
        "range_min, range_max: contradict each other, or are no numbers"
    )
    for number in range(60, 90):
        list(ingest.handle(received(raw(number * SECOND), lidar="rear")))
    assert ingest.condition().status == Health.STATUS_OK


def test_health_is_of_lidars_that_send(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frozen lidar that was switched off was named for hours."""
    monkeypatch.setattr(ingest_core, "SILENT", 20)
    ingest = core()
    for number in range(1, 31):
        list(ingest.handle(received(raw(number * SECOND, ranges=raw().ranges), robot="gone")))
    assert "lidar gone/front frozen" in ingest.condition().detail
    for number in range(1, 2 * ingest_core.SILENT + 2):
        list(ingest.handle(received(raw(number * SECOND))))
    assert ingest.condition().status == Health.STATUS_OK


def test_a_scan_without_angles_makes_no_two_lidars_of_one() -> None:
    ingest = core()
    for number in range(1, 41):
        angle_min = math.nan if number % 2 else -1.5
        published = scans(ingest.handle(received(raw(number * SECOND, angle_min=angle_min))))
        assert len(published) == (number + 1) % 2
    assert aside(ingest) == {"angles_not_finite": 20}


def test_gaps_and_clock_steps_are_counted_once_each() -> None:
    """While scans were set aside, each of them was counted as a gap, or as a step of the clock."""
    ingest, nothing = core(), [math.nan] * 4
    one(ingest, raw(100 * SECOND))
    times = [(1000 + number) * SECOND // 10 for number in range(1, 101)]
    for time in times:
        list(ingest.handle(received(raw(time, ranges=nothing))))
    assert ingest.condition().counters.get("stamp_gaps", 0) == 0
    one(ingest, raw(120 * SECOND))
    assert ingest.condition().counters["stamp_gaps"] == 1
    for time in times:
        list(ingest.handle(received(raw(time, ranges=nothing))))
    one(ingest, raw(times[-1] + SECOND))
    assert ingest.condition().counters["stamp_gaps"] == 1
    assert ingest.condition().counters["clock_steps"] == 1


def test_it_reports_when_most_is_set_aside_and_recovers() -> None:
    ingest = core()
    assert ingest.condition().status == Health.STATUS_WAITING
    for number in range(1, 21):
        list(ingest.handle(received(raw(number * SECOND))))
    for _ in range(30):
        list(ingest.handle(received(raw(20 * SECOND))))
    condition = ingest.condition()
    assert condition.status == Health.STATUS_DEGRADED
    assert condition.detail.startswith(
        "lidar r/front has most of its latest scans set aside (duplicate_stamp): each scan "
    )
    for number in range(21, 50):
        list(ingest.handle(received(raw(number * SECOND))))
    assert ingest.condition().status == Health.STATUS_OK


@pytest.mark.parametrize("range_max", [30.0, 30_000.0], ids=["limit in metres", "limit in millimetres"])
def test_ranges_in_millimetres_are_named(range_max: float) -> None:
    ingest = core()
    for number in range(1, 7):
        message = raw(number * SECOND, range_max=range_max)
        message.ranges[:] = [1000.0 * each for each in message.ranges]
        assert not scans(ingest.handle(received(message)))
    assert aside(ingest) == {"not_in_metres": 6}
    assert ingest.condition().status == Health.STATUS_DEGRADED
    assert "lidar r/front has no range below 100 m: are its ranges millimetres" in ingest.condition().detail
    one(ingest, raw(7 * SECOND))
    assert "millimetres" not in ingest.condition().detail


def test_a_far_value_that_stands_for_no_return_is_no_unit() -> None:
    message = raw(ranges=[1000.0] * 280 + [2.0 + 0.002 * beam for beam in range(20)])
    assert np.isinf(one(core(), message).ranges).sum() == 280
    assert np.isinf(one(core(), raw(ranges=[1000.0] * 300)).ranges).all()


def test_settings_win_over_the_driver() -> None:
    ingest = core(
        range_min=0.5,
        range_max=8.0,
        mounts={"front": {"x": 1.0, "y": 2.0, "yaw": 90.0, "upside_down": True}},
    )
    scan = one(ingest, raw(ranges=[0.3, 1.0, 7.0, 9.0], angle_min=0.0, angle_increment=0.1))
    assert (scan.range_min, scan.range_max) == (0.5, 8.0)
    np.testing.assert_allclose([scan.mount.x, scan.mount.y, scan.mount.theta], [1.0, 2.0, math.pi / 2])
    # upside down: the first beam of the driver is the last, counter-clockwise
    np.testing.assert_array_equal(list(scan.ranges), [math.inf, 7.0, 1.0, math.nan])
    assert scan.angle_min == pytest.approx(-0.3)


def test_a_mount_for_every_lidar_gives_way_to_one_by_name() -> None:
    ingest = core(mounts={"*": {"x": 1.0}, "rear": {"x": -1.0}})
    found = {
        lidar: scans(ingest.handle(received(raw(), lidar)))[0].mount.x for lidar in ("front", "rear", "side")
    }
    assert found == {"front": 1.0, "rear": -1.0, "side": 1.0}


def test_an_infinite_maximum_is_not_stated() -> None:
    scan = one(core(), raw(range_max=math.inf, ranges=[1.0, 70.0, math.inf]))
    assert scan.range_max == 0.0
    assert list(scan.ranges) == [1.0, 70.0, math.inf]


def test_the_grid_of_the_settings_is_used() -> None:
    scan = one(
        core(angle_step=1.0),
        raw(
            angle_min=-math.pi,
            angle_increment=math.tau / 1440,
            ranges=(3.0 + 0.001 * np.arange(1440)).tolist(),
        ),
    )
    assert len(scan.ranges) == 360
    assert scan.angle_increment == pytest.approx(math.radians(1.0))
    np.testing.assert_allclose(list(scan.ranges), 3.0 + 0.004 * np.arange(360), rtol=1e-3)


floats = st.floats(width=32)


@given(
    ranges=st.lists(floats, max_size=30),
    angles=st.tuples(st.floats(), st.one_of(st.floats(), st.floats(-0.2, 0.2))),
    limits=st.tuples(st.floats(), st.floats()),
    pose=st.tuples(st.floats(), st.floats(), st.floats()),
    upside_down=st.booleans(),
    angle_step=st.one_of(st.none(), st.floats(0.05, 10.0)),
)
def test_whatever_comes_in_only_canonical_scans_go_out(
    ranges: list[float],
    angles: tuple[float, float],
    limits: tuple[float, float],
    pose: tuple[float, float, float],
    upside_down: bool,
    angle_step: float | None,
) -> None:
    ingest = core(angle_step=angle_step)
    message = raw(
        ranges=ranges,
        angle_min=angles[0],
        angle_increment=angles[1],
        range_min=limits[0],
        range_max=limits[1],
        mount=Pose2(x=pose[0], y=pose[1], theta=pose[2]),
        upside_down=upside_down,
    )
    published = scans(ingest.handle(received(message)))
    assert len(published) + sum(aside(ingest).values()) == 1
    for scan in published:
        got = np.array(scan.ranges[:], dtype=np.float32)
        assert scan.angle_increment > 0
        assert -math.pi <= scan.angle_min < math.pi
        finite = got[np.isfinite(got)]
        assert not np.isneginf(got).any()
        assert (finite > 0).all()
        # on a grid, the chord between two beams may lie a little nearer than both
        assert (finite >= np.float32(scan.range_min) * (0.9 if angle_step else 1.0)).all()
        assert scan.range_max == 0 or (finite <= np.float32(scan.range_max)).all()


def test_the_same_input_gives_the_same_bytes() -> None:
    rng = np.random.default_rng(1)
    messages = [raw(n * SECOND, ranges=rng.uniform(0, 40, 400).tolist()) for n in range(1, 20)]
    outputs = []
    for _ in range(2):
        ingest = core(angle_step=0.5)
        outputs.append([s.SerializeToString() for m in messages for s in scans(ingest.handle(received(m)))])
    assert outputs[0] == outputs[1]
    assert Counter(map(bool, outputs[0])) == {True: 19}


def test_settings_are_read_from_flags() -> None:
    flags = ["--angle-step", "0.5", "--mounts", '{"front": {"x": 0.2, "yaw": 180}}', "--range-max", "25"]
    settings = load(ScanIngestOptions, "scan-ingest", flags)
    assert settings.angle_step == 0.5
    assert settings.mounts["front"].yaw == 180.0
    assert settings.range_max == 25.0


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["--angle-step", "0"], "--angle-step = '0'"),
        (["--mounts", '{"front": {"z": 1}}'], r"mounts\.front\.z"),
        (["--mounts", '{"/scan": {"x": 1}}'], "'/scan' is no lidar's name: give the last part of its key"),
        (["--mounts", '{"": {"x": 1}}'], "'' is no lidar's name"),
        (["--mounts", '{"front": {"x": 200}}'], r"front\.x = 200: must be within 20 m: is it in millimetres"),
        (["--mounts", '{"front": {"y": -200}}'], r"front\.y = -200: must be within 20 m"),
        (
            ["--mounts", '{"front": {"x": true}}'],
            r"mounts\.front\.x = True: must be a number, not true",
        ),
        (["--range-min", "5", "--range-max", "2"], "range_min = 5.0 must be below range_max = 2.0"),
    ],
)
def test_settings_that_do_not_hold_are_named(flags: list[str], named: str) -> None:
    with pytest.raises(SettingsError, match=named):
        load(ScanIngestOptions, "scan-ingest", flags)


def test_lidars_without_end_are_served_and_those_that_are_gone_forgotten(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(recently_used, "AMONG", 100)
    ingest = core()
    first = received(raw(), robot="first")
    assert [scan.sequence for scan in scans(ingest.handle(first))] == [0]
    assert scans(ingest.handle(first)) == []  # the same stamp again
    for number in range(10_000):
        assert len(scans(ingest.handle(received(raw(), robot=f"r{number}")))) == 1
    assert [scan.sequence for scan in scans(ingest.handle(first))] == [0]
    assert ingest.condition().counters["lidars"] == 10_002
