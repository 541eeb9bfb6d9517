"""A scan of a cloud's level slice, by clouds of known walls; clouds that are none are counted and named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.pose import Array
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.core import RosBridgeCore
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.scan_pb2 import RawScan

from tests.services.ros_bridge.test_core import core, header, listen, transform

HALF = float(np.sqrt(0.5))


def cloud(
    points: Any,
    frame: str = "os_lidar",
    *,
    kind: str = "<f4",
    width: int | None = None,
    padding: int = 0,
    **changed: Any,
) -> bytes:
    """PointCloud2 of points (N, 3): coordinates behind an intensity, `padding` bytes at each row's end."""
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    columns = width or max(len(points), 1)
    width = columns if width is None else width
    size = np.dtype(kind).itemsize
    layout = np.dtype(
        {
            "names": [*"xyz"],
            "formats": 3 * [kind],
            "offsets": [4, 4 + size, 4 + 2 * size],
            "itemsize": 4 + 3 * size,
        }
    )
    packed = np.zeros(len(points), dtype=layout)
    for axis, name in enumerate("xyz"):
        packed[name] = points[:, axis]
    rows = packed.reshape(-1, columns).view(np.uint8).reshape(-1, columns * layout.itemsize)
    data = np.pad(rows, ((0, 0), (0, padding)))
    number = {"f4": 7, "f8": 8}[kind[1:]]
    fields = [
        cdr.make("sensor_msgs/msg/PointField", name, offset, number, 1)
        for name, offset in zip("xyz", (4, 4 + size, 4 + 2 * size), strict=True)
    ]
    content: dict[str, Any] = {
        "header": header(frame), "height": data.shape[0], "width": width, "fields": fields,
        "is_bigendian": kind[0] == ">", "point_step": layout.itemsize, "row_step": data.shape[1],
        "data": data.ravel(), "is_dense": False,
    }  # fmt: skip
    return cdr.encode(cdr.make(cdr.POINT_CLOUD, *(content | changed).values()))


def bridge(**settings: Any) -> RosBridgeCore:
    """One whose 3D lidar is 0.5 m up and 0.2 m forward, level."""
    made = core(points=["front/points"], base_frame="base_link", **settings)
    listen(made, "%tf_static", transform("base_link", "os_lidar", (0.2, 0.0, 0.5), (0, 0, 0, 1)))
    return made


def scanned(made: RosBridgeCore, data: bytes) -> RawScan:
    (output,) = listen(made, "%front%points", data)
    assert output.address["lidar"] == "front"
    return output.open(RawScan)


def seen(message: RawScan) -> Array:
    """The points (N, 2) that the scan shows, in the base's frame."""
    ranges = np.array(message.ranges)
    angles = message.angle_min + message.angle_increment * np.arange(len(ranges)) + message.mount.theta
    points = np.stack([np.cos(angles), np.sin(angles)], axis=1) * ranges[:, None]
    points += [message.mount.x, message.mount.y]
    return np.asarray(points[np.isfinite(ranges)])


WALL = [(3.0, 1.0, -0.2), (3.0, 1.0, 0.9), (4.0, 1.3333333, -0.2), (-2.0, 0.0, 0.0)]
"""A wall's foot, the same wall above the slice, one hidden behind it, and one at the back."""


@pytest.mark.parametrize("kind", ["<f4", ">f4", "<f8"])
def test_the_nearest_point_in_the_slice_counts(kind: str) -> None:
    message = scanned(bridge(), cloud(WALL, kind=kind))
    found = seen(message)
    # 0.5 deg a beam: 14 mm at 3.2 m
    assert np.sort(found, axis=0) == pytest.approx(np.array([[-1.8, 0.0], [3.2, 1.0]]), abs=0.02)
    assert np.isnan(message.ranges).sum() == len(message.ranges) - 2  # unknown, not empty


