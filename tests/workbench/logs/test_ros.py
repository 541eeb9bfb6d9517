from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from eigenscan.geometry.pose import from_message, from_pose3
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.logs import LogError, LogOptions, Mount, open_log
from eigenscan.workbench.logs.remarks import remarks
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

S = 1_000_000_000
START = 1_600_000_000

SCAN = "sensor_msgs/msg/LaserScan"
CLOUD = "sensor_msgs/msg/PointCloud2"
MULTI_ECHO = "sensor_msgs/msg/MultiEchoLaserScan"
ODOM = "nav_msgs/msg/Odometry"
TF = "tf2_msgs/msg/TFMessage"

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
ROS2 = get_typestore(Stores.ROS2_HUMBLE)


@dataclass
class Story:
    """What happens on a robot: written to any kind of bag."""

    ros1: bool
    messages: list[tuple[str, str, float, Any]] = field(default_factory=list)
    clock: Callable[[float], float] = float  # what it shows, of robot and recorder alike

    @property
    def store(self) -> Any:
        return ROS1 if self.ros1 else ROS2

    def kind(self, name: str) -> Any:
        return self.store.types[name]

    def header(self, stamp: float, frame: str) -> Any:
        nanoseconds = round(self.clock(stamp) * 1e9)
        time = self.kind("builtin_interfaces/msg/Time")(nanoseconds // S, nanoseconds % S)
        extra = {"seq": 0} if self.ros1 else {}
        return self.kind("std_msgs/msg/Header")(stamp=time, frame_id=frame, **extra)

    def scan(
        self,
        topic: str,
        recorded: float,
        frame: str,
        stamp: float | None = None,
        beams: int = 5,
        **fields: Any,
    ) -> None:
        given = {
            "angle_min": -1.0,
            "angle_max": 1.0,
            "angle_increment": 2.0 / (beams - 1),
            "time_increment": 0.0,
            "scan_time": 0.1,
            "range_min": 0.1,
            "range_max": 10.0,
            "ranges": np.arange(1, 6, dtype=np.float32),
            "intensities": np.zeros(0, dtype=np.float32),
            **fields,
        }
        header = self.header(recorded if stamp is None else stamp, frame)
        self.messages.append((topic, SCAN, recorded, self.kind(SCAN)(header=header, **given)))

    def odometry(
        self,
        topic: str,
        recorded: float,
        x: float,
        yaw: float = 0.0,
        child: str = "base_link",
        stamp: float | None = None,
    ) -> None:
        point, turn = self.kind("geometry_msgs/msg/Point"), self.kind("geometry_msgs/msg/Quaternion")
        vector, twist = self.kind("geometry_msgs/msg/Vector3"), self.kind("geometry_msgs/msg/Twist")
        pose = self.kind("geometry_msgs/msg/Pose")(point(x, 0.0, 0.0), turn(*rotation(yaw)))
        covariance = np.zeros(36)
        covariance[0] = 0.01
        message = self.kind(ODOM)(
            header=self.header(recorded if stamp is None else stamp, "odom"),
            child_frame_id=child,
            pose=self.kind("geometry_msgs/msg/PoseWithCovariance")(pose, covariance),
            twist=self.kind("geometry_msgs/msg/TwistWithCovariance")(
                twist(vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0)), np.zeros(36)
            ),
        )
        self.messages.append((topic, ODOM, recorded, message))

    def transform(
        self,
        recorded: float,
        parent: str,
        child: str,
        at: tuple[float, float, float] = (0, 0, 0),
        rpy: tuple[float, float, float] = (0, 0, 0),
        stamp: float | None = None,
        topic: str = "/tf",
    ) -> None:
        vector, turn = self.kind("geometry_msgs/msg/Vector3"), self.kind("geometry_msgs/msg/Quaternion")
        body = self.kind("geometry_msgs/msg/Transform")(
            vector(*map(float, at)), turn(*rotation(rpy[2], *rpy[:2]))
        )
        item = self.kind("geometry_msgs/msg/TransformStamped")(
            self.header(recorded if stamp is None else stamp, parent), child, body
        )
        self.messages.append((topic, TF, recorded, self.kind(TF)([item])))

    def write(self, path: Path, storage: StoragePlugin = StoragePlugin.SQLITE3, pack: Any = None) -> Path:
        writer = Writer1(path) if self.ros1 else Writer2(path, version=9, storage_plugin=storage)
        if isinstance(writer, Writer1):
            writer.chunk_threshold = 50_000
            if pack is not None:
                writer.set_compression(pack)
        elif pack is not None:
            writer.set_compression(CompressionMode[pack.upper()], CompressionFormat.ZSTD)
        with writer:
            known: dict[str, Any] = {}
            for topic, kind, recorded, message in sorted(self.messages, key=lambda item: item[2]):
                if topic not in known:
                    known[topic] = writer.add_connection(topic, kind, typestore=self.store)
                serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
                writer.write(known[topic], round(self.clock(recorded) * 1e9), serialize(message, kind))
        return path


