"""The bridge over a real Zenoh router, with a ROS 2 robot that is an independent program (see conftest)."""

import re
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, MapError
from eigenscan.geometry.gridmap import to_message as to_grid
from eigenscan.geometry.pose import from_pose3, to_message
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.inbound import grid_map
from eigenscan.ros_bridge.options import RosBridgeOptions
from eigenscan.ros_bridge.outbound import occupancy_grid, pose_with_covariance
from eigenscan.ros_bridge.robot_map import take_map
from eigenscan.ros_bridge.service_types import EMPTY_SERVICE
from eigenscan.schemas.channels import MAP, ODOMETRY, POSE, RELOCATION, SCAN_RAW, TRACKS, TRANSFORM
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Relocation, Track, Tracks
from eigenscan.workbench.logs.bag import BagMessage
from eigenscan.workbench.logs.ros2 import Ros2Bag
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from zenoh_ros2_sdk import (
    ROS2ServiceClient,
    TopicInfo,
    get_service_names_and_types,
    get_topic_info,
    get_topic_names_and_types,
)
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

from tests.services.ros_bridge.conftest import PATIENCE_S, Bridge, Network, Robot, eventually, fields
from tests.services.ros_bridge.test_cdr import BAG

pytestmark = pytest.mark.slow

Start = Callable[..., Bridge]
LATCHED = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=10)
TOPICS = {"/scan": cdr.LASER_SCAN, "/odom": cdr.ODOMETRY, "/tf_static": cdr.TRANSFORMS}
ORIGIN = np.array([-1.0, 2.0, 0.5])
TIME = 1_700_000_000_250_000_000


@pytest.fixture
def bridge(start: Start, robot: Robot) -> Bridge:
    return start("--domain", str(robot.domain))


def recorded(count: int) -> list[BagMessage]:
    wanted = [message for message in Ros2Bag(BAG).messages(TOPICS) if message.topic in TOPICS]
    static = [message for message in wanted if message.topic == "/tf_static"]
    return static + [message for message in wanted if message.topic != "/tf_static"][:count]


@pytest.mark.dataset
def test_a_recorded_drive_comes_through(bridge: Bridge, robot: Robot) -> None:
    drive = recorded(200)
    publishers = {topic: robot.publisher(topic, kind) for topic, kind in TOPICS.items()}

    def send(messages: list[BagMessage]) -> None:
        for message in messages:
            publishers[message.topic].publish(**fields(message.message))
            time.sleep(0.005)  # faster than a robot, not all at once: full queues drop sensors' topics

    def ready() -> list[RawScan]:
        # peers take some time to find each other; the mount is known from tf_static and odometry
        send([next(m for m in drive if m.topic == topic) for topic in ("/tf_static", "/odom", "/scan")])
        return bridge.ear.of(SCAN_RAW, RawScan)

    eventually(ready, "a first scan")
    send([message for message in drive if message.topic != "/tf_static"])
    sent = {
        topic: {_time(m.message): m.message for m in drive if m.topic == topic}
        for topic in ("/scan", "/odom")
    }
    scans = eventually(lambda: _complete(bridge.ear.of(SCAN_RAW, RawScan), sent["/scan"]), "all scans")
    moves = eventually(lambda: _complete(bridge.ear.of(ODOMETRY, Odometry), sent["/odom"]), "all odometry")
    for taken, scan in scans.items():
        ranges = np.array(scan.ranges, dtype=np.float32)
        assert np.array_equal(ranges, sent["/scan"][taken].ranges, equal_nan=True)
        assert scan.mount.theta == pytest.approx(np.pi / 2, abs=0.05)  # this robot's lidar is turned
    for taken, message in moves.items():
        position = sent["/odom"][taken].pose.pose.position
        assert from_pose3(message.pose)[:2] == pytest.approx([position.x, position.y])


