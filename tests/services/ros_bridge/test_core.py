"""What the bridge makes of each message, without Zenoh."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.pose import from_pose3, to_message
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.channels import ROS_ANSWERED, ROS_ASKED, ROS_PUBLISHED, ROS_RECEIVED
from eigenscan.ros_bridge.core import RosBridgeCore
from eigenscan.ros_bridge.inbound import RECENT, Stamping
from eigenscan.ros_bridge.options import RosBridgeOptions
from eigenscan.schemas.channels import (
    HEALTH,
    MAP,
    ODOMETRY,
    POSE,
    RELOCATION,
    SCAN_RAW,
    TRACKS,
    TRANSFORM,
    Channel,
)
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.schemas.tracking_pb2 import (
    STATE_AMBIGUOUS,
    STATE_LOCALIZED,
    STATE_LOST,
    PoseEstimate,
    Relocation,
    Track,
    Tracks,
)
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from google.protobuf.wrappers_pb2 import BytesValue

TIME = 1_700_000_000_250_000_000
SITE = {"site": "s", "robot": "r"}


def core(**settings: Any) -> RosBridgeCore:
    options = RosBridgeOptions.model_validate({**SITE, **settings})
    return RosBridgeCore(options, options.site, options.robot)


def header(frame: str, time: int = TIME) -> Any:
    return cdr.make(
        "std_msgs/msg/Header", cdr.make("builtin_interfaces/msg/Time", *divmod(time, 10**9)), frame
    )


def pose(x: float, y: float, theta: float) -> Any:
    turn = cdr.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, np.sin(theta / 2), np.cos(theta / 2))
    return cdr.make("geometry_msgs/msg/Pose", cdr.make("geometry_msgs/msg/Point", x, y, 0.0), turn)


def vector(x: float, y: float, z: float) -> Any:
    return cdr.make("geometry_msgs/msg/Vector3", x, y, z)


def scan(
    frame: str = "laser",
    ranges: Iterable[float] = (1.0, 2.0, np.inf),
    time: int = TIME,
    time_increment: float = 0.0,
) -> bytes:
    values = np.asarray([*ranges], dtype=np.float32)
    none = np.zeros(0, dtype=np.float32)
    limits = -1.0, 1.0, 1.0, time_increment, 0.1, 0.05, 30.0
    return cdr.encode(cdr.make(cdr.LASER_SCAN, header(frame, time), *limits, values, none))


def odometry(x: float, y: float, theta: float, base: str = "base_link") -> bytes:
    covariance = np.diag([0.01, 0.02, 0.0, 0.0, 0.0, 0.03]).ravel()
    stated = cdr.make("geometry_msgs/msg/PoseWithCovariance", pose(x, y, theta), covariance)
    twist = cdr.make("geometry_msgs/msg/Twist", vector(0.5, 0.0, 0.0), vector(0.0, 0.0, 0.2))
    moving = cdr.make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36))
    return cdr.encode(cdr.make(cdr.ODOMETRY, header("odom"), base, stated, moving))


def transform(parent: str, child: str, xyz: tuple[float, float, float], xyzw: tuple[float, ...]) -> bytes:
    turn = cdr.make("geometry_msgs/msg/Quaternion", *xyzw)
    item = cdr.make(
        "geometry_msgs/msg/TransformStamped",
        header(parent),
        child,
        cdr.make("geometry_msgs/msg/Transform", vector(*xyz), turn),
    )
    return cdr.encode(cdr.make(cdr.TRANSFORMS, [item]))


MOUNT = transform("base_link", "laser", (0.2, 0.1, 0.3), (0.0, 0.0, 1.0, 0.0))


def listen(bridge: RosBridgeCore, endpoint: str, data: bytes) -> list[Envelope]:
    """As over Zenoh: the messages are encoded on their way."""
    received = Envelope(ROS_RECEIVED, {"endpoint": endpoint}, BytesValue(value=data))
    return Loopback([bridge]).receive(received)


def report(bridge: RosBridgeCore, channel: Any, message: Any) -> list[tuple[str, bytes]]:
    output = Loopback([bridge]).receive(Envelope(channel, SITE, message))
    assert all(each.channel is ROS_PUBLISHED for each in output)
    return [(each.address["endpoint"], each.open(BytesValue).value) for each in output]


@pytest.mark.parametrize(
    ("lag_s", "after"),
    [(0.003, 0.1), (0.104, 0.0), (-0.004, 0.1), (3600.0, 0.0), (-3600.0, 0.0)],
    ids=["stamped when received", "of the first beam", "clocks a little apart", "ahead", "behind"],
)
def test_a_driver_that_stamps_scans_when_it_has_them_is_found_out(lag_s: float, after: float) -> None:
    """No scan is received before its last beam was measured: SICK's, Hokuyo's and SLAMTEC's drivers do so."""
    bridge = core()
    listen(bridge, "%odom", odometry(0, 0, 0))
    listen(bridge, "%tf_static", MOUNT)
    lags = np.array([0.02, 0.0, 0.2, 0.01]) + lag_s
    found = list[RawScan]()
    for number, lag in enumerate(lags):
        time = TIME + number * 100_000_000
        data = BytesValue(value=scan(time=time, time_increment=0.05))
        (published,) = bridge.handle(
            Envelope(ROS_RECEIVED, {"endpoint": "%scan"}, data, time + int(lag * 1e9))
        )
        found.append(published.open(RawScan))
    assert [each.time_increment for each in found] == pytest.approx([0.05] * 4)
    # a scan that came late, over a slow link, does not change it
    assert [each.stamped_after for each in found[1:]] == pytest.approx([after] * 3)