def rotation(yaw: float, roll: float = 0.0, pitch: float = 0.0) -> list[float]:
    quaternion: list[float] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat().tolist()
    return quaternion


Write = Callable[[Story, Path], Path]
CONTAINERS: dict[str, tuple[bool, Write]] = {
    "ros1": (True, lambda story, folder: story.write(folder / "a.bag")),
    "sqlite": (False, lambda story, folder: story.write(folder / "a")),
    "sqlite file": (False, lambda story, folder: story.write(folder / "a") / "a.db3"),
    "mcap": (False, lambda story, folder: story.write(folder / "a", StoragePlugin.MCAP)),
    "mcap compressed": (False, lambda story, folder: story.write(folder / "a", StoragePlugin.MCAP, "file")),
    "mcap of compressed messages": (
        False,
        lambda story, folder: story.write(folder / "a", StoragePlugin.MCAP, "message"),
    ),
    "mcap compressed file": (
        False,
        lambda story, folder: story.write(folder / "a", StoragePlugin.MCAP, "file") / "a.mcap.zstd",
    ),
    "mcap file": (False, lambda story, folder: story.write(folder / "a", StoragePlugin.MCAP) / "a.mcap"),
}


def usual(ros1: bool, seconds: int = 3) -> Story:
    """A robot with a lidar ahead and one upside down behind, that drives 1 m/s."""
    story = Story(ros1)
    story.transform(START, "base_footprint", "base_link", (0, 0, 0.1), topic="/tf_static")
    story.transform(START, "/base_link", "/front", (0.3, 0, 0.2), (0, 0, 0.1), topic="/tf_static")
    story.transform(START, "base_link", "rear", (-0.3, 0.1, 0.2), (math.pi, 0, 3.0), topic="/tf_static")
    for tenth in range(10 * seconds):
        time = START + tenth / 10
        story.odometry("/odom", time + 0.02, tenth / 10, 0.5, stamp=time)
        story.scan("/front/scan", time + 0.08, "front", stamp=time)
        story.scan("/rear/scan", time + 0.09, "/rear", stamp=time + 0.03)
    return story


def read(path: Path, **options: Any) -> tuple[dict[str, list[RawScan]], list[Odometry], dict[str, int]]:
    log = open_log(path, LogOptions(**options))
    received = list(log.envelopes())
    stamps = [envelope.stamp for envelope in received]
    assert stamps == sorted(stamps)
    assert log.progress == 1.0
    scans: dict[str, list[RawScan]] = {}
    for envelope in received:
        if envelope.channel is SCAN_RAW:
            scans.setdefault(envelope.address["lidar"], []).append(envelope.open(RawScan))
    moved = [envelope.open(Odometry) for envelope in received if envelope.channel is ODOMETRY]
    return scans, moved, {name: count for name, count in log.counters.items() if count}


@pytest.mark.parametrize("container", CONTAINERS)
def test_every_container_gives_the_same(tmp_path: Path, container: str) -> None:
    ros1, write = CONTAINERS[container]
    scans, moved, counters = read(write(usual(ros1), tmp_path))
    assert counters == {}
    assert {name: len(found) for name, found in scans.items()} == {"front": 30, "rear": 30}
    front, rear = scans["front"][7], scans["rear"][7]
    np.testing.assert_allclose(from_message(front.mount), [0.3, 0.0, 0.1], atol=1e-9)
    np.testing.assert_allclose(from_message(rear.mount), [-0.3, 0.1, 3.0], atol=1e-9)
    assert (front.upside_down, rear.upside_down) == (False, True)
    assert (front.frame_id, rear.frame_id) == ("front", "rear")
    assert front.timestamp.ToNanoseconds() == START * S + 700_000_000
    assert (front.angle_min, front.angle_increment) == (-1.0, 0.5)
    assert (front.range_min, front.range_max) == (pytest.approx(0.1), 10.0)
    assert list(front.ranges) == [1, 2, 3, 4, 5]
    assert len(moved) == 30
    np.testing.assert_allclose(from_pose3(moved[7].pose), [0.7, 0.0, 0.5], atol=1e-9)
    assert moved[7].timestamp.ToNanoseconds() == START * S + 700_000_000
    assert moved[7].pose_covariance[0] == 0.01


