"""The other dialects over a real router. Here a plain Zenoh session does what zenoh-bridge-ros2dds does.

Its sources show: topics are plain keys, transient local ones have an advanced publisher, a service's request
carries `rqh`, the DDS header and the byte order beside it, its reply nothing.
"""

import json
import struct
import uuid
from collections.abc import Callable, Iterator

import numpy as np
import pytest
import zenoh
from eigenscan.geometry.gridmap import GridMap
from eigenscan.geometry.gridmap import to_message as to_grid
from eigenscan.geometry.pose import to_message
from eigenscan.ros_bridge import cdr
from eigenscan.schemas.channels import MAP, ODOMETRY, POSE, RELOCATION, SCAN_RAW, TRANSFORM
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Relocation
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

from tests.network import free_port
from tests.services.ros_bridge.conftest import PATIENCE_S, Bridge, Network, eventually
from tests.services.ros_bridge.test_core import MOUNT, odometry, scan

pytestmark = pytest.mark.slow

Start = Callable[..., Bridge]
REQUEST = b"rqh" + struct.pack("<qqB", 77, 1, 1)


@pytest.fixture
def dds(network: Network) -> Iterator[zenoh.Session]:
    config = zenoh.Config.from_file(str(network.leaf))
    config.insert_json5("timestamping/enabled", "true")
    with zenoh.open(config) as session:
        yield session


@pytest.fixture
def name() -> str:
    """A namespace, so that tests do not receive each other."""
    return f"r{uuid.uuid4().hex[:8]}"


def test_a_dds_robot_in_and_out(start: Start, dds: zenoh.Session, name: str) -> None:
    static = zenoh.ext.declare_advanced_publisher(
        dds, f"{name}/tf_static", cache=zenoh.ext.CacheConfig(1), publisher_detection=True
    )
    static.put(MOUNT)
    received: dict[str, list[zenoh.Sample]] = {"amcl_pose": [], "tf": []}
    for topic, samples in received.items():
        dds.declare_subscriber(f"{name}/{topic}", samples.append)
    bridge = start("--dialect", "ros2dds", "--namespace", name)

    def through() -> list[RawScan]:
        dds.put(f"{name}/odom", odometry(1.0, 2.0, 0.5))
        dds.put(f"{name}/scan", scan())
        return bridge.ear.of(SCAN_RAW, RawScan)

    assert eventually(through, "a scan")[0].mount.x == pytest.approx(0.2)
    assert bridge.ear.of(ODOMETRY, Odometry)[0].pose.position.y == 2.0
    address = {"site": bridge.site, "robot": "robot"}
    estimate = PoseEstimate(timestamp=stamp(10**18), frame_id="map", state=STATE_LOCALIZED)
    estimate.pose.CopyFrom(to_message((1.5, -2.0, 0.7)))
    move = FrameTransform(timestamp=stamp(10**18), parent_frame_id="map", child_frame_id="odom")

    def output() -> bool:
        bridge.ear.bus.publish(Envelope(POSE, address, estimate))
        bridge.ear.bus.publish(Envelope(TRANSFORM, address, move))
        return all(received.values())

    eventually(output, "/amcl_pose and /tf")
    sample = received["amcl_pose"][0]
    assert sample.attachment is None
    assert cdr.decode(cdr.POSE_WITH_COVARIANCE, sample.payload.to_bytes()).pose.pose.position.x == 1.5
    (item,) = cdr.decode(cdr.TRANSFORMS, received["tf"][0].payload.to_bytes()).transforms
    assert (item.header.frame_id, item.child_frame_id) == ("map", "odom")
    static.undeclare()


def test_a_dds_client_calls_the_service(start: Start, dds: zenoh.Session, name: str) -> None:
    bridge = start("--dialect", "ros2dds", "--namespace", name)
    key = f"{name}/reinitialize_global_localization"

    def replies() -> list[zenoh.Sample]:
        asked = dds.get(key, payload=b"\0\1\0\0\0", attachment=REQUEST, timeout=2.0)
        return [reply.ok for reply in asked if reply.ok is not None]

    (reply,) = eventually(replies, "the service's reply")
    # the bridge puts the header of the request between the first four bytes and the rest
    assert reply.payload.to_bytes() == b"\0\1\0\0\0"
    reported = eventually(lambda: bridge.ear.of(RELOCATION, Relocation), "the request")
    assert not reported[0].HasField("pose")


def test_a_dds_robot_that_comes_late_gets_the_map(start: Start, dds: zenoh.Session, name: str) -> None:
    bridge = start("--dialect", "ros2dds", "--namespace", name)
    grid = GridMap(np.full((2, 3), 100, dtype=np.uint8), 0.05, np.zeros(3))
    bridge.ear.bus.offer([MAP], {"site": bridge.site})
    bridge.ear.bus.publish(Envelope(MAP, {"site": bridge.site}, to_grid(grid, "map")))
    eventually(lambda: bridge.counter("said_ros_said"), "the map to be said")
    maps: list[zenoh.Sample] = []
    subscriber = zenoh.ext.declare_advanced_subscriber(
        dds,
        f"{name}/map",
        maps.append,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
    )
    eventually(lambda: maps, "the map")
    assert cdr.decode(cdr.OCCUPANCY_GRID, maps[0].payload.to_bytes()).data.tolist() == [100] * 6
    subscriber.undeclare()


def test_the_dds_bridge_receives_the_topics(start: Start, dds: zenoh.Session, name: str) -> None:
    bridge = start("--dialect", "ros2dds", "--namespace", name)

    def tokens() -> set[str]:
        replies = dds.liveliness().get("@/*/@ros2_lv/**", timeout=2.0)
        keys = [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
        return {key.split("/", 3)[3] for key in keys if f"/{name}§" in key}

    shown = eventually(lambda: found if len(found := tokens()) >= 30 else None, "the tokens")
    assert len(shown) == 30
    assert {key.split("/")[0] for key in shown} == {"MP", "MS", "SS"}
    assert any("§floor/" in key for key in shown)
    bridge.process.terminate()
    eventually(lambda: not tokens(), "the tokens' end")
    # a second signal while it ends would end it at once
    assert bridge.process.wait(PATIENCE_S) == 0


def test_humble_has_keys_without_hashes(start: Start, dds: zenoh.Session, name: str) -> None:
    bridge = start("--dialect", "rmw_zenoh_humble", "--namespace", name, "--domain", "5")
    key = f"5/{name}/odom/nav_msgs::msg::dds_::Odometry_/TypeHashNotSupported"

    def received() -> list[Odometry]:
        dds.put(key, odometry(3.0, 0.0, 0.0))
        return bridge.ear.of(ODOMETRY, Odometry)

    assert eventually(received, "odometry")[0].pose.position.x == 3.0


def test_a_router_that_comes_later_is_found(start: Start, network: Network) -> None:
    """As at power-on, when the robot's programs start in any order."""
    port = free_port()
    bridge = start("--domain", "6", ros_router=f"tcp/127.0.0.1:{port}")
    router = {"mode": "router", "listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}
    router["scouting"] = {"multicast": {"enabled": False}}
    with zenoh.open(zenoh.Config.from_json5(json.dumps(router))) as session:
        key = f"6/odom/{cdr.dds_name(cdr.ODOMETRY)}/{cdr.type_hash(cdr.ODOMETRY)}"

        def received() -> list[Odometry]:
            session.put(key, odometry(4.0, 0.0, 0.0))
            return bridge.ear.of(ODOMETRY, Odometry)

        assert eventually(received, "odometry")[0].pose.position.x == 4.0
