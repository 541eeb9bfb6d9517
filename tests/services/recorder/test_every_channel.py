"""Every channel of the contract reaches Rerun, in a form that states what is in it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import rerun as rr
from eigenscan.geometry.pose import compose, to_message, to_pose3
from eigenscan.recorder.picture.drawing import Picture
from eigenscan.recorder.picture.layout import Layout
from eigenscan.schemas.channels import (
    ADVICE,
    CHANNELS,
    HEADING,
    HEALTH,
    HYPOTHESES,
    LIDAR_KIND,
    MAP,
    MODEL,
    MODEL_SET,
    OBSTACLES,
    ODOMETRY,
    POSE,
    RELOCATION,
    SCAN,
    SCAN_MOTION,
    SCAN_RAW,
    SEARCH,
    SPACE,
    TRACKS,
    TRANSFORM,
    TRUTH,
    Channel,
)
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.geometry_pb2 import Covariance3, Pose2
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.scan_pb2 import RawScan, ScanMotion
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Relocation
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

from tests.services.recorder.test_picture import ADDRESS, S, draw, entities, rows
from tests.services.recorder.traffic import Site

DEAR = {SCAN_RAW, TRANSFORM}
SEEN_AS: dict[Channel, str] = {
    SCAN_RAW: "/raw/r1/front",
    SCAN: "/world/robots/r1/scan/front",
    SCAN_MOTION: "/motion/speed/r1/scans_of_front",
    ODOMETRY: "/motion/speed/r1/odometry",
    HEADING: "/motion/turn/r1/gyroscope",
    HYPOTHESES: "/world/robots/r1/hypotheses/front/0",
    SEARCH: "/world/robots/r1/search/front",
    OBSTACLES: "/world/robots/r1/obstacles/front",
    POSE: "/world/robots/r1/pose",
    TRACKS: "/world/robots/r1/tracks",
    ADVICE: "/world/robots/r1/advice",
    TRANSFORM: "/frames/r1/map/odom",
    TRUTH: "/world/robots/r1/truth",
    RELOCATION: "/world/robots/r1/relocation",
    MAP: "/world/map",
    MODEL: "/world/regions/hallway",
    MODEL_SET: "/models",
    LIDAR_KIND: "/events/lidar_kinds",
    SPACE: "/events/spaces",
    HEALTH: "/events/tracker",
}
"""An entity that is there because of this channel and no other."""


def picture(layout: Layout, draw_all: bool) -> Picture:
    return Picture(rr.RecordingStream("test"), 10.0, layout, None, live=False, draw_all=draw_all)


@pytest.mark.parametrize("layout", get_args(Layout))
def test_no_channel_of_the_table_is_forgotten(layout: Layout) -> None:
    assert picture(layout, draw_all=True).channels == set(CHANNELS)


@pytest.mark.parametrize("layout", [one for one in get_args(Layout) if one != "fleet"])
def test_what_is_cheap_is_drawn_unasked(layout: Layout) -> None:
    assert picture(layout, draw_all=False).channels == set(CHANNELS) - DEAR


@pytest.fixture(scope="module")
def traffic() -> list[Envelope]:
    return list(Site("s", seconds=3.0).messages())


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, traffic: list[Envelope]) -> set[str]:
    path = tmp_path_factory.mktemp("whole") / "a.rrd"
    draw(path, traffic, draw_all=True)
    return entities(path)


@pytest.mark.parametrize("channel", CHANNELS, ids=lambda channel: channel.name)
def test_each_channel_is_seen(
    tmp_path: Path, traffic: list[Envelope], whole: set[str], channel: Channel
) -> None:
    draw(tmp_path / "a.rrd", (one for one in traffic if one.channel is not channel), draw_all=True)
    without = entities(tmp_path / "a.rrd")
    assert SEEN_AS[channel] in whole - without


def test_odometry_and_scans_show_the_speed_on_one_axis(tmp_path: Path) -> None:
    """Driven backwards at 0.5 m/s in a curve of 20 degrees/s; odometry every 20 ms, scans every 200 ms."""
    step = np.array([-0.5 * 0.02, 0.0, math.radians(20.0) * 0.02])
    pose, published = np.array([3.0, -2.0, 2.0]), []
    for tick in range(100):
        at = stamp(S + tick * S // 50)
        published.append(Envelope(ODOMETRY, ADDRESS, Odometry(timestamp=at, pose=to_pose3(pose))))
        pose = compose(pose, step)
    motion = np.zeros(3)
    for _ in range(10):
        motion = compose(motion, step)
    for scan in range(1, 10):
        at, since = stamp(S + scan * S // 5), stamp(S + (scan - 1) * S // 5)
        moved = ScanMotion(timestamp=at, since=since, motion=to_message(motion))
        published.append(Envelope(SCAN_MOTION, ADDRESS, moved))
    unfit = ScanMotion(timestamp=stamp(4 * S), since=stamp(3 * S))
    draw(tmp_path / "a.rrd", [*published, Envelope(SCAN_MOTION, ADDRESS, unfit)])

    def values(entity: str) -> list[float]:
        return [row[0] for _, row in rows(tmp_path / "a.rrd", entity, "Scalars:scalars")]

    for source in ("odometry", "scans_of_front"):
        speed, turn = values(f"/motion/speed/r1/{source}"), values(f"/motion/turn/r1/{source}")
        assert len(speed) >= 9
        if source != "odometry":  # what does not fit is a gap, no speed of 0
            assert math.isnan(speed.pop())
            assert math.isnan(turn.pop())
        assert speed == pytest.approx([-0.5] * len(speed), rel=2e-3)
        assert turn == pytest.approx([20.0] * len(turn), rel=1e-6)


def test_a_raw_scan_is_drawn_in_the_robots_frame_with_what_is_out_of_limits_apart(tmp_path: Path) -> None:
    raw = RawScan(
        timestamp=stamp(S),
        mount=Pose2(x=0.5, y=0.0, theta=math.pi / 2),
        upside_down=True,
        angle_min=math.pi / 2,
        angle_increment=-math.pi / 2,
        range_min=0.5,
        range_max=10.0,
        ranges=[2.0, 0.1, 12.0, math.nan, math.inf, 0.0],
    )
    draw(tmp_path / "a.rrd", [Envelope(SCAN_RAW, ADDRESS, raw)], draw_all=True)
    ((_, points),) = rows(tmp_path / "a.rrd", "/raw/r1/front", "Points3D:positions")
    # upside down: angles -90, 0, 90 degrees in the sensor, whose forward is the robot's left
    assert np.array(points)[:, :2] == pytest.approx(
        np.array([[2.5, 0.0], [0.5, 0.1], [-11.5, 0.0]]), abs=1e-5
    )
    ((_, colours),) = rows(tmp_path / "a.rrd", "/raw/r1/front", "Points3D:colors")
    assert colours[1] == colours[2] != colours[0]


def test_frames_hang_below_their_parents(tmp_path: Path) -> None:
    def moved(parent: str, child: str, x: float) -> Envelope:
        message = FrameTransform(timestamp=stamp(S), parent_frame_id=parent, child_frame_id=child)
        message.translation.x, message.rotation.w = x, 1.0
        return Envelope(TRANSFORM, ADDRESS, message)

    published = [moved("map", "odom", 1.0), moved("odom", "base link", 2.0), moved("base link", "map", 3.0)]
    draw(tmp_path / "a.rrd", published, draw_all=True)
    ((_, (translation,)),) = rows(
        tmp_path / "a.rrd", "/frames/r1/map/odom/base\\ link", "Transform3D:translation"
    )
    assert translation == [2.0, 0.0, 0.0]
    assert "/frames/r1/map/odom" in entities(tmp_path / "a.rrd")


def test_a_robot_that_is_relocated_is_shown_with_it_until_it_is_to_search(tmp_path: Path) -> None:
    reported = Relocation(
        timestamp=stamp(S), pose=Pose2(x=4.0, y=1.0, theta=0.0), covariance=Covariance3(xx=0.25)
    )
    again = Relocation(timestamp=stamp(2 * S))
    draw(tmp_path / "a.rrd", [Envelope(RELOCATION, ADDRESS, one) for one in (reported, again)])
    ((at, strips),) = [
        row
        for row in rows(tmp_path / "a.rrd", "/world/robots/r1/relocation", "LineStrips3D:strips")
        if row[1]
    ]
    assert at == S
    arrow, outline = np.array(strips[0]), np.array(strips[1])
    assert arrow[0, :2] == pytest.approx([4.0, 1.0])
    assert np.ptp(outline[:, 0]) == pytest.approx(2 * 0.5 * math.sqrt(5.991), rel=1e-2)
    texts = [text for _, (text,) in rows(tmp_path / "a.rrd", "/events/r1", "TextLog:text")]
    assert texts == ["r1: relocated to 4.00, 1.00, 0 deg", "r1: relocated: search the whole site"]


def test_the_models_in_use_are_a_page_with_their_floors_on_the_map(tmp_path: Path) -> None:
    published = ModelSet(version="abcdef0123456789", map_version="fedcba", frame_id="map", free_area_m2=812.4)
    published.entries.add(region="r01", version="0123456789abcdef", size=51_000)
    published.floors.add(name="first floor", outline_x=[0.0, 9.0, 9.0, 0.0], outline_y=[0.0, 0.0, 5.0, 5.0])
    draw(tmp_path / "a.rrd", [Envelope(MODEL_SET, ADDRESS, published)])
    ((_, (page,)),) = rows(tmp_path / "a.rrd", "/models", "TextDocument:text")
    for words in ("abcdef012345", "812 m²", "first floor", "| r01 | 0123456789ab | 51 |"):
        assert words in page
    ((_, (strip,)),) = rows(tmp_path / "a.rrd", "/world/floors/first\\ floor", "LineStrips3D:strips")
    assert np.array(strip)[2, :2] == pytest.approx([9.0, 5.0])


def test_a_pose_is_labelled_with_its_floor(tmp_path: Path) -> None:
    pose = PoseEstimate(
        timestamp=stamp(S), state=STATE_LOCALIZED, confidence=0.97, track_id=1, floor="first floor"
    )
    draw(tmp_path / "a.rrd", [Envelope(POSE, ADDRESS, pose)])
    labels = [
        row for _, row in rows(tmp_path / "a.rrd", "/world/robots/r1/pose/label", "Points3D:labels") if row
    ]
    assert labels[-1] == ["r1: LOCALIZED 97% first floor"]