def test_an_upside_down_beam_points_where_tf_states(tmp_path: Path) -> None:
    """The beam's direction by the rotation matrix, and by the plane pose with its flag."""
    scan = read(usual(False).write(tmp_path / "a"), lidars=("rear",))[0]["rear"][0]
    full = Rotation.from_euler("ZYX", [3.0, 0.0, math.pi])
    for number in range(5):
        angle = scan.angle_min + number * scan.angle_increment
        expected = full.apply([math.cos(angle), math.sin(angle), 0.0])
        plane = scan.mount.theta + (-angle if scan.upside_down else angle)
        np.testing.assert_allclose([math.cos(plane), math.sin(plane)], expected[:2], atol=1e-9)


@pytest.mark.parametrize("ros1", [True, False])
def test_without_odometry_messages_tf_gives_it(tmp_path: Path, ros1: bool) -> None:
    story = Story(ros1)
    for tenth in range(20):
        time = START + tenth / 10
        story.transform(time, "odom", "base_footprint", (tenth, 0, 0), (0, 0, 0.2))
        story.transform(time, "odom", "something", (9, 9, 0))
        story.transform(time, "map", "odom", (5, 5, 0))
        story.transform(time, "base_footprint", "laser", (0.1, 0, 0.5))
        story.scan("/scan", time + 0.01, "laser")
    scans, moved, counters = read(story.write(tmp_path / ("a.bag" if ros1 else "a")))
    assert counters == {}
    assert len(scans["scan"]) == 20
    np.testing.assert_allclose(from_message(scans["scan"][0].mount), [0.1, 0, 0])
    assert [round(m.pose.position.x) for m in moved] == list(range(20))


@pytest.mark.parametrize(
    ("odom", "base"),
    [
        ("robot_0/odom", "robot_0/base_link"),
        ("odom_combined", "base_footprint"),
        ("/odom", "/base_link"),
        ("wheel_odom", "base"),
    ],
)
def test_frames_may_have_other_names(tmp_path: Path, odom: str, base: str) -> None:
    story = Story(True)
    for tenth in range(20):
        time = START + tenth / 10
        story.transform(time, "map", odom, (5, 5, 0))
        story.transform(time, odom, base, (tenth, 0, 0), (0, 0, 0.2))
        story.transform(time, base, "laser", (0.1, 0, 0.5))
        story.scan("/scan", time + 0.01, "laser")
    scans, moved, counters = read(story.write(tmp_path / "a.bag"))
    assert counters == {}
    np.testing.assert_allclose(from_message(scans["scan"][0].mount), [0.1, 0, 0])
    assert [round(m.pose.position.x) for m in moved] == list(range(20))


def test_truth_is_not_taken_for_odometry(tmp_path: Path) -> None:
    story = usual(False)
    for tenth in range(30):
        story.odometry("/base_pose_ground_truth", START + tenth / 10, 77.0)
    _, moved, _ = read(story.write(tmp_path / "a"))
    assert max(m.pose.position.x for m in moved) < 3.0
    _, asked, _ = read(tmp_path / "a", odometry="/base_pose_ground_truth")
    assert min(m.pose.position.x for m in asked) == 77.0


def test_a_filtered_copy_of_a_scan_is_not_a_second_lidar(tmp_path: Path) -> None:
    story = usual(False)
    for tenth in range(30):
        story.scan("/front/scan_filtered", START + tenth / 10 + 0.085, "front", stamp=START + tenth / 10)
    scans, _, counters = read(story.write(tmp_path / "a"))
    assert set(scans) == {"front", "rear"}
    assert counters == {"topics_of_the_same_lidar": 1}


def test_scans_of_another_frame_on_a_lidars_topic_are_set_aside(tmp_path: Path) -> None:
    """Each had the mount of the first one, and a third of the claims was wrong."""
    story = usual(False)
    for tenth in range(30):
        story.scan("/front/scan", START + tenth / 10 + 0.1, "rear")
    scans, _, counters = read(story.write(tmp_path / "a"))
    expected, _, _ = read(usual(False).write(tmp_path / "b"))
    assert len(scans["front"]) == len(expected["front"])
    assert counters == {"scans_of_another_frame": 30}