def test_a_drivers_stamps_are_found_out_again_after_a_clock_was_set_back() -> None:
    """A scan on its way meanwhile is received an hour before its stamp."""
    stamping, step = Stamping(), 3_600_000_000_000
    lidar = cdr.decode(cdr.LASER_SCAN, scan(time_increment=0.05))
    assert stamping.after(lidar, TIME, TIME + 3_000_000) == pytest.approx(0.1)
    assert stamping.after(lidar, TIME, TIME - step) == 0.0
    times = [TIME - step + k * 100_000_000 for k in range(RECENT)]
    after = [stamping.after(lidar, time, time + 3_000_000) for time in times]
    assert after[-1] == pytest.approx(0.1)


def test_a_scan_is_published_with_the_mount_that_tf_gives() -> None:
    bridge = core()
    listen(bridge, "%odom", odometry(0, 0, 0))
    listen(bridge, "%tf_static", MOUNT)
    (output,) = listen(bridge, "%scan", scan())
    message = output.open(RawScan)
    assert output.key == "s/robot/r/scan/raw/scan"
    assert nanoseconds(message.timestamp) == TIME
    assert (message.mount.x, message.mount.y) == pytest.approx((0.2, 0.1))
    assert abs(message.mount.theta) == pytest.approx(np.pi)
    assert not message.upside_down
    assert list(message.ranges) == [1.0, 2.0, np.inf]
    assert (message.angle_min, message.angle_increment) == (-1.0, 1.0)
    assert message.range_max == 30.0
    assert bridge.condition().status == Health.STATUS_OK


def test_an_upside_down_lidar_on_an_arm_of_several_joints() -> None:
    bridge = core(base_frame="base_footprint")
    listen(bridge, "%tf_static", transform("base_footprint", "base_link", (0.0, 0.0, 0.1), (0, 0, 0, 1)))
    listen(bridge, "%tf", transform("base_link", "mast", (0.5, 0.0, 0.0), (0, 0, 0, 1)))
    listen(bridge, "%tf_static", transform("mast", "laser", (0.0, 0.0, 0.2), (1.0, 0.0, 0.0, 0.0)))
    (output,) = listen(bridge, "%scan", scan())
    assert output.open(RawScan).mount.x == pytest.approx(0.5)
    assert output.open(RawScan).upside_down


def test_scans_wait_for_the_mount_and_report_it() -> None:
    bridge = core()
    assert bridge.condition().detail == "no scan yet on /scan"
    assert listen(bridge, "%scan", scan()) == []
    assert "no odometry" in bridge.condition().detail
    listen(bridge, "%odom", odometry(0, 0, 0, base="base_footprint"))
    assert listen(bridge, "%scan", scan()) == []
    condition = bridge.condition()
    assert condition.status == Health.STATUS_WAITING
    assert "no transform from base_footprint to laser" in condition.detail
    assert condition.counters["set_aside_no_mount"] == 1
    listen(bridge, "%tf_static", transform("base_footprint", "laser", (0, 0, 0), (0, 0, 0, 1)))
    assert len(listen(bridge, "%scan", scan())) == 1