def _complete(received: list[Any], sent: dict[int, Any]) -> dict[int, Any] | None:
    """What was received by stamp, once that is all that was sent."""
    by_time = {nanoseconds(message.timestamp): message for message in received}
    return by_time if by_time.keys() == sent.keys() else None


def _time(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def _matched(publishers: Any) -> bool:
    return all(publisher.pub.matching_status.matching for publisher in publishers)


def test_the_pose_and_the_transform_arrive(bridge: Bridge, robot: Robot) -> None:
    poses = robot.subscribe("/amcl_pose", cdr.POSE_WITH_COVARIANCE)
    transforms = robot.subscribe("/tf", cdr.TRANSFORMS)
    clouds = robot.subscribe("/particle_cloud", cdr.PARTICLE_CLOUD)
    address = {"site": bridge.site, "robot": "robot"}
    estimate = PoseEstimate(
        timestamp=stamp(TIME), frame_id="map", pose=to_message((1.5, -2.0, 0.7)), state=STATE_LOCALIZED
    )
    estimate.covariance.xx = 0.04
    move = FrameTransform(timestamp=stamp(TIME), parent_frame_id="map", child_frame_id="odom")
    move.translation.x, move.rotation.w = 3.0, 1.0
    tracks = Tracks(timestamp=stamp(TIME), frame_id="map", tracks=[Track(probability=0.9)])

    def arrived() -> bool:
        for channel, message in ((POSE, estimate), (TRANSFORM, move), (TRACKS, tracks)):
            bridge.ear.bus.publish(Envelope(channel, address, message))
        return bool(poses and transforms and clouds)

    eventually(arrived, "/amcl_pose, /tf and /particle_cloud")
    body = poses[0]
    assert (body.header.frame_id, _time(body)) == ("map", TIME)
    assert (body.pose.pose.position.x, body.pose.pose.position.y) == (1.5, -2.0)
    assert body.pose.pose.orientation.z == pytest.approx(np.sin(0.35))
    assert body.pose.covariance[0] == 0.04
    (item,) = transforms[0].transforms
    assert (item.header.frame_id, item.child_frame_id) == ("map", "odom")
    assert item.transform.translation.x == 3.0
    assert clouds[0].particles[0].weight == 0.9


def test_who_comes_late_gets_the_map(bridge: Bridge, robot: Robot) -> None:
    cells = np.zeros((4, 6), dtype=np.uint8)
    cells[1, 2], cells[3, 5] = 100, 255
    grid = GridMap(cells, 0.05, np.array([-1.0, 2.0, 0.0]))
    bridge.ear.bus.offer([MAP], {"site": bridge.site})
    bridge.ear.bus.publish(Envelope(MAP, {"site": bridge.site}, to_grid(grid, "map")))
    eventually(lambda: bridge.counter("said_ros_said"), "the map to be said")

    def come_late() -> list[Any]:
        received = robot.subscribe("/map", cdr.OCCUPANCY_GRID, qos=LATCHED)
        time.sleep(1.0)  # the SDK asks for what was published once, which on a busy machine may be too early
        return received

    maps = eventually(come_late, "the map")
    assert np.array(maps[0].data).reshape(4, 6)[[1, 3], [2, 5]].tolist() == [100, -1]
    assert (maps[0].info.width, maps[0].info.height) == (6, 4)


def test_the_robots_own_map_is_taken(robot: Robot, network: Network) -> None:
    """As of a map_server, or of SLAM, whose cells are how probably they are occupied."""
    flags = {"ros_router": network.endpoint, "domain": robot.domain}
    settings = RosBridgeOptions.model_validate(flags)
    with pytest.raises(MapError, match=f"no map on /map of domain {robot.domain}"):
        take_map(settings, 0.5)
    cells = np.array([[0, 19, 50], [65, 100, -1]], dtype=np.int8)
    body = cdr.decode(
        cdr.OCCUPANCY_GRID, occupancy_grid(to_grid(GridMap(np.zeros((2, 3), np.uint8), 0.05, ORIGIN), "map"))
    )
    body.data = cells.ravel()
    publisher = robot.publisher("/map", cdr.OCCUPANCY_GRID)
    ended = threading.Event()

    def send() -> None:
        while not ended.wait(0.1):
            publisher.publish(**fields(body))

    server = threading.Thread(target=send)
    server.start()
    try:
        grid = take_map(settings, PATIENCE_S)
    finally:
        ended.set()
        server.join()
    assert grid.cells.tolist() == [[FREE, FREE, UNKNOWN], [OCCUPIED, OCCUPIED, UNKNOWN]]
    assert grid.origin == pytest.approx(ORIGIN)
    assert grid.resolution == pytest.approx(0.05)


@pytest.mark.parametrize(("field", "value"), [("width", 7), ("resolution", 0.0), ("resolution", np.nan)])
def test_a_grid_that_is_no_map_is_refused(field: str, value: float) -> None:
    grid = GridMap(np.zeros((2, 3), np.uint8), 0.05, ORIGIN)
    body = cdr.decode(cdr.OCCUPANCY_GRID, occupancy_grid(to_grid(grid, "map")))
    setattr(body.info, field, value)
    with pytest.raises(MapError, match="expected a map"):
        grid_map(body)


def test_tf_static_published_before_the_bridge_came_is_received(
    start: Start, robot: Robot, network: Network
) -> None:
    """As robot_state_publisher does: published once, kept for who comes."""
    import zenoh
    from eigenscan.ros_bridge.endpoints import endpoints
    from eigenscan.ros_bridge.rmw_zenoh import RmwZenoh

    from tests.services.ros_bridge.test_core import MOUNT, scan

    tf_static = endpoints(RosBridgeOptions()).static_transforms
    assert tf_static is not None
    config = zenoh.Config.from_file(str(network.leaf))
    config.insert_json5("timestamping/enabled", "true")
    with zenoh.open(config) as session:
        publisher = zenoh.ext.declare_advanced_publisher(
            session,
            RmwZenoh(robot.domain, "", str(session.zid())).key(tf_static),
            cache=zenoh.ext.CacheConfig(1),
            publisher_detection=True,
        )
        publisher.put(MOUNT)
        bridge = start("--domain", str(robot.domain), "--base-frame", "base_link")
        lidar = robot.publisher("/scan", cdr.LASER_SCAN)

        def through() -> list[RawScan]:
            lidar.publish(**fields(cdr.decode(cdr.LASER_SCAN, scan())))
            return bridge.ear.of(SCAN_RAW, RawScan)

        scans = eventually(through, "a scan")
        assert scans[0].mount.x == pytest.approx(0.2)
        publisher.undeclare()


def test_an_operator_and_a_behaviour_tree_can_relocate(bridge: Bridge, robot: Robot) -> None:
    clicks = robot.publisher("/initialpose", cdr.POSE_WITH_COVARIANCE)
    client = ROS2ServiceClient(
        "/reinitialize_global_localization",
        EMPTY_SERVICE,
        request_definition="uint8 structure_needs_at_least_one_member",
        response_definition="uint8 structure_needs_at_least_one_member",
        domain_id=robot.domain,
        router_port=robot.port,
        timeout=60.0,
    )
    eventually(lambda: _matched([clicks]), "the bridge's subscription")
    pose = PoseEstimate(timestamp=stamp(TIME), frame_id="map", pose=to_message((4.0, 5.0, 1.0)))
    clicks.publish(**fields(cdr.decode(cdr.POSE_WITH_COVARIANCE, pose_with_covariance(pose))))
    (clicked,) = eventually(lambda: bridge.ear.of(RELOCATION, Relocation), "the click")
    assert (clicked.pose.x, clicked.pose.y) == (4.0, 5.0)
    reply = eventually(lambda: client.call(structure_needs_at_least_one_member=0), "the service's reply")
    assert asdict(reply)["structure_needs_at_least_one_member"] == 0
    client.close()
    reported = eventually(lambda: bridge.ear.of(RELOCATION, Relocation)[1:], "the request")
    assert not reported[0].HasField("pose")


def test_ros_2_topic_tools_see_it(bridge: Bridge, robot: Robot, network: Network) -> None:
    asked = {"domain_id": robot.domain, "router_port": network.port}
    ours = {
        "/scan",
        "/odom",
        "/tf",
        "/tf_static",
        "/initialpose",
        "/bond",
        "/amcl_pose",
        "/amcl/transition_event",
        "/floor",
        "/diagnostics",
        "/particle_cloud",
    }
    ours.add("/map")

    def listed() -> dict[str, list[str]]:
        topics = dict(get_topic_names_and_types(**asked))
        return topics if len(topics) == len(ours) else {}

    topics = eventually(listed, "the topics")
    assert set(topics) == ours
    assert topics["/scan"] == [cdr.LASER_SCAN]
    assert topics["/amcl_pose"] == [cdr.POSE_WITH_COVARIANCE]
    served = {
        "/reinitialize_global_localization": ["std_srvs/srv/Empty"],
        "/request_nomotion_update": ["std_srvs/srv/Empty"],
        "/set_initial_pose": ["nav2_msgs/srv/SetInitialPose"],
        "/amcl/get_state": ["lifecycle_msgs/srv/GetState"],
        "/amcl/change_state": ["lifecycle_msgs/srv/ChangeState"],
        "/amcl/get_available_states": ["lifecycle_msgs/srv/GetAvailableStates"],
        "/amcl/get_available_transitions": ["lifecycle_msgs/srv/GetAvailableTransitions"],
    }
    for name in (
        "ListParameters",
        "GetParameters",
        "GetParameterTypes",
        "DescribeParameters",
        "SetParameters",
    ):
        service = re.sub("(?<=[a-z])(?=[A-Z])", "_", name).lower()
        served |= {f"/{node}/{service}": [f"rcl_interfaces/srv/{name}"] for node in ("eigenscan", "amcl")}
    eventually(lambda: dict(get_service_names_and_types(**asked)) == served, "the services")

    def info(topic: str, publishers: int, subscribers: int) -> TopicInfo | None:
        reported = get_topic_info(topic, verbose=True, **asked)
        counted = reported and (reported.publisher_count, reported.subscriber_count)
        return reported if counted == (publishers, subscribers) else None

    (teller,) = eventually(lambda: info("/map", 1, 0), "who says /map").publishers
    assert teller.node_name == "eigenscan"
    assert QosProfile.decode(teller.qos).durability is QosDurability.TRANSIENT_LOCAL
    assert eventually(lambda: info("/tf", 1, 1), "who says and hears /tf")


def test_garbage_is_counted_and_the_next_message_comes_through(bridge: Bridge, robot: Robot) -> None:
    odometry = robot.publisher("/odom", cdr.ODOMETRY)
    eventually(lambda: _matched([odometry]), "the bridge's subscription")
    for garbage in (b"", b"\0\1\0\0", b"\xff" * 500, np.random.default_rng(0).bytes(700)):
        odometry.pub.put(garbage)
    message = next(m.message for m in Ros2Bag(BAG).messages(["/odom"]))
    odometry.publish(**fields(message))
    eventually(lambda: bridge.ear.of(ODOMETRY, Odometry), "the odometry behind the garbage")
    eventually(lambda: bridge.counter("set_aside_not_cdr") == 4, "the count of the garbage")
    assert bridge.process.poll() is None


def test_another_domain_is_another_robot(bridge: Bridge, robot: Robot) -> None:
    neighbour = Robot(robot.port, robot.domain + 1)
    odometry = [each.publisher("/odom", cdr.ODOMETRY) for each in (neighbour, robot)]
    eventually(lambda: _matched(odometry[1:]), "the bridge's subscription")
    assert not odometry[0].pub.matching_status.matching
    neighbour.close()