def test_a_tilted_lidar_and_one_that_tf_places_nowhere_are_left_out(tmp_path: Path) -> None:
    story = usual(False)
    story.transform(START, "base_link", "tilted", (0, 0, 0.2), (0, 0.8, 0))
    for tenth in range(30):
        story.scan("/tilted/scan", START + tenth / 10, "tilted")
        story.scan("/lost/scan", START + tenth / 10, "lost")
    scans, _, counters = read(story.write(tmp_path / "a"))
    assert set(scans) == {"front", "rear"}
    assert counters == {"lidars_tilted": 1, "lidars_off_the_base": 1}
    scans, _, counters = read(tmp_path / "a", lidars=("lost",))
    assert counters == {"lidars_without_mount": 1}
    assert from_message(scans["lost"][0].mount).tolist() == [0, 0, 0]


def test_of_two_robots_in_one_bag_the_lidar_of_the_other_is_left_out(tmp_path: Path) -> None:
    """It was fused at the first robot's origin, and --mount was advised."""
    story = Story(False)
    for robot in ("r1", "r2"):
        story.transform(START, f"{robot}/base_link", f"{robot}/laser", (0.1, 0, 0.2), topic="/tf_static")
        for tenth in range(10):
            story.odometry(f"/{robot}/odom", START + tenth / 10, tenth / 10, child=f"{robot}/base_link")
            story.scan(f"/{robot}/scan", START + tenth / 10, f"{robot}/laser")
    scans, moved, counters = read(story.write(tmp_path / "a"))
    assert (set(scans), len(moved)) == ({"r1"}, 10)
    assert counters == {"lidars_off_the_base": 1}
    (line,) = remarks(counters)
    assert "--lidar-topic and --odometry-topic" in line
    scans, _, counters = read(tmp_path / "a", lidars=("/r2/scan",), odometry="/r2/odom")
    assert (set(scans), counters) == ({"r2"}, {})


def test_a_stated_mount_wins(tmp_path: Path) -> None:
    story = usual(False)
    story.transform(START, "base_link", "tilted", (0, 0, 0.2), (0, 0.8, 0))
    for tenth in range(30):
        story.scan("/tilted/scan", START + tenth / 10, "tilted")
        story.scan("/lost/scan", START + tenth / 10, "lost")
    mounts = {"tilted": Mount(1, 2, 0.3), "lost": Mount(0.1, 0, -1.0, True), "front": Mount(0, 0, 0)}
    scans, _, counters = read(story.write(tmp_path / "a"), mounts=mounts)
    assert counters == {}
    np.testing.assert_allclose(from_message(scans["tilted"][0].mount), [1, 2, 0.3])
    np.testing.assert_allclose(from_message(scans["front"][0].mount), [0, 0, 0])
    assert (scans["lost"][0].upside_down, scans["rear"][0].upside_down) == (True, True)


@pytest.mark.parametrize("ros1", [True, False])
def test_of_several_echoes_the_first_counts(tmp_path: Path, ros1: bool) -> None:
    story = usual(ros1)
    echo, scan = story.kind("sensor_msgs/msg/LaserEcho"), story.kind(MULTI_ECHO)
    for tenth in range(30):
        time = START + tenth / 10
        echoes = [echo(np.array(values, dtype=np.float32)) for values in ([1.0, 4.0], [], [3.0])]
        limits = (-1.0, 1.0, 1.0, 0.0, 0.1, 0.1, 10.0)
        story.messages.append(
            ("/multi", MULTI_ECHO, time, scan(story.header(time, "front2"), *limits, echoes, []))
        )
    story.transform(START, "base_link", "front2", (0.5, 0, 0.2), topic="/tf_static")
    scans, _, _ = read(story.write(tmp_path / ("a.bag" if ros1 else "a")))
    assert list(scans["multi"][0].ranges) == [1.0, math.inf, 3.0]
    assert len(scans["multi"]) == 30