def test_a_lidar_that_lacks_something_is_reported_while_another_one_sends_scans() -> None:
    bridge = core(scan=["front", "rear"])
    listen(bridge, "%odom", odometry(0, 0, 0))
    listen(bridge, "%tf_static", MOUNT)
    assert bridge.condition().detail == "no scan yet on /front, /rear"
    listen(bridge, "%front", scan())
    assert bridge.condition().status == Health.STATUS_WAITING
    assert bridge.condition().detail == "no scan yet on /rear"
    listen(bridge, "%rear", scan("unknown"))
    for endpoint, frame in 2 * (("%front", "laser"), ("%rear", "unknown")):
        listen(bridge, endpoint, scan(frame))
        assert bridge.condition().status == Health.STATUS_WAITING
        assert bridge.condition().detail.startswith("/rear: ")
    listen(bridge, "%rear", scan())
    assert bridge.condition().status == Health.STATUS_OK


def test_a_tilted_lidar_is_not_for_this() -> None:
    bridge = core(base_frame="base_link")
    listen(bridge, "%tf_static", transform("base_link", "laser", (0, 0, 0), (0.0, 0.5, 0.0, 0.8)))
    assert listen(bridge, "%scan", scan()) == []
    assert bridge.condition().counters["set_aside_tilted"] == 1


def test_without_tf_the_mount_is_left_to_scan_ingest() -> None:
    bridge = core(mounts_from_tf=False)
    (output,) = listen(bridge, "%scan", scan())
    assert output.open(RawScan).mount == to_message((0, 0, 0))


def test_two_lidars_by_their_topics() -> None:
    bridge = core(scan=["front/scan", "/rear/scan"], mounts_from_tf=False, namespace="r17")
    assert listen(bridge, "%r17%front%scan", scan())[0].address["lidar"] == "r17_front"
    assert listen(bridge, "%rear%scan", scan())[0].address["lidar"] == "rear"


def test_odometry_is_published_with_frames_and_velocity() -> None:
    (output,) = listen(core(), "%odom", odometry(1.0, -2.0, 3.0))
    message = output.open(Odometry)
    assert output.channel is ODOMETRY
    assert (message.frame_id, message.body_frame_id) == ("odom", "base_link")
    assert from_pose3(message.pose) == pytest.approx([1.0, -2.0, 3.0])
    assert message.linear_velocity.x == 0.5
    assert message.angular_velocity.z == 0.2
    assert message.pose_covariance[35] == 0.03


def test_odometry_is_tfs_as_amcls_is() -> None:
    """A topic of odometry may be the wheels', and tf that of a filter: map to odom must fit to tf."""
    bridge = core()
    (output,) = listen(bridge, "%odom", odometry(7.0, 0.0, 0.0))
    assert output.open(Odometry).pose.position.x == 7.0
    half_turn = (0.0, 0.0, 1.0, 0.0)
    (output,) = listen(bridge, "%tf", transform("/odom", "/base_footprint", (1.0, -2.0, 0.1), half_turn))
    message = output.open(Odometry)
    assert output.channel is ODOMETRY
    assert nanoseconds(message.timestamp) == TIME
    assert (message.frame_id, message.body_frame_id) == ("odom", "base_footprint")
    assert from_pose3(message.pose) == pytest.approx([1.0, -2.0, np.pi])
    assert listen(bridge, "%odom", odometry(7.1, 0.0, 0.0)) == []
    # the mount is below the frame that tf moves
    listen(bridge, "%tf_static", transform("base_footprint", "base_link", (0.5, 0.0, 0.1), (0, 0, 0, 1)))
    listen(bridge, "%tf_static", transform("base_link", "laser", (0.2, 0.0, 0.1), (0, 0, 0, 1)))
    (output,) = listen(bridge, "%scan", scan("/laser"))
    assert output.open(RawScan).mount.x == pytest.approx(0.7)