def test_rows_may_be_padded() -> None:
    padded = scanned(bridge(), cloud(WALL, width=2, padding=5))
    assert np.array_equal(padded.ranges, scanned(bridge(), cloud(WALL)).ranges, equal_nan=True)


def test_a_tilted_sensor_may_have_a_cloud() -> None:
    """A depth camera that looks down by 90 deg: its x axis is the base's -z."""
    made = core(points=["front/points"], base_frame="base_link")
    listen(made, "%tf_static", transform("base_link", "os_lidar", (0.0, 0.0, 2.0), (0.0, HALF, 0.0, HALF)))
    found = seen(scanned(made, cloud([(1.7, 0.5, 3.0), (0.1, 0.5, 2.0)])))
    assert found == pytest.approx(np.array([[3.0, 0.5]]), abs=0.02)


def test_the_slice_is_a_setting() -> None:
    found = seen(scanned(bridge(slice_low=1.2, slice_high=1.6), cloud(WALL)))
    assert found == pytest.approx(np.array([[3.2, 1.0]]), abs=0.02)


def test_points_that_are_not_finite_are_counted_and_the_others_count() -> None:
    made = bridge()
    nowhere = [(np.nan, 0.0, 0.0), (np.inf, 0.0, 0.0)]
    assert len(seen(scanned(made, cloud(nowhere + WALL)))) == 2
    assert made.condition().counters["cloud_points_not_finite"] == 2
    assert made.condition().status == Health.STATUS_OK


FIELD = "sensor_msgs/msg/PointField"
NO_Z = [cdr.make(FIELD, "x", 4, 7, 1), cdr.make(FIELD, "y", 8, 7, 1)]
INTEGERS = [cdr.make(FIELD, name, 4 * at, 5, 1) for at, name in enumerate("xyz")]
BEHIND = [cdr.make(FIELD, name, 4 * at + 6, 7, 1) for at, name in enumerate("xyz")]


@pytest.mark.parametrize(
    ("data", "reason", "part"),
    [
        (cloud(WALL, fields=NO_Z), "not_a_cloud", "float fields x, y and z"),
        (cloud(WALL, fields=INTEGERS), "not_a_cloud", "float fields x, y and z"),
        (cloud(WALL, fields=BEHIND), "not_a_cloud", "points of 16 bytes"),
        (cloud(WALL, width=4, row_step=60), "not_a_cloud", "64 bytes for 1 rows of 60"),
        (cloud(WALL, height=2**31, row_step=2**31), "not_a_cloud", "64 bytes for"),
        (cloud(WALL, point_step=0), "not_a_cloud", "points of 0 bytes"),
        (cloud(WALL, width=0, point_step=2**32 - 1), "not_a_cloud", "0 points of 4294967295 bytes"),
        (cloud([]), "not_a_cloud", "0 bytes"),
        (cloud([(np.nan, 1.0, 0.0)]), "cloud_without_points", "set slice_low and slice_high"),
        (cloud([(1.0, 1.0, 5.0)]), "cloud_without_points", "0.1 to 0.6 m above the base"),
        (cloud(WALL, frame="elsewhere"), "no_mount", "no transform from base_link to elsewhere"),
        (b"\0\1\0\0\7", "not_cdr", ""),
    ],
)
def test_a_cloud_that_gives_no_scan_is_counted_and_named(data: bytes, reason: str, part: str) -> None:
    made = bridge()
    assert listen(made, "%front%points", data) == []
    condition = made.condition()
    assert condition.counters[f"set_aside_{reason}"] == 1
    assert part in condition.detail
    assert condition.status == Health.STATUS_WAITING
    assert len(seen(scanned(made, cloud(WALL)))) == 2
    assert made.condition().status == Health.STATUS_OK


def test_a_slice_has_a_height() -> None:
    with pytest.raises(ValueError, match=r"slice_high = 0\.2 is not above slice_low = 0\.4"):
        core(slice_low=0.4, slice_high=0.2)