@pytest.mark.parametrize("stamp", [0.0, START - 4000.0])
def test_a_lidar_with_another_clock_gets_the_time_of_recording(tmp_path: Path, stamp: float) -> None:
    story = Story(False)
    for tenth in range(30):
        time = START + tenth / 10
        story.odometry("/odom", time + 0.01, tenth / 10, stamp=time)
        story.scan("/scan", time + 0.05, "laser", stamp=stamp + (tenth / 10 if stamp else 0.0))
    scans, _, counters = read(story.write(tmp_path / "a"))
    times = [scan.timestamp.ToNanoseconds() - START * S for scan in scans["scan"]]
    np.testing.assert_allclose(np.array(times) / S, np.arange(30) / 10 + 0.05, atol=1e-6)
    assert counters["topics_stamped_by_recording"] == 1


@pytest.mark.parametrize(("lag", "after"), [(0.002, 0.08), (0.082, 0.0)])
def test_a_lidar_that_sweeps_states_when_its_first_beam_was_measured(
    tmp_path: Path, lag: float, after: float
) -> None:
    story = Story(False)
    for tenth in range(30):
        time = START + tenth / 10
        story.odometry("/odom", time + 0.01, tenth / 10, stamp=time)
        story.scan("/scan", time + lag, "laser", stamp=time, time_increment=0.02)
    scans, _, _ = read(story.write(tmp_path / "a"))
    assert scans["scan"][7].time_increment == pytest.approx(0.02)
    assert scans["scan"][7].stamped_after == pytest.approx(after)


def test_a_bag_recorded_again_keeps_its_own_time(tmp_path: Path) -> None:
    """All headers are from years before the recording: they agree among themselves, so they count."""
    story = Story(False)
    for tenth in range(30):
        recorded, stamp = START + tenth / 5, 1_000_000_000 + tenth / 10
        story.odometry("/odom", recorded, tenth / 10, stamp=stamp)
        story.scan("/scan", recorded + 0.01, "laser", stamp=stamp)
    scans, _, _ = read(story.write(tmp_path / "a"))
    assert scans["scan"][0].timestamp.ToNanoseconds() == 1_000_000_000 * S
    assert scans["scan"][-1].timestamp.ToNanoseconds() == 1_000_000_000 * S + 2_900_000_000


def at_another_pace(rate: float, pauses_at: int = 100) -> Story:
    """Stamps of a clock that is `rate` times as fast as the recorder's, with a pause of 15 s."""
    story = Story(False)
    story.transform(START, "base_link", "laser", (0.1, 0, 0.2), topic="/tf_static")
    for second in range(60):
        stamp = 5.0 + second + (15.0 if second >= pauses_at else 0.0)
        recorded = START + stamp / rate
        story.odometry("/odom", recorded, second, stamp=stamp)
        story.scan("/scan", recorded + 0.01, "laser", stamp=stamp)
    return story


@pytest.mark.parametrize(
    ("rate", "pauses_at"), [(0.1, 100), (0.1, 30), (0.5, 100), (0.5, 30), (2.0, 100), (2.0, 30), (10.0, 100)]
)
def test_stamps_of_another_pace_than_the_recorders_are_no_strays(
    tmp_path: Path, rate: float, pauses_at: int
) -> None:
    """A simulator at half speed: from 10 s on stamps jumped ahead, and 74 % of the claims were wrong."""
    scans, moved, counters = read(at_another_pace(rate, pauses_at).write(tmp_path / "a"))
    times = [scan.timestamp.ToNanoseconds() / S for scan in scans["scan"]]
    assert times == [5.0 + s + (15.0 if s >= pauses_at else 0.0) for s in range(60)]
    assert (len(moved), counters) == (60, {})


def test_a_stray_stamp_is_put_where_its_topics_pace_has_it(tmp_path: Path) -> None:
    story = at_another_pace(0.5)
    _, _, recorded, _ = story.messages.pop()
    story.scan("/scan", recorded, "laser", stamp=9e8)
    scans, _, counters = read(story.write(tmp_path / "a"))
    assert counters == {"stray_stamps": 1}
    assert scans["scan"][-1].timestamp.ToNanoseconds() / S == pytest.approx(64.0)


def test_a_topic_that_begins_late_is_compared_with_the_others_of_then(tmp_path: Path) -> None:
    """At another pace its clock seemed to be another one, and its headers were given up."""
    story = at_another_pace(0.5)
    story.messages = [each for each in story.messages if each[1] != SCAN or each[2] > START + 60.0]
    scans, _, counters = read(story.write(tmp_path / "a"))
    assert counters == {}
    assert scans["scan"][0].timestamp.ToNanoseconds() / S == 30.0