def test_a_mount_follows_the_base_of_odometry() -> None:
    """Its topic may name another base than tf, which is received later."""
    bridge = core()
    listen(bridge, "%odom", odometry(0, 0, 0, base="base_link"))
    listen(bridge, "%tf_static", transform("base_footprint", "base_link", (0.5, 0.0, 0.1), (0, 0, 0, 1)))
    listen(bridge, "%tf_static", transform("base_link", "laser", (0.2, 0.0, 0.1), (0, 0, 0, 1)))
    assert listen(bridge, "%scan", scan())[0].open(RawScan).mount.x == pytest.approx(0.2)
    listen(bridge, "%tf", transform("odom", "base_footprint", (0, 0, 0), (0, 0, 0, 1)))
    assert listen(bridge, "%scan", scan())[0].open(RawScan).mount.x == pytest.approx(0.7)


def test_odometry_in_tf_of_a_robot_with_names_of_its_own() -> None:
    bridge = core(namespace="robot1", odom_frame="robot1/odom", odom="")
    assert listen(bridge, "%robot1%tf", transform("odom", "base_link", (1, 0, 0), (0, 0, 0, 1))) == []
    (output,) = listen(bridge, "%robot1%tf", transform("robot1/odom", "robot1/base", (1, 0, 0), (0, 0, 0, 1)))
    assert output.open(Odometry).body_frame_id == "robot1/base"
    mount = transform("robot1/base", "robot1/laser", (0.3, 0, 0), (0, 0, 0, 1))
    listen(bridge, "%robot1%tf_static", mount)
    assert len(listen(bridge, "%robot1%scan", scan("robot1/laser"))) == 1


@pytest.mark.parametrize("settings", [{}, {"base_frame": "/base_link"}], ids=["by itself", "named"])
@pytest.mark.parametrize("first", ["base_footprint", "dock"])
def test_another_child_of_the_odometry_frame_is_not_the_robot(first: str, settings: dict[str, Any]) -> None:
    """A dock or a marker is published in odom too: its pose was taken for the robot's, by turns."""
    bridge = core(**settings)
    listen(bridge, "%tf_static", transform("base_footprint", "base_link", (0.5, 0.0, 0.1), (0, 0, 0, 1)))
    listen(bridge, "%tf_static", transform("base_link", "laser", (0.2, 0.0, 0.1), (0, 0, 0, 1)))
    poses = {"base_footprint": (1.0, 0.0, 0.0), "dock": (7.0, 0.0, 0.0)}
    other = "dock" if first == "base_footprint" else "base_footprint"
    listen(bridge, "%tf", transform("odom", first, poses[first], (0, 0, 0, 1)))
    for child in 2 * (other, first):
        published = listen(bridge, "%tf", transform("odom", child, poses[child], (0, 0, 0, 1)))
        frames = [each.open(Odometry).body_frame_id for each in published]
        assert frames == (["base_footprint"] if child == "base_footprint" else [])
        mount = listen(bridge, "%scan", scan())[0].open(RawScan).mount
        assert mount.x == pytest.approx(0.2 if settings else 0.7)
    assert bridge.condition().counters["set_aside_odometry_of_another_frame"] == 2


def test_odometry_of_the_topic_only_where_it_is_wanted() -> None:
    bridge = core(odom_frame="")
    assert listen(bridge, "%tf", transform("odom", "base_link", (1, 0, 0), (0, 0, 0, 1))) == []
    assert len(listen(bridge, "%odom", odometry(7.0, 0.0, 0.0))) == 1


def test_odometry_in_tf_that_is_no_pose_is_counted() -> None:
    bridge = core()
    assert listen(bridge, "%tf", transform("odom", "base_link", (np.nan, 0, 0), (0, 0, 0, 1))) == []
    assert bridge.condition().counters["set_aside_odometry_not_a_pose"] == 1
    assert len(listen(bridge, "%odom", odometry(7.0, 0.0, 0.0))) == 1


