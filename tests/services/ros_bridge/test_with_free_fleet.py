"""Open-RMF's free_fleet reads where a robot is from `<robot>/tf` on Zenoh; here as its Nav2 adapter does.

The messages are CDR by pycdr2, as there. The buffer is tf2's rule: frames are joined at the newest time
that all of them have, and what is older than ten seconds is forgotten.
"""

import json
import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh
from eigenscan.schemas.channels import ODOMETRY, TRANSFORM
from eigenscan.schemas.envelope import Envelope, stamp
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from pycdr2 import IdlStruct, types

from tests.services.ros_bridge.conftest import ALONE, Bridge, Network, eventually
from tests.services.ros_bridge.ros_structs import Structs

pytestmark = pytest.mark.slow

ROBOT, CACHE_S = "r17", 10.0
BEGIN = 1_700_000_000.0
Start = Callable[..., Bridge]


STRUCTS = Structs(IdlStruct, types)
Time, Header = STRUCTS["builtin_interfaces/msg/Time"], STRUCTS["std_msgs/msg/Header"]
Vector3, Quaternion, Transform, TransformStamped = (
    STRUCTS[f"geometry_msgs/msg/{name}"]
    for name in ("Vector3", "Quaternion", "Transform", "TransformStamped")
)
TFMessage: Any = STRUCTS["tf2_msgs/msg/TFMessage"]
Pose = tuple[float, float, float]


class Adapter:
    """free_fleet's side: a Zenoh subscriber, a buffer, a pose or None."""

    def __init__(self, session: zenoh.Session) -> None:
        self._frames: dict[tuple[str, str], dict[float, Pose]] = {}
        self._lock = threading.Lock()
        self._subscriber = session.declare_subscriber(f"{ROBOT}/tf", self._take)

    def _take(self, sample: zenoh.Sample) -> None:
        message: Any = TFMessage.deserialize(sample.payload.to_bytes())
        for item in message.transforms:
            at, q = item.transform.translation, item.transform.rotation
            time_s = item.header.stamp.sec + item.header.stamp.nanosec * 1e-9
            with self._lock:
                known = self._frames.setdefault((item.header.frame_id, item.child_frame_id), {})
                known[time_s] = (at.x, at.y, 2.0 * math.atan2(q.z, q.w))
                for old in [each for each in known if each < max(known) - CACHE_S]:
                    del known[old]

    def newest(self, parent: str, child: str) -> float:
        with self._lock:
            return max(self._frames.get((parent, child), {0.0: None}))

    def pose(self) -> Pose | None:
        """Of the base in the map frame, as RMF gets it; None where tf2 would raise."""
        with self._lock:
            to_odom = self._frames.get(("map", "odom"), {})
            to_base = self._frames.get(("odom", "base_footprint"), {})
            if not to_odom or not to_base:
                return None
            common = min(max(to_odom), max(to_base))
            if common < max(min(to_odom), min(to_base)):
                return None  # ExtrapolationException
            x, y, theta = self._at(to_odom, common)
            dx, dy, turn = self._at(to_base, common)
        cos, sin = math.cos(theta), math.sin(theta)
        return x + cos * dx - sin * dy, y + sin * dx + cos * dy, theta + turn

    @staticmethod
    def _at(known: dict[float, Pose], time_s: float) -> Pose:
        """Between the two neighbours in time; headings here never wrap."""
        before, after = max(t for t in known if t <= time_s), min(t for t in known if t >= time_s)
        share = (time_s - before) / (after - before) if after > before else 0.0
        a, b = known[before], known[after]
        return (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2]))


@pytest.fixture
def session(network: Network) -> Iterator[zenoh.Session]:
    config = ALONE | {"mode": "client", "connect": {"endpoints": [network.endpoint]}}
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
        yield session


class Robot:
    """Drives along its odometry's x axis at 1 m/s from BEGIN, as zenoh-bridge-ros2dds publishes its tf."""

    def __init__(self, session: zenoh.Session) -> None:
        self._publisher = session.declare_publisher(f"{ROBOT}/tf")
        self.now = BEGIN

    def drive(self, seconds: float) -> None:
        """At 20 Hz."""
        for _ in range(round(20 * seconds)):
            self.now += 0.05
            self.publish()

    def publish(self) -> None:
        sec = int(self.now)
        header = Header(Time(sec, round((self.now - sec) * 1e9)), "odom")
        here = Transform(Vector3(self.now - BEGIN, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
        transforms: Any = [TransformStamped(header, "base_footprint", here)]
        message = TFMessage(transforms)
        self._publisher.put(message.serialize())


def test_it_reads_the_pose_and_loses_it_ten_seconds_after_the_claim(
    start: Start, network: Network, session: zenoh.Session
) -> None:
    adapter, robot = Adapter(session), Robot(session)
    bridge = start("--dialect", "ros2dds", "--namespace", ROBOT)
    address = {"site": bridge.site, "robot": "robot"}

    def claim() -> None:
        """The tracker publishes map -> odom while it claims a pose, and only then."""
        move = FrameTransform(
            timestamp=stamp(round(robot.now * 1e9)), parent_frame_id="map", child_frame_id="odom"
        )
        move.translation.x, move.translation.y = 10.0, 20.0
        move.rotation.z = move.rotation.w = math.sqrt(0.5)
        bridge.ear.bus.publish(Envelope(TRANSFORM, address, move))

    def caught_up() -> bool:
        return abs(adapter.newest("odom", "base_footprint") - robot.now) < 0.01

    robot.drive(0.5)
    assert adapter.pose() is None  # free_fleet waits for it 10 s (init_timeout_sec), then gives up

    def claimed() -> Pose | None:
        robot.drive(0.5)
        claim()
        time.sleep(0.05)
        return adapter.pose()

    eventually(claimed, "a pose")
    robot.drive(0.5)
    claim()
    ended = robot.now
    eventually(lambda: adapter.newest("map", "odom") > ended and caught_up(), "the newest transforms")
    # the bridge dates map -> odom 0.1 s ahead; a quarter turn: odometry's x is the map's y
    assert adapter.pose() == pytest.approx((10.0, 20.0 + ended - BEGIN, math.pi / 2), abs=0.11)

    # the robot drives on; it is ambiguous, and map -> odom stops
    robot.drive(9.0)
    eventually(caught_up, "9 s of driving")
    last = adapter.pose()
    assert last == pytest.approx((10.0, 20.0 + ended + 0.1 - BEGIN, math.pi / 2), abs=0.02)
    robot.drive(2.0)
    eventually(caught_up, "11 s of driving")
    assert adapter.pose() is None  # RMF gets nothing more

    eventually(claimed, "a pose again")


def test_the_bridge_takes_the_robots_odometry_from_there(start: Start, session: zenoh.Session) -> None:
    robot, bridge = Robot(session), start("--dialect", "ros2dds", "--namespace", ROBOT)

    def driven() -> list[Any]:
        robot.drive(0.1)
        return bridge.ear.of(ODOMETRY, Odometry)

    assert eventually(driven, "odometry")[0].body_frame_id == "base_footprint"