def test_a_stamp_of_0_is_the_start_of_simulated_time(tmp_path: Path) -> None:
    """For a first stamp of 0 both topics got the times of recording."""
    story = Story(False)
    for tenth in range(30):
        story.odometry("/odom", START + tenth / 10, tenth / 10, stamp=tenth / 10)
        story.scan("/scan", START + tenth / 10 + 0.01, "laser", stamp=tenth / 10 + 0.01)
    scans, moved, counters = read(story.write(tmp_path / "a"))
    assert scans["scan"][0].timestamp.ToNanoseconds() == S // 100
    assert (len(moved), counters["no_stamp"], "topics_stamped_by_recording" in counters) == (29, 1, False)


@pytest.mark.parametrize("container", ["ros1", "sqlite", "sqlite file", "mcap", "mcap file"])
def test_a_clock_that_was_set_back_loses_nothing(tmp_path: Path, container: str) -> None:
    """Of a ROS 1 bag the second half was lost; that of a ROS 2 bag came first."""
    ros1, write = CONTAINERS[container]
    story = Story(ros1, clock=lambda time: time - (3600.0 if time > START + 2.0 else 0.0))
    for tenth in range(60):
        time = START + tenth / 10  # at 2 s an odometry is stamped before and recorded after
        story.scan("/scan", time + 0.03, "laser", stamp=time + 0.02)
        for part in range(5):
            story.odometry("/odom", time + part / 50 + 0.01, tenth / 10, stamp=time + part / 50)
    path = write(story, tmp_path)
    scans, moved, counters = read(path)
    assert counters == {"clock_set_back": 1, "lidars_without_mount": 1, "stray_stamps": 1}
    assert (len(scans["scan"]), len(moved)) == (60, 300)
    times = [scan.timestamp.ToNanoseconds() / S - START for scan in scans["scan"]]
    np.testing.assert_allclose(times, np.arange(60) / 10 + 0.02, atol=1e-6)
    log = open_log(path)
    stamps = [e.stamp for e in log.envelopes() if e.channel is SCAN_RAW]
    logged = [log.logged.get(each, each) / S - START for each in stamps]
    np.testing.assert_allclose(logged[-1], 5.92 - 3600.0, atol=1e-6)


def test_a_clock_that_was_set_ahead_leaves_a_gap_in_all_topics_alike(tmp_path: Path) -> None:
    """Of a robot without a clock of its own, once it had a network."""
    story = Story(True, clock=lambda time: time + (3600.0 if time > START + 2.0 else 0.0))
    for tenth in range(60):
        time = START + tenth / 10
        story.odometry("/odom", time + 0.01, tenth / 10, stamp=time)  # one is stamped before, recorded after
        story.scan("/scan", time + 0.03, "laser", stamp=time + 0.02)
    scans, moved, _ = read(story.write(tmp_path / "a.bag"))
    ends = [(each[0].timestamp.seconds, each[-1].timestamp.seconds) for each in (scans["scan"], moved)]
    assert ends == [(START, START + 3605)] * 2
    assert (len(scans["scan"]), len(moved)) == (60, 60)


def test_a_single_absurd_stamp_does_not_reorder_the_log(tmp_path: Path) -> None:
    story = Story(False)
    for tenth in range(30):
        time = START + tenth / 10
        story.scan("/scan", time, "laser", stamp=2e9 if tenth == 12 else time)
    scans, _, counters = read(story.write(tmp_path / "a"))
    times = np.array([scan.timestamp.ToNanoseconds() for scan in scans["scan"]]) / S - START
    np.testing.assert_allclose(times, np.arange(30) / 10, atol=1e-6)
    assert counters["stray_stamps"] == 1


@pytest.mark.parametrize("ros1", [True, False])
def test_messages_out_of_the_order_of_their_stamps_are_sorted(tmp_path: Path, ros1: bool) -> None:
    story = usual(ros1, seconds=5)
    # odometry is recorded half a second late
    story.messages = [
        (topic, kind, recorded + (0.5 if kind == ODOM else 0.0), message)
        for topic, kind, recorded, message in story.messages
    ]
    scans, moved, counters = read(story.write(tmp_path / ("a.bag" if ros1 else "a")))
    assert len(moved) == 50
    assert len(scans["front"]) == 50
    assert counters == {}