def test_two_lidars_each_by_its_own_mount() -> None:
    """One ahead, one astern and upside down."""
    bridge = core(scan=["front/scan", "rear/scan"], base_frame="base_link")
    listen(bridge, "%tf_static", transform("base_link", "front", (0.4, 0.0, 0.2), (0, 0, 0, 1)))
    listen(bridge, "%tf_static", transform("base_link", "rear", (-0.4, 0.0, 0.2), (0, 1, 0, 0)))
    ahead = listen(bridge, "%front%scan", scan("front"))[0].open(RawScan)
    astern = listen(bridge, "%rear%scan", scan("rear"))[0].open(RawScan)
    assert (ahead.mount.x, ahead.upside_down) == (pytest.approx(0.4), False)
    assert (astern.mount.x, astern.upside_down) == (pytest.approx(-0.4), True)
    assert abs(astern.mount.theta) == pytest.approx(np.pi)


def test_a_clicked_pose_is_a_relocation() -> None:
    covariance = np.zeros((6, 6))
    covariance[0, 0], covariance[1, 1], covariance[5, 5], covariance[0, 5] = 0.25, 0.5, 0.07, 0.01
    stated = cdr.make("geometry_msgs/msg/PoseWithCovariance", pose(3.0, 4.0, -1.0), covariance.ravel())
    data = cdr.encode(cdr.make(cdr.POSE_WITH_COVARIANCE, header("map"), stated))
    (output,) = listen(core(), "%initialpose", data)
    message = output.open(Relocation)
    assert output.channel is RELOCATION
    assert (message.pose.x, message.pose.y, message.pose.theta) == pytest.approx((3.0, 4.0, -1.0))
    c = message.covariance
    assert (c.xx, c.yy, c.tt, c.xt) == (0.25, 0.5, 0.07, 0.01)


def click(frame: str) -> bytes:
    stated = cdr.make("geometry_msgs/msg/PoseWithCovariance", pose(3.0, 4.0, -1.0), np.zeros(36))
    return cdr.encode(cdr.make(cdr.POSE_WITH_COVARIANCE, header(frame), stated))


def test_a_click_in_another_frame_is_not_taken_and_reported_until_one_is() -> None:
    """AMCL refuses it as well: what holds in odom shows nothing about the map."""
    bridge = core(mounts_from_tf=False)
    listen(bridge, "%scan", scan())
    (unknown,) = listen(bridge, "%initialpose", click("odom"))  # no map has come: it may be one's frame
    assert unknown.channel is RELOCATION
    report(bridge, MAP, Grid(frame_id="map", cell_stride=1, row_stride=1, column_count=1, data=b"\0"))
    assert listen(bridge, "%initialpose", click("odom")) == []
    assert ask(bridge, "%set_initial_pose", click("odom")) == (b"\0\1\0\0\0", [])
    condition = bridge.condition()
    assert condition.status == Health.STATUS_OK
    assert condition.counters["set_aside_initial_pose_in_another_frame"] == 2
    assert "odom" in condition.detail
    assert "map" in condition.detail
    for frame in ("/map", ""):  # old tools write the slash, some write nothing
        assert [each.channel for each in listen(bridge, "%initialpose", click(frame))] == [RELOCATION]
    assert bridge.condition().detail == ""


def ask(bridge: RosBridgeCore, endpoint: str, request: bytes = b"\0\1\0\0\0") -> tuple[bytes, list[Envelope]]:
    """The response to a service's request, and what was published because of it."""
    asked = Envelope(ROS_ASKED, {"endpoint": endpoint, "number": "7"}, BytesValue(value=request))
    response, *because = Loopback([bridge]).receive(asked)
    assert response.channel is ROS_ANSWERED
    assert response.address == asked.address
    return response.open(BytesValue).value, because


def test_the_service_publishes_forget() -> None:
    response, (output,) = ask(core(), "%reinitialize_global_localization")
    assert response == b"\0\1\0\0\0"
    assert not output.open(Relocation).HasField("pose")


def test_every_scan_counts_anyhow() -> None:
    assert ask(core(), "%request_nomotion_update") == (b"\0\1\0\0\0", [])


def test_a_pose_by_service_is_a_relocation() -> None:
    stated = cdr.make("geometry_msgs/msg/PoseWithCovariance", pose(3.0, 4.0, -1.0), np.zeros(36))
    request = cdr.encode(cdr.make(cdr.POSE_WITH_COVARIANCE, header("map"), stated))
    response, (output,) = ask(core(), "%set_initial_pose", request)
    assert response == b"\0\1\0\0\0"
    assert output.open(Relocation).pose.x == 3.0


