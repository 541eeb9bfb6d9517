"""The stack of docker-compose.yml as a user starts it: built, healthy, localized, and down again."""

import json
import math
import socket
import subprocess
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from urllib.request import urlopen

import pytest
import yaml
from eigenscan.geometry.pose import between, from_message, from_pose3
from eigenscan.ros_bridge import cdr
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.recording import is_complete, read
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import HEALTH, POSE, TRUTH
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.schemas.wire import decode
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

from tests.docker.conftest import MARKS, PROFILES, compose, docker, until
from tests.environment import PATIENT, ROOT

SERVICES = (
    "router",
    "mapbuilder",
    "recorder",
    "scan-ingest",
    "projector",
    "tracker",
    "ros-bridge",
    "simulator",
)
PATIENCE_S = 600.0
"""What a step may take on a machine that is busy."""
EXHAUSTIVE = ROOT / "examples/exhaustive-projector/docker-compose.yml"
RUST_INGEST = ROOT / "examples/scan-ingest-rust"
RUST_TARGET = ROOT / "out/rust"

pytestmark = MARKS


@dataclass
class Stack:
    """One project of docker-compose.yml, apart from every other."""

    project: str
    images: str
    site: str
    port: int
    viewer_port: int
    data_port: int
    patient: Path
    """Gives its services time to end."""

    def compose(self, *arguments: str, over: Sequence[Path] = ()) -> str:
        """Runs docker-compose; `over` are files that change docker-compose.yml."""
        environment = {
            "EIGENSCAN_IMAGES": self.images,
            "EIGENSCAN_SITE": self.site,
            "EIGENSCAN_PORT": str(self.port),
            "EIGENSCAN_VIEWER_PORT": str(self.viewer_port),
            "EIGENSCAN_DATA_PORT": str(self.data_port),
            # here the site's own router stands for the one of a robot with ROS 2
            "EIGENSCAN_ROS_ROUTER": "tcp/router:7447",
            "EIGENSCAN_RUST": str(RUST_TARGET / "release"),
        }
        files = ("docker-compose.yml", str(self.patient), *map(str, over))
        return compose("-p", self.project, *PROFILES, *arguments, environment=environment, files=files)

    def container(self, service: str) -> str:
        return self.compose("ps", "-q", service).strip()

    def inspect(self, service: str) -> dict[str, dict[str, object]]:
        (found,) = json.loads(docker("inspect", self.container(service)))
        return dict(found)

    def python(self, service: str, code: str) -> str:
        return docker("exec", self.container(service), "python", "-c", code)