@pytest.mark.parametrize("pack", [None, *Writer1.CompressionFormat])
def test_a_bag_cut_anywhere_gives_what_came_before(tmp_path: Path, pack: Any) -> None:
    whole = usual(True, seconds=60).write(tmp_path / "whole.bag", pack=pack).read_bytes()
    place = whole.index(b"index_pos=") + len(b"index_pos=")
    index = int.from_bytes(whole[place : place + 8], "little")
    path = tmp_path / "cut.bag"
    seen = []
    for share in (0.45, 0.7, 0.95):
        path.write_bytes(whole[: int(share * index)])
        scans, moved, counters = read(path)
        assert counters == {"truncated_file": 1}
        assert len(moved) > 10
        seen.append(len(scans["front"]))
    # bzip2 gives only whole chunks
    assert 100 < seen[0] <= seen[1] <= seen[2]
    assert seen[0] < 600


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_ros2_bag_cut_gives_what_came_before(tmp_path: Path, storage: StoragePlugin) -> None:
    folder = usual(False, seconds=200).write(tmp_path / "a", storage)
    (file,) = [*folder.glob("*.db3"), *folder.glob("*.mcap")]
    data = file.read_bytes()
    file.write_bytes(data[: 6 * len(data) // 10])
    for path in (folder, file):
        scans, moved, counters = read(path)
        assert counters["truncated_file"] == 1
        assert 50 < len(scans["front"]) < 2000
        assert 50 < len(moved) < 2000


def test_a_folder_without_its_metadata_is_read(tmp_path: Path) -> None:
    folder = usual(False).write(tmp_path / "a")
    (folder / "metadata.yaml").unlink()
    scans, moved, counters = read(folder)
    assert (len(scans["front"]), len(moved)) == (30, 30)
    assert counters == {"no_metadata": 1}


def test_what_is_asked_for_and_missing_is_named(tmp_path: Path) -> None:
    path = usual(True).write(tmp_path / "a.bag")
    with pytest.raises(LogError, match=r"a\.bag: no lidar /top: .*: /front/scan, /rear/scan"):
        read(path, lidars=("/top",))
    with pytest.raises(LogError, match=r"a\.bag: no odometry topic /o: choose one of /odom"):
        read(path, odometry="/o")
    with pytest.raises(LogError, match=r"a\.bag: no frame chassis in tf: choose one of .*base_link, front"):
        read(path, base_frame="chassis")


def test_a_base_frame_may_have_the_slash_that_the_bag_has(tmp_path: Path) -> None:
    path = usual(True).write(tmp_path / "a.bag")
    scans, moved, _ = read(path, base_frame="/base_link")
    np.testing.assert_allclose(from_message(scans["front"][0].mount), [0.3, 0.0, 0.1], atol=1e-9)
    assert moved[0].body_frame_id == "base_link"


def test_a_bag_without_scans_is_refused(tmp_path: Path) -> None:
    story = Story(True)
    story.odometry("/odom", START, 0.0)
    with pytest.raises(LogError, match=r"a\.bag: holds no laser scan, .*: /odom \(nav_msgs/msg/Odometry\)$"):
        read(story.write(tmp_path / "a.bag"))


@pytest.mark.parametrize("container", ["ros1", "sqlite", "mcap"])
def test_a_bag_of_point_clouds_is_refused_with_what_helps(tmp_path: Path, container: str) -> None:
    ros1, write = CONTAINERS[container]
    story = Story(ros1)
    cloud = story.kind(CLOUD)(
        *(story.header(START, "laser"), 1, 0, [], False, 16, 0, np.zeros(0, np.uint8), True)
    )
    story.messages += [(f"/points{k}", CLOUD, START, cloud) for k in range(12)]
    known = r"/points0 \(sensor_msgs/msg/PointCloud2\), .* and 2 more"
    with pytest.raises(LogError, match=f"with pointcloud_to_laserscan, and record them; its topics: {known}"):
        read(write(story, tmp_path))


def test_a_database_that_was_cut_before_the_first_scan_is_called_so(tmp_path: Path) -> None:
    folder = usual(False, seconds=60).write(tmp_path / "a")
    (folder / "metadata.yaml").unlink()
    whole = (folder / "a.db3").read_bytes()
    (folder / "a.db3").write_bytes(whole[:20_000])
    with pytest.raises(LogError, match="is damaged, or was cut, before the first laser scan"):
        read(folder)


@pytest.mark.parametrize(
    "data", [b"#ROSBAG V1.2\n" + b"\x00" * 50, b"SQLite format 3\x00junk", b"\x89MCAP0\r\n"]
)
def test_a_file_that_only_starts_like_a_bag_is_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.bag").write_bytes(data)
    with pytest.raises(LogError, match=r"a\.bag: "):
        read(tmp_path / "a.bag")


def test_damaged_messages_are_counted(tmp_path: Path) -> None:
    story = usual(False)
    path = story.write(tmp_path / "a") / "a.db3"
    import sqlite3

    with sqlite3.connect(path) as base:
        base.execute("UPDATE messages SET data = x'0001000001' WHERE id % 7 = 0")
    base.close()
    scans, moved, counters = read(path)
    lost = counters["undecodable_message"]
    assert lost > 5
    assert len(scans["front"]) + len(scans["rear"]) + len(moved) + lost == 90


def test_a_topic_whose_type_is_damaged_is_left_out(tmp_path: Path) -> None:
    """SQLite keeps bytes in a column of text."""
    path = usual(False).write(tmp_path / "a") / "a.db3"
    (path.parent / "metadata.yaml").unlink()
    import sqlite3

    with sqlite3.connect(path) as base:
        base.execute("UPDATE topics SET type = x'ff' WHERE name LIKE '%front%' OR name LIKE '%scan%'")
        assert base.execute("SELECT COUNT(*) FROM topics WHERE typeof(type) = 'blob'").fetchone()[0]
    base.close()
    with pytest.raises(LogError, match="holds no laser scan"):
        list(open_log(path).envelopes())


@pytest.mark.parametrize("container", CONTAINERS)
def test_random_damage_never_crashes(tmp_path: Path, container: str) -> None:
    ros1, write = CONTAINERS[container]
    story = usual(ros1, seconds=4)
    path = write(story, tmp_path)
    file = path if path.is_file() else next(iter([*path.glob("*.db3"), *path.glob("*.mcap*")]))
    whole = file.read_bytes()
    rng = np.random.default_rng(5)
    read_some = 0
    for _ in range(15):
        data = bytearray(whole)
        for place in rng.integers(20, len(data), rng.integers(1, 30)):
            data[place] = rng.integers(256)
        file.write_bytes(bytes(data))
        try:
            received = list(open_log(path).envelopes())
        except LogError:
            continue
        stamps = [envelope.stamp for envelope in received]
        assert stamps == sorted(stamps)
        read_some += bool(received)
    assert read_some > 2 or file.suffix == ".zstd"  # where a stream is damaged, all of it is lost


def test_a_bag_that_would_fill_the_disk_is_refused(tmp_path: Path) -> None:
    bomb = tmp_path / "a.mcap.zstd"
    bomb.write_bytes(zstandard.compress(bytes(2**27)))
    with pytest.raises(LogError, match=r"a\.mcap\.zstd: would become more than 67 MB"):
        list(open_log(bomb).envelopes())


def test_a_compressed_bag_is_inflated_a_part_at_a_time_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "temp"
    place.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(place))
    folder = usual(ros1=False).write(tmp_path / "a", StoragePlugin.MCAP, "file")
    (folder / "b.mcap.zstd").write_bytes((folder / "a.mcap.zstd").read_bytes())

    def copies() -> int:
        return sum(str(place) in str(each.resolve()) for each in Path("/proc/self/fd").iterdir())

    most = 0
    for _ in open_log(folder).envelopes():
        most = max(most, copies())
        assert list(place.iterdir()) == []  # else a killed process would leave its copies
    assert (most, copies()) == (1, 0)


def test_a_compressed_bag_of_one_file_is_inflated_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, make = list[Any](), tempfile.TemporaryFile

    def counted() -> Any:
        made.append(make())
        return made[-1]

    monkeypatch.setattr("tempfile.TemporaryFile", counted)
    folder = usual(ros1=False).write(tmp_path / "a", StoragePlugin.MCAP, "file")
    log = open_log(folder)
    assert len(made) == 0  # evaluation opens a log to learn its format alone
    whole = [envelope.stamp for envelope in log.envelopes()]
    assert [envelope.stamp for envelope in log.envelopes()] == whole
    assert len(made) == 1


def test_a_compressed_bag_may_be_read_twice_at_a_time(tmp_path: Path) -> None:
    log = open_log(usual(ros1=False).write(tmp_path / "a", StoragePlugin.MCAP, "file"))
    alone = [envelope.stamp for envelope in log.envelopes()]
    pairs = zip(log.envelopes(), log.envelopes(), strict=True)
    assert [(a.stamp, b.stamp) for a, b in pairs] == list(zip(alone, alone, strict=True))