def test_a_request_that_is_none_is_answered_by_nothing() -> None:
    bridge = core()
    assert ask(bridge, "%set_initial_pose", b"\0\1\0\0") == (b"", [])
    assert bridge.condition().counters["set_aside_not_cdr"] == 1


@pytest.mark.parametrize("channel", [POSE, HEALTH])
def test_a_stamp_that_ros_cannot_hold_is_counted(channel: Channel) -> None:
    bridge, late = core(), stamp(2**31 * 10**9)
    message = (
        PoseEstimate(timestamp=late, state=STATE_LOCALIZED)
        if channel is POSE
        else Health(timestamp=late, service="tracker", instance="r")
    )
    address = SITE | {"service": "tracker", "instance": "r"}
    assert list(bridge.handle(Envelope(channel, address, message))) == []
    assert bridge.condition().counters["set_aside_not_cdr"] == 1


def test_only_a_claimed_pose_is_published() -> None:
    bridge = core()
    estimate = PoseEstimate(timestamp=stamp(TIME), frame_id="map", pose=to_message((1, 2, 0.5)))
    for state in (STATE_LOST, STATE_AMBIGUOUS):
        estimate.state = state
        assert report(bridge, POSE, estimate) == []
    estimate.state = STATE_LOCALIZED
    ((endpoint, data),) = report(bridge, POSE, estimate)
    body = cdr.decode(cdr.POSE_WITH_COVARIANCE, data)
    assert endpoint == "%amcl_pose"
    assert (body.pose.pose.position.x, body.header.frame_id) == (1.0, "map")


def test_the_floor_is_published_when_it_changes() -> None:
    bridge, output = core(), list[str]()
    for state, floor in (
        (STATE_LOST, ""),
        (STATE_LOCALIZED, "ground"),
        (STATE_LOCALIZED, "ground"),
        (STATE_AMBIGUOUS, "first"),
        (STATE_LOCALIZED, "first"),
    ):
        message = PoseEstimate(timestamp=stamp(TIME), frame_id="map", state=state, floor=floor)
        for one in bridge.handle(Envelope(POSE, SITE, message)):
            if one.address["endpoint"] == "%floor":
                output.append(cdr.decode(cdr.STRING, one.open(BytesValue).value).data)
    assert output == ["ground", "", "first"]


def test_map_to_odom_is_dated_ahead() -> None:
    message = FrameTransform(timestamp=stamp(TIME), parent_frame_id="map", child_frame_id="odom")
    message.rotation.w = 1.0
    ((endpoint, data),) = report(core(transform_tolerance=0.5), TRANSFORM, message)
    (item,) = cdr.decode(cdr.TRANSFORMS, data).transforms
    assert endpoint == "%tf"
    assert item.header.stamp.sec * 10**9 + item.header.stamp.nanosec == TIME + 500_000_000


@pytest.mark.parametrize("channel", [POSE, TRANSFORM, TRACKS, MAP])
def test_what_is_switched_off_is_not_published(channel: Any) -> None:
    bridge = core(pose="", tf="", particles="", map="")
    messages = {
        POSE: PoseEstimate(state=STATE_LOCALIZED),
        TRANSFORM: FrameTransform(),
        TRACKS: Tracks(),
        MAP: Grid(),
    }
    assert report(bridge, channel, messages[channel]) == []


def test_a_grid_that_is_no_map_is_counted() -> None:
    bridge = core()
    assert report(bridge, MAP, Grid(column_count=3, data=b"12345")) == []
    assert bridge.condition().counters["set_aside_not_a_map"] == 1