@pytest.fixture(scope="module")
def stack(images: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    name = f"eigenscan-test-{uuid.uuid4().hex[:8]}"
    with ExitStack() as taken:
        servers = [taken.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(3)]
        port, viewer_port, data_port = (int(server.getsockname()[1]) for server in servers)
    patient = tmp_path_factory.mktemp("stack") / "patient.yml"
    more = {"environment": PATIENT, "stop_grace_period": "120s"}
    patient.write_text(json.dumps({"services": dict.fromkeys(SERVICES, more)}))
    stack = Stack(name, images, name, port, viewer_port, data_port, patient)
    try:
        stack.compose("up", "-d")
        yield stack
    finally:
        print(stack.compose("logs", "--no-color", "--tail", "40"))
        stack.compose("down", "-v", "--remove-orphans", "-t", "5")


@pytest.fixture(scope="module")
def client(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The configuration of a client of the router's published port."""
    config = tmp_path_factory.mktemp("zenoh") / "client.json5"
    config.write_text(
        f"{{mode: 'client', connect: {{endpoints: ['tcp/127.0.0.1:{stack.port}'], timeout_ms: -1}},"
        " scouting: {multicast: {enabled: false}}}"
    )
    return config


@pytest.fixture(scope="module")
def bus(client: Path) -> Iterator[Bus]:
    with Bus(open_session(client)) as bus:
        yield bus


def _state(stack: Stack, service: str) -> str:
    state = stack.inspect(service)["State"]
    health = state.get("Health")
    return str(health["Status"]) if isinstance(health, dict) else str(state["Status"])


def test_all_become_healthy(stack: Stack) -> None:
    states: dict[str, str] = {}

    def well() -> bool:
        states.update({service: _state(stack, service) for service in SERVICES})
        return all(states[one] == ("running" if one == "simulator" else "healthy") for one in SERVICES)

    until(well, PATIENCE_S, lambda: f"not healthy: {states}")


def test_none_has_rights_it_does_not_need(stack: Stack) -> None:
    for service in SERVICES:
        found = stack.inspect(service)
        host, config = found["HostConfig"], found["Config"]
        assert config["User"] == "10001:10001", service
        assert host["ReadonlyRootfs"] is True, service
        assert host["CapDrop"] == ["ALL"], service
        assert host["SecurityOpt"] == ["no-new-privileges:true"], service
        assert host["Memory"] > 0, service  # type: ignore[operator]
        assert host["NanoCpus"] > 0, service  # type: ignore[operator]
        assert host["Privileged"] is False, service


def _is_right(estimate: PoseEstimate, truth: PoseInFrame) -> bool:
    x, y, turn = between(from_pose3(truth.pose), from_message(estimate.pose)).tolist()
    return math.hypot(x, y) < 0.5 and abs(turn) < math.radians(10)


def _await_right_claims(stack: Stack, bus: Bus, claims: int) -> None:
    """Waits for so many right claims in a row, from now on."""
    inbox, truths, right = Inbox(), dict[int, PoseInFrame](), 0
    bus.listen([POSE, TRUTH], {"site": stack.site}, inbox)
    end = time.monotonic() + PATIENCE_S
    while right < claims:
        assert time.monotonic() < end, f"not found among {len(truths)} scans"
        arrival = inbox.take(1.0)
        if arrival is None:
            continue
        message = decode(arrival.channel, arrival.payload, arrival.encoding)
        if isinstance(message, PoseInFrame):
            truths[nanoseconds(message.timestamp)] = message
        elif isinstance(message, PoseEstimate) and nanoseconds(message.timestamp) in truths:
            claimed = message.state == STATE_LOCALIZED
            right = right + 1 if claimed and _is_right(message, truths[nanoseconds(message.timestamp)]) else 0


def test_the_robot_is_found(stack: Stack, bus: Bus) -> None:
    _await_right_claims(stack, bus, 10)


def test_ros_2_receives_the_pose(stack: Stack, client: Path) -> None:
    received: list[bytes] = []
    with open_session(client) as session:
        session.declare_subscriber(
            "0/amcl_pose/**", lambda sample: received.append(sample.payload.to_bytes())
        )
        until(lambda: bool(received), PATIENCE_S, lambda: "no /amcl_pose")
    assert cdr.decode(cdr.POSE_WITH_COVARIANCE, received[-1]).header.frame_id == "map"


def test_no_message_comes_twice_by_two_ways(stack: Stack, bus: Bus) -> None:
    inbox = Inbox()
    bus.listen([POSE], {"site": stack.site}, inbox)
    stamps = []
    for _ in range(50):
        arrival = inbox.take(PATIENCE_S)
        assert arrival is not None
        message = decode(POSE, arrival.payload, arrival.encoding)
        assert isinstance(message, PoseEstimate)
        stamps.append(nanoseconds(message.timestamp))
    assert stamps == sorted(set(stamps))


def test_every_service_publishes_its_health_at_the_site(stack: Stack, bus: Bus) -> None:
    inbox = Inbox()
    bus.listen([HEALTH], {"site": stack.site}, inbox)
    received: set[str] = set()
    end = time.monotonic() + PATIENCE_S
    while received != set(SERVICES) - {"simulator"}:
        assert time.monotonic() < end, received
        arrival = inbox.take(1.0)
        if arrival is not None:
            received.add((HEALTH.parse(arrival.key) or {})["service"])


COUNT_POSES = """
import urllib.request
for line in urllib.request.urlopen("http://127.0.0.1:9100/metrics").read().decode().splitlines():
    if line.startswith('eigenscan_messages_total{what="said_pose"}'):
        print(float(line.split()[1]))
"""


def test_the_live_picture_is_served(stack: Stack) -> None:
    links = [
        line for line in stack.compose("logs", "--no-color", "recorder").splitlines() if "viewer: " in line
    ]
    assert len(links) == 1
    link = links[0].partition("viewer: ")[2].strip()
    assert link.startswith(f"http://127.0.0.1:{stack.viewer_port}/?url=")
    assert f"127.0.0.1%3A{stack.data_port}" in link
    with urlopen(link, timeout=PATIENCE_S) as page:
        assert b"rerun" in page.read().lower()
    with socket.create_connection(("127.0.0.1", stack.data_port), timeout=PATIENCE_S):
        pass


def test_the_robot_goes_on_without_the_site(stack: Stack, bus: Bus) -> None:
    stack.compose("stop", "router")
    before = float(stack.python("tracker", COUNT_POSES))
    until(
        lambda: float(stack.python("tracker", COUNT_POSES)) > before + 20,
        PATIENCE_S,
        lambda: "no pose without a router",
    )
    inbox = Inbox()
    bus.listen([POSE], {"site": stack.site}, inbox)
    stack.compose("start", "router")
    assert inbox.take(PATIENCE_S) is not None, "no pose came to the site after the router was back"


def _settings_reported(stack: Stack, bus: Bus, service: str) -> dict[str, object]:
    """What a service states of itself, from now on."""
    inbox = Inbox()
    bus.listen([HEALTH], {"site": stack.site, "service": service}, inbox)
    arrival = inbox.take(PATIENCE_S)
    assert arrival is not None, f"{service} is silent"
    health = decode(HEALTH, arrival.payload, arrival.encoding)
    assert isinstance(health, Health)
    return dict(json.loads(health.settings))


def _swap(stack: Stack, bus: Bus, service: str, over: Path) -> None:
    """A stranger takes a service's place; the robot, lost with the tracker's memory, is found again."""
    ours = _settings_reported(stack, bus, service)
    before = stack.container(service)
    stack.compose("up", "-d", "--no-deps", "--build", service, over=[over])
    assert stack.container(service) != before
    until(
        lambda: _settings_reported(stack, bus, service).keys() != ours.keys(),
        PATIENCE_S,
        lambda: f"{service} is still ours",
    )
    stack.compose("restart", "-t", "5", "tracker")
    _await_right_claims(stack, bus, 10)


def test_a_projector_of_another_kind_takes_the_place_of_ours(stack: Stack, bus: Bus) -> None:
    _swap(stack, bus, "projector", EXHAUSTIVE)


@pytest.mark.rust
def test_the_scan_ingest_in_rust_takes_the_place_of_ours(stack: Stack, bus: Bus) -> None:
    build = ["cargo", "build", "--release", "--target-dir", str(RUST_TARGET)]
    subprocess.run(build, cwd=RUST_INGEST, check=True)
    _swap(stack, bus, "scan-ingest", RUST_INGEST / "docker-compose.yml")


def test_it_goes_down_clean_and_leaves_a_whole_recording(stack: Stack, tmp_path: Path) -> None:
    containers = {service: stack.container(service) for service in SERVICES}
    stack.compose("stop")
    codes = {
        service: json.loads(docker("inspect", "-f", "{{json .State.ExitCode}}", container))
        for service, container in containers.items()
    }
    simulator = codes.pop("simulator")
    assert codes == dict.fromkeys(codes, 0)
    assert simulator in (0, 128 + 15)  # it may end by the signal itself
    docker("cp", f"{containers['recorder']}:/recordings", str(tmp_path))
    files = sorted((tmp_path / "recordings").glob("**/*.mcap"))
    assert files
    assert all(is_complete(file) for file in files)
    names = {record.envelope.channel.name for file in files for record in read(file)}
    assert names >= {
        "scan_raw",
        "scan",
        "odometry",
        "hypotheses",
        "pose",
        "tracks",
        "map",
        "model",
        "model_set",
    }


def test_the_compose_file_names_what_the_images_are_made_from() -> None:
    stack = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
    stages = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert set(stack["services"]) == set(SERVICES)
    for name, service in stack["services"].items():
        assert service["build"]["target"] == name
        assert f" AS {name}\n" in stages
