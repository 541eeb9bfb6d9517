"""The bridge and a robot's ROS 2 graph on hiroz, an independent implementation of rmw_zenoh's wire in Rust.

Keys, tokens, hashes of types, attachments and CDR are hiroz's own. The peer publishes as drivers and RViz do,
receives and calls as Nav2's nodes do. `make test-all` begins to build it at its start: that takes minutes.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.gridmap import GridMap, write_map
from eigenscan.geometry.gridmap import to_message as to_grid
from eigenscan.geometry.pose import from_pose3, to_message
from eigenscan.schemas.channels import (
    HEALTH,
    MAP,
    ODOMETRY,
    POSE,
    RELOCATION,
    SCAN_RAW,
    TRACKS,
    TRANSFORM,
)
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Relocation, Track, Tracks
from eigenscan.workbench.simulation.live import publish
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

from tests.environment import ROOT
from tests.services.ros_bridge.conftest import DOMAINS, PATIENCE_S, Bridge, Network, eventually, pipeline

pytestmark = [pytest.mark.cargo, pytest.mark.timeout(3600)]

SOURCE = Path(__file__).with_name("nav2_peer")
TARGET = ROOT / "out/rust"
TIME = 1_700_000_000_250_000_000
SECONDS = 10.0
DIALECTS = {"jazzy": "rmw_zenoh", "lyrical": "rmw_zenoh", "humble": "rmw_zenoh_humble"}
"""The ROS distributions that hiroz is built for, and how the bridge speaks to each."""

Start = Callable[..., Bridge]


class Peer:
    """The program, and all that it received."""

    def __init__(self, program: Path, network: Network, domain: int) -> None:
        self.domain = domain
        self.topics: dict[str, list[Any]] = defaultdict(list)
        self.responses: dict[str, list[Any]] = defaultdict(list)
        self._process = subprocess.Popen(
            [program, network.endpoint, str(domain)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._ready = threading.Event()
        self._reading = threading.Thread(target=self._read)
        self._reading.start()
        assert self._ready.wait(PATIENCE_S)

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            came = json.loads(line)
            if "ready" in came:
                self._ready.set()
            elif "topic" in came:
                self.topics[came["topic"]].append(came["message"])
            else:
                self.responses[came["service"]].append(came.get("response"))

    def _order(self, **order: Any) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()

    def publish(self, topic: str, message: Any) -> None:
        self._order(publish=topic, message=message)

    def call(self, service: str, request: Any) -> Any:
        """Its response; asked again until there is one."""

        def answer() -> Any:
            before = len(self.responses[service])
            self._order(call=service, request=request)
            eventually(lambda: self.responses[service][before:], f"an end of {service}")
            return self.responses[service][-1]

        got: list[Any] = eventually(
            lambda: [r for r in [answer()] if r is not None], f"the response of {service}"
        )
        return got[0]

    def close(self) -> None:
        with self._process:
            assert self._process.stdin is not None
            self._process.stdin.close()
            self._reading.join()
        assert self._process.returncode == 0


@pytest.fixture(scope="session", params=DIALECTS)
def distribution(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="session")
def program(distribution: str) -> Path:
    """The peer for one distribution; its dependencies are built once."""
    chosen = ["--no-default-features", "--features", distribution]
    subprocess.run(["cargo", "build", *chosen, "--target-dir", TARGET], cwd=SOURCE, check=True)
    return Path(shutil.copy(TARGET / "debug/nav2-peer", TARGET / f"nav2-peer-{distribution}"))


@pytest.fixture
def peer(program: Path, network: Network) -> Iterator[Peer]:
    peer = Peer(program, network, next(DOMAINS))
    yield peer
    peer.close()


@pytest.fixture
def bridge(start: Start, peer: Peer, distribution: str) -> Bridge:
    return start(
        "--domain", str(peer.domain), "--dialect", DIALECTS[distribution], "--points", '["points"]'
    )  # fmt: skip


def header(frame: str, time_ns: int = TIME) -> Any:
    sec, nanosec = divmod(time_ns, 10**9)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}


def vector(x: float, y: float, z: float) -> Any:
    return {"x": x, "y": y, "z": z}


def turn(theta: float) -> Any:
    return {"x": 0.0, "y": 0.0, "z": float(np.sin(theta / 2)), "w": float(np.cos(theta / 2))}


def tf(parent: str, child: str, x: float, y: float, theta: float, time_ns: int = TIME) -> Any:
    transform = {"translation": vector(x, y, 0.0), "rotation": turn(theta)}
    return {
        "transforms": [{"header": header(parent, time_ns), "child_frame_id": child, "transform": transform}]
    }


def scan(ranges: list[float], time_ns: int = TIME, **more: float) -> Any:
    fixed = {"angle_min": -1.0, "angle_max": 1.0, "angle_increment": 1.0, "time_increment": 0.0}
    fixed |= {"scan_time": 0.1, "range_min": 0.05, "range_max": 30.0}
    return {"header": header("laser", time_ns), "ranges": ranges, "intensities": [], **fixed, **more}


def pose_with_covariance(x: float, y: float, theta: float) -> Any:
    pose = {"position": vector(x, y, 0.0), "orientation": turn(theta)}
    return {"header": header("map"), "pose": {"pose": pose, "covariance": 36 * [0.0]}}


def test_what_a_robot_publishes_arrives(bridge: Bridge, peer: Peer) -> None:
    zero = {"linear": vector(0.5, 0.0, 0.0), "angular": vector(0.0, 0.0, 0.2)}
    wheels = {
        "header": header("odom"),
        "child_frame_id": "base_link",
        "pose": {
            "pose": {"position": vector(5.0, 6.0, 0.0), "orientation": turn(0.0)},
            "covariance": 36 * [0.5],
        },
        "twist": {"twist": zero, "covariance": 36 * [0.0]},
    }

    def moved(x: float) -> Callable[[], list[Odometry]]:
        def found() -> list[Odometry]:
            peer.publish("/odom", wheels) if x == 5.0 else peer.publish(
                "/tf", tf("odom", "base_link", x, 2.0, np.pi)
            )
            return [each for each in bridge.ear.of(ODOMETRY, Odometry) if each.pose.position.x == x]

        return found

    first = eventually(moved(5.0), "odometry of its topic")[0]
    assert (first.frame_id, first.body_frame_id, first.pose_covariance[0]) == ("odom", "base_link", 0.5)
    second = eventually(moved(1.0), "odometry of tf")[0]
    assert from_pose3(second.pose) == pytest.approx([1.0, 2.0, np.pi])

    peer.publish("/tf_static", tf("base_link", "laser", 0.2, 0.1, 0.0))

    def scanned() -> list[RawScan]:
        peer.publish("/scan", scan([1.0, 2.5, 3.0]))
        return bridge.ear.of(SCAN_RAW, RawScan)

    raw = eventually(scanned, "a scan")[-1]
    assert (nanoseconds(raw.timestamp), list(raw.ranges)) == (TIME, [1.0, 2.5, 3.0])
    assert (raw.mount.x, raw.mount.y, raw.angle_increment) == pytest.approx((0.2, 0.1, 1.0))


def test_a_3d_lidars_cloud_becomes_a_scan(bridge: Bridge, peer: Peer) -> None:
    fields = [{"name": name, "offset": 4 * at, "datatype": 7, "count": 1} for at, name in enumerate("xyz")]
    points = np.array([(3.0, 0.0, 0.3), (2.0, 0.0, 1.5), (np.nan, 0.0, 0.0)], np.float32)
    cloud = {
        "header": header("laser"), "height": 1, "width": 3, "fields": fields, "is_bigendian": False,
        "point_step": 12, "row_step": 36, "data": list(points.tobytes()), "is_dense": False,
    }  # fmt: skip

    def scanned() -> list[RawScan]:
        peer.publish("/tf", tf("odom", "base_link", 0.0, 0.0, 0.0))
        peer.publish("/tf_static", tf("base_link", "laser", 0.2, 0.1, 0.0))
        peer.publish("/points", cloud)
        return bridge.ear.of(SCAN_RAW, RawScan)

    ranges = np.array(eventually(scanned, "a scan of the cloud")[-1].ranges)
    assert ranges[np.isfinite(ranges)] == pytest.approx([3.0])
    eventually(lambda: bridge.counter("cloud_points_not_finite"), "the count of what is not finite")


def test_an_operator_relocates_the_robot(bridge: Bridge, peer: Peer) -> None:
    def clicked() -> list[Relocation]:
        peer.publish("/initialpose", pose_with_covariance(4.0, 5.0, 1.0))
        return bridge.ear.of(RELOCATION, Relocation)

    click = eventually(clicked, "the click")[0]
    assert (click.pose.x, click.pose.y, click.frame_id) == (4.0, 5.0, "map")
    assert click.pose.theta == pytest.approx(1.0)
    peer.call("/set_initial_pose", {"pose": pose_with_covariance(7.0, 8.0, 0.0)})
    eventually(lambda: [r for r in bridge.ear.of(RELOCATION, Relocation) if r.pose.x == 7.0], "the pose")
    peer.call("/reinitialize_global_localization", {})
    eventually(
        lambda: [r for r in bridge.ear.of(RELOCATION, Relocation) if not r.HasField("pose")], "the request"
    )
    peer.call("/request_nomotion_update", {})


def test_what_nav2_subscribes_to_arrives(bridge: Bridge, peer: Peer) -> None:
    robot = {"site": bridge.site, "robot": "robot"}
    estimate = PoseEstimate(timestamp=stamp(TIME), frame_id="map", state=STATE_LOCALIZED, floor="2nd")
    estimate.pose.CopyFrom(to_message((1.5, -2.0, 0.7)))
    estimate.covariance.xx, estimate.covariance.yt = 0.04, 0.003
    move = FrameTransform(timestamp=stamp(TIME), parent_frame_id="map", child_frame_id="odom")
    move.translation.x, move.rotation.w = 3.0, 1.0
    tracks = Tracks(timestamp=stamp(TIME), frame_id="map", tracks=[Track(probability=0.9)])
    health = Health(timestamp=stamp(TIME), service="tracker", instance="robot", status=Health.STATUS_OK)
    grid = GridMap(np.array([[0, 100, 255], [0, 0, 0]], np.uint8), 0.05, np.array([-1.0, 2.0, 0.0]))
    bridge.ear.bus.offer([MAP], {"site": bridge.site})
    bridge.ear.bus.publish(Envelope(MAP, {"site": bridge.site}, to_grid(grid, "map")))
    wanted = {"/amcl_pose", "/tf", "/particle_cloud", "/map", "/floor", "/diagnostics"}

    def complete() -> bool:
        for channel, message in ((POSE, estimate), (TRANSFORM, move), (TRACKS, tracks)):
            bridge.ear.bus.publish(Envelope(channel, robot, message))
        bridge.ear.bus.publish(Envelope(HEALTH, robot | {"service": "tracker", "instance": "robot"}, health))
        time.sleep(0.2)
        return wanted <= {topic for topic, messages in peer.topics.items() if messages}

    eventually(complete, "all topics")
    pose = peer.topics["/amcl_pose"][0]
    assert pose["header"] == header("map")
    assert (pose["pose"]["pose"]["position"]["x"], pose["pose"]["covariance"][0]) == (1.5, 0.04)
    assert pose["pose"]["covariance"][11] == 0.003
    (item,) = peer.topics["/tf"][0]["transforms"]
    assert (item["header"]["frame_id"], item["child_frame_id"]) == ("map", "odom")
    assert item["transform"]["translation"]["x"] == 3.0
    assert peer.topics["/particle_cloud"][0]["particles"][0]["weight"] == 0.9
    assert peer.topics["/map"][0]["data"] == [0, 100, -1, 0, 0, 0]
    assert peer.topics["/floor"][-1]["data"] == "2nd"

    def localized() -> list[Any]:
        complete()
        all_of = [status for array in peer.topics["/diagnostics"] for status in array["status"]]
        return [each for each in all_of if each["name"] == "eigenscan: localization" and each["level"] == 0]

    (status, *_) = eventually(localized, "the state in /diagnostics")
    assert {pair["key"]: pair["value"] for pair in status["values"]}["floor"] == "2nd"


def test_who_comes_late_gets_the_last_pose_and_the_map(
    bridge: Bridge, peer: Peer, program: Path, network: Network
) -> None:
    estimate = PoseEstimate(timestamp=stamp(TIME), frame_id="map", state=STATE_LOCALIZED)
    estimate.pose.CopyFrom(to_message((1.5, -2.0, 0.7)))
    grid = GridMap(np.zeros((2, 3), np.uint8), 0.05, np.zeros(3))
    bridge.ear.bus.offer([MAP], {"site": bridge.site})
    bridge.ear.bus.publish(Envelope(MAP, {"site": bridge.site}, to_grid(grid, "map")))
    bridge.ear.bus.publish(Envelope(POSE, {"site": bridge.site, "robot": "robot"}, estimate))
    eventually(lambda: peer.topics["/amcl_pose"] and peer.topics["/map"], "pose and map")
    late = Peer(program, network, peer.domain)
    eventually(lambda: late.topics["/amcl_pose"] and late.topics["/map"], "pose and map, late")
    assert late.topics["/amcl_pose"][0]["pose"]["pose"]["position"]["x"] == 1.5
    late.close()


def test_a_lifecycle_manager_and_its_bond(bridge: Bridge, peer: Peer) -> None:
    assert peer.call("/amcl/get_state", {})["current_state"] == {"id": 3, "label": "active"}
    states = peer.call("/amcl/get_available_states", {})["available_states"]
    assert [state["label"] for state in states] == ["unconfigured", "inactive", "active", "finalized"]
    transitions = peer.call("/amcl/get_available_transitions", {})["available_transitions"]
    assert {each["transition"]["label"] for each in transitions} >= {"configure", "activate", "deactivate"}

    def change(number: int) -> str:
        assert peer.call("/amcl/change_state", {"transition": {"id": number, "label": ""}})["success"]
        return str(peer.call("/amcl/get_state", {})["current_state"]["label"])

    assert [change(number) for number in (4, 2, 1, 3)] == ["inactive", "unconfigured", "inactive", "active"]

    def beat() -> list[Any]:
        times = {"heartbeat_timeout": 4.0, "heartbeat_period": 0.25}
        beat = {"header": header(""), "id": "amcl", "instance_id": "manager", "active": True, **times}
        peer.publish("/bond", beat)
        time.sleep(0.1)
        return [each for each in peer.topics["/bond"] if each["instance_id"] != "manager"]

    answer = eventually(beat, "a heartbeat")[0]
    assert (answer["id"], answer["active"], answer["heartbeat_timeout"]) == ("amcl", True, 4.0)


def test_ros2_param(bridge: Bridge, peer: Peer) -> None:
    names = peer.call("/amcl/list_parameters", {"prefixes": [], "depth": 0})["result"]["names"]
    assert {"odom_frame_id", "tf_broadcast", "transform_tolerance"} <= set(names)
    (value,) = peer.call("/amcl/get_parameters", {"names": ["odom_frame_id"]})["values"]
    assert value["string_value"] == "odom"
    assert len(peer.call("/amcl/get_parameter_types", {"names": names})["types"]) == len(names)
    (about,) = peer.call("/amcl/describe_parameters", {"names": ["transform_tolerance"]})["descriptors"]
    assert (about["name"], about["type"], about["read_only"]) == ("transform_tolerance", 3, False)

    def put(name: str, given: Any) -> Any:
        asked = {"parameters": [{"name": name, "value": given}]}
        return peer.call("/amcl/set_parameters", asked)["results"][0]

    assert "read-only" in put("odom_frame_id", value)["reason"]
    (number,) = peer.call("/amcl/get_parameters", {"names": ["transform_tolerance"]})["values"]
    assert put("transform_tolerance", {**number, "double_value": 0.5})["successful"]
    (number,) = peer.call("/amcl/get_parameters", {"names": ["transform_tolerance"]})["values"]
    assert number["double_value"] == 0.5


class Driver:
    """Publishes what the simulated robot measures."""

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self._mounted = False

    def publish(self, envelope: Envelope) -> None:
        if envelope.channel is ODOMETRY:
            message = envelope.open(Odometry)
            x, y, theta = from_pose3(message.pose).tolist()
            at = nanoseconds(message.timestamp)
            self._peer.publish("/tf", tf("odom", "base_footprint", x, y, theta, at))
        elif envelope.channel is SCAN_RAW:
            raw = envelope.open(RawScan)
            if not self._mounted:
                mount = raw.mount
                self._peer.publish(
                    "/tf_static", tf("base_footprint", "laser", mount.x, mount.y, mount.theta, 0)
                )
                self._mounted = True
            # JSON has no infinity; beyond the limit is the same
            ranges = np.nan_to_num(np.array(raw.ranges), nan=0.0, posinf=2.0 * raw.range_max).tolist()
            limits = {"angle_min": raw.angle_min, "angle_increment": raw.angle_increment}
            limits |= {"range_max": raw.range_max, "range_min": raw.range_min}
            self._peer.publish("/scan", scan(ranges, nanoseconds(raw.timestamp), **limits))


def test_its_robot_is_localized(network: Network, peer: Peer, distribution: str, tmp_path: Path) -> None:
    stage = Stage(office().render(), Scenario(seconds=SECONDS, people=2))
    write_map(stage.grid, tmp_path / "map.yaml")
    flags = ("--map", tmp_path / "map.yaml")
    domain = {"ROS_DOMAIN_ID": str(peer.domain)}
    with pipeline(network, tmp_path / "out", DIALECTS[distribution], network.endpoint, *flags, **domain):
        stage.epoch = time.time_ns()
        publish(stage.messages(), Driver(peer).publish)
        eventually(lambda: peer.topics["/amcl_pose"], "a pose")
        time.sleep(1.0)
    errors = []
    for message in peer.topics["/amcl_pose"]:
        at = message["header"]["stamp"]["sec"] * 10**9 + message["header"]["stamp"]["nanosec"]
        truth, claimed = stage.pose_at(at), message["pose"]["pose"]["position"]
        if truth is not None:
            errors.append(float(np.hypot(claimed["x"] - truth[0], claimed["y"] - truth[1])))
    print(
        f"{distribution}: {len(errors)} poses, "
        f"median error {np.median(errors):.3f} m, worst {max(errors):.3f} m"
    )
    assert len(errors) > 0.5 * SECONDS * stage.scenario.lidar.rate
    assert np.median(errors) < 0.1
    assert max(errors) < 0.5
    children = {
        (item["header"]["frame_id"], item["child_frame_id"])
        for message in peer.topics["/tf"]
        for item in message["transforms"]
    }
    assert ("map", "odom") in children