def bad(data: bytes) -> bytes:
    return data[: len(data) // 2]


@pytest.mark.parametrize(
    ("endpoint", "data", "counter"),
    [
        ("%scan", bad(scan()), "set_aside_not_cdr"),
        ("%odom", bad(odometry(0, 0, 0)), "set_aside_not_cdr"),
        ("%tf_static", bad(MOUNT), "set_aside_not_cdr"),
        ("%initialpose", b"", "set_aside_not_cdr"),
        ("%odom", odometry(np.nan, 0, 0), "set_aside_odometry_not_a_pose"),
        ("%odom", odometry(1e300, 0, 0), "set_aside_odometry_not_a_pose"),
    ],
)
def test_what_is_no_message_is_counted_and_the_next_one_goes_through(
    endpoint: str, data: bytes, counter: str
) -> None:
    bridge = core(mounts_from_tf=True, base_frame="base_link")
    with np.errstate(invalid="ignore"):
        assert listen(bridge, endpoint, data) == []
    assert bridge.condition().counters[counter] == 1
    listen(bridge, "%tf_static", MOUNT)
    assert [each.channel for each in listen(bridge, "%scan", scan())] == [SCAN_RAW]


@pytest.mark.parametrize("other", ["%odom", "%tf_static", "%initialpose"])
def test_a_message_of_another_type_is_no_scan(other: str) -> None:
    """As from a robot whose topics were mixed up: sound bytes of the wrong schema."""
    sound = {"%odom": odometry(1.0, 2.0, 0.5), "%tf_static": MOUNT}
    bridge = core(mounts_from_tf=False)
    assert listen(bridge, "%scan", sound.get(other, odometry(0, 0, 0))) == []
    condition = bridge.condition()
    assert condition.counters["set_aside_not_cdr"] == 1
    assert condition.status == Health.STATUS_WAITING
    named = "/scan: its messages are no sensor_msgs/msg/LaserScan: name a topic of that type"
    assert condition.detail == named
    assert [each.channel for each in listen(bridge, "%scan", scan())] == [SCAN_RAW]
    assert bridge.condition().status == Health.STATUS_OK


@pytest.mark.parametrize("bad_number", [np.nan, np.inf, -np.inf])
def test_no_number_that_is_not_finite_reaches_nav2(bad_number: float) -> None:
    """From a foreign tracker: counted, and the next one goes through."""
    bridge, at = core(), stamp(TIME)
    sound = to_message((1.0, 2.0, 0.5))
    wrong = [to_message((bad_number, 0.0, 0.0)), to_message((0.0, 0.0, bad_number))]
    estimates = [PoseEstimate(timestamp=at, state=STATE_LOCALIZED, pose=pose) for pose in (*wrong, sound)]
    estimates[0].pose.CopyFrom(sound)
    estimates[0].covariance.xt = bad_number
    moves = [FrameTransform(timestamp=at), FrameTransform(timestamp=at)]
    moves[0].rotation.z = bad_number
    tracks = [Tracks(timestamp=at, tracks=[Track(pose=pose, probability=1.0)]) for pose in (*wrong, sound)]
    published = [
        endpoint
        for channel, messages in ((POSE, estimates), (TRANSFORM, moves), (TRACKS, tracks))
        for message in messages
        for endpoint, _ in report(bridge, channel, message)
    ]
    assert published == ["%amcl_pose", "%tf", "%particle_cloud"]
    assert bridge.condition().counters["set_aside_not_finite"] == 5


def test_a_covariance_that_is_none_is_not_stated() -> None:
    stated = cdr.make("geometry_msgs/msg/PoseWithCovariance", pose(3.0, 4.0, -1.0), np.full(36, np.nan))
    data = cdr.encode(cdr.make(cdr.POSE_WITH_COVARIANCE, header("map"), stated))
    (output,) = listen(core(), "%initialpose", data)
    assert not output.open(Relocation).HasField("covariance")


@pytest.mark.parametrize(
    ("settings", "part"),
    [
        ({"robot": "*"}, "one robot"),
        ({"scan": []}, "at least 1"),
        ({"scan": ["scan", "scan"]}, "each topic once; /scan"),
        ({"scan": ["scan", "/scan"]}, "each topic once; /scan"),
        ({"scan": ["a/scan"], "points": ["/r1/a/scan"], "namespace": "r1"}, "each topic once; /r1/a/scan"),
        ({"odom": "od om"}, "ROS name"),
        ({"domain": 500}, "232"),
        ({"ros_router": "localhost:7447"}, "match"),
        ({"ros_router": "tcp/a:1", "ros_zenoh": "x.json5"}, "one of"),
    ],
)
def test_settings_that_do_not_hold(settings: dict[str, Any], part: str) -> None:
    with pytest.raises(ValueError, match=part):
        core(**settings)


def test_the_domain_is_ros_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert RosBridgeOptions().domain == 42
    assert RosBridgeOptions(domain=7).domain == 7
