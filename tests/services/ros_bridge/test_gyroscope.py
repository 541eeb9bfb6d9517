"""sensor_msgs/Imu becomes a heading: a sum of its yaw rate about the base's upward axis."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.core import RosBridgeCore
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.heading_pb2 import Heading
from eigenscan.schemas.health_pb2 import Health

from tests.services.ros_bridge.test_core import TIME, core, header, listen, odometry, scan, transform, vector

LEVEL = (0.0, 0.0, 0.0, 1.0)
STEP = 10_000_000


def imu(rate: tuple[float, float, float], time: int, stated: float = 0.0) -> bytes:
    at_rest = cdr.make("geometry_msgs/msg/Quaternion", *LEVEL)
    covariance = np.zeros(9)
    covariance[0] = stated
    return cdr.encode(
        cdr.make(
            cdr.IMU, header("imu", time), at_rest, np.zeros(9), vector(*rate), covariance,
            vector(0.0, 0.0, 9.81), np.zeros(9),
        )
    )  # fmt: skip


def bridge(turned: tuple[float, ...] = LEVEL, **settings: Any) -> RosBridgeCore:
    made = core(imu="imu/data", **settings)
    listen(made, "%odom", odometry(0, 0, 0))
    listen(made, "%tf_static", transform("base_link", "imu", (0.1, 0.0, 0.2), turned))
    return made


def play(
    made: RosBridgeCore, rate: tuple[float, float, float], count: int, first: int = TIME
) -> list[Heading]:
    published = [
        each for n in range(count) for each in listen(made, "%imu%data", imu(rate, first + n * STEP))
    ]  # fmt: skip
    return [each.open(Heading) for each in published]


def test_a_steady_turn_is_summed_and_published_at_the_rate_of_odometry() -> None:
    headings = play(bridge(), (0.0, 0.0, 0.5), 101)
    assert headings[0].heading == 0.0
    assert headings[-1].heading == pytest.approx(0.5)  # rad, after a second
    assert len(headings) == 51  # of 100 Hz every second one
    assert {nanoseconds(each.since) for each in headings} == {TIME}
    assert nanoseconds(headings[-1].timestamp) == TIME + 1_000_000_000


@pytest.mark.parametrize(
    ("turned", "rate"),
    [
        ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -0.5)),  # head down
        ((np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)), (0.0, 0.5, 0.0)),  # on its side: its y axis points up
    ],
)
def test_it_turns_about_the_bases_axis_however_it_is_mounted(
    turned: tuple[float, ...], rate: tuple[float, float, float]
) -> None:
    assert play(bridge(turned), rate, 101)[-1].heading == pytest.approx(0.5)


def test_what_is_no_rate_is_counted_and_a_gap_begins_a_new_sum() -> None:
    made = bridge()
    play(made, (0.0, 0.0, 0.5), 11)
    later = TIME + 100 * STEP
    assert not listen(made, "%imu%data", imu((0.0, 0.0, np.nan), later))
    assert not listen(made, "%imu%data", imu((0.0, 0.0, 1e308), later))
    assert not listen(made, "%imu%data", imu((0.0, 0.0, 1.0), later, stated=-1.0))
    (first,) = play(made, (0.0, 0.0, 0.5), 1, later)
    assert (first.heading, nanoseconds(first.since)) == (0.0, later)
    assert not listen(made, "%imu%data", imu((0.0, 0.0, 0.5), later))
    assert not listen(made, "%imu%data", b"no imu")
    counters = made.condition().counters
    assert {name: counters[name] for name in counters if "imu" in name or "cdr" in name} == {
        "set_aside_imu_not_finite": 2,
        "set_aside_imu_without_rate": 1,
        "set_aside_imu_repeated": 1,
        "set_aside_not_cdr": 1,
        "imu_gap": 1,
    }


def test_without_its_mount_it_is_left_out_and_health_names_the_frame() -> None:
    made = core(imu="imu/data", mounts_from_tf=True)
    listen(made, "%odom", odometry(0, 0, 0))
    listen(made, "%tf_static", transform("base_link", "laser", (0.1, 0.0, 0.2), LEVEL))
    assert not play(made, (0.0, 0.0, 0.5), 3)
    listen(made, "%scan", scan())
    condition = made.condition()
    assert condition.status == Health.STATUS_OK  # scans come
    assert "no transform from base_link to imu" in condition.detail
    assert condition.counters["set_aside_imu_no_mount"] == 3


def test_without_the_setting_there_is_no_such_endpoint() -> None:
    with pytest.raises(KeyError):
        listen(core(), "%imu%data", imu((0.0, 0.0, 0.5), TIME))
