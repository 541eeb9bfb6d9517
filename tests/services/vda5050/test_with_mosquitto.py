"""The bridge as a process between Zenoh and a real broker, Eclipse Mosquitto, and a fleet manager."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from eigenscan.geometry.pose import from_message
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import POSE, RELOCATION
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, STATE_LOST, PoseEstimate, Relocation
from eigenscan.schemas.wire import decode
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from tests.network import PATIENT_QUEUE, free_port
from tests.services.vda5050.schemas import check
from tests.services.vda5050.test_core import set_position

pytestmark = pytest.mark.slow

PATIENCE_S = 90.0
PERIOD_S = 0.1
VERSIONS = {"2.1.0": "uagv/v2", "3.0.0": "vda5050/v3"}
BROKEN = {"2.1.0": "CONNECTIONBROKEN", "3.0.0": "CONNECTION_BROKEN"}
Message = dict[str, Any]


def wait_for(what: Callable[[], Any], reported: str) -> Any:
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        if found := what():
            return found
        time.sleep(0.02)
    pytest.fail(f"never: {reported}")


@dataclass
class Broker:
    """A mosquitto process on a port of its own."""

    folder: Path
    port: int
    process: subprocess.Popen[bytes] | None = None

    def start(self, more: str = "") -> None:
        program = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
        assert program, "mosquitto is not installed: apt-get install mosquitto"
        settings = self.folder / "mosquitto.conf"
        settings.write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\n{more}")
        self.process = subprocess.Popen([program, "-c", str(settings)], stderr=subprocess.DEVNULL)

    def stop(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait(PATIENCE_S)


@dataclass
class Manager:
    """A fleet manager: all messages of one robot, newest last, each checked by its schema."""

    version: str
    port: int
    received: dict[str, list[Message]] = field(default_factory=dict)
    retained: set[str] = field(default_factory=set)
    wrong: list[str] = field(default_factory=list)
    number: int = 0

    def __post_init__(self) -> None:
        self.client = Client(CallbackAPIVersion.VERSION2)
        self.client.on_connect = self._on_connect
        self.client.on_message = self._on_message
        self.client.reconnect_delay_set(1, 1)
        self.client.connect_async("127.0.0.1", self.port)
        self.client.loop_start()

    @property
    def topics(self) -> str:
        return f"{VERSIONS[self.version]}/eigenscan/r1"

    def _on_connect(self, client: Client, _data: Any, _flags: Any, _reason: Any, _properties: Any) -> None:
        client.subscribe(f"{self.topics}/#", qos=1)

    def _on_message(self, _client: Client, _data: Any, message: Any) -> None:
        topic = message.topic.rpartition("/")[2]
        if topic in ("instantActions", "order"):
            return
        body = json.loads(message.payload)
        try:
            check(topic, body, int(self.version[0]))
        except Exception as error:
            self.wrong.append(f"{topic}: {error}")
        if message.retain:
            self.retained.add(topic)
        self.received.setdefault(topic, []).append(body)

    def newest(self, topic: str) -> Message:
        return dict(self.received.get(topic, [{}])[-1])

    def connection(self, state: str) -> bool:
        return self.newest("connection").get("connectionState") == state

    def localized(self, claimed: bool) -> bool:
        position = self.newest("state").get("agvPosition") or self.newest("state").get("mobileRobotPosition")
        return position is not None and claimed is (
            position["positionInitialized"] if "positionInitialized" in position else position["localized"]
        )

    def action(self, name: str) -> str:
        state = self.newest("state")
        listed = state.get("instantActionStates") or state.get("actionStates") or []
        return next((one["actionStatus"] for one in listed if one["actionId"] == name), "")

    def publish(self, *actions: Message) -> None:
        self.number += 1
        reported = {
            "headerId": self.number,
            "timestamp": "2026-11-22T12:00:00.00Z",
            "version": self.version,
            "manufacturer": "eigenscan",
            "serialNumber": "r1",
            "actions": list(actions),
        }
        self.publish_bytes(json.dumps(reported).encode())

    def publish_bytes(self, data: bytes) -> None:
        self.client.publish(f"{self.topics}/instantActions", data).wait_for_publish(PATIENCE_S)

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()


class Tracker:
    """Publishes a pose each tenth of a second."""

    def __init__(self, bus: Bus, site: str) -> None:
        self.bus, self.site, self.claims = bus, site, True
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(PERIOD_S):
            reported = PoseEstimate(
                timestamp=stamp(time.time_ns()),
                pose=Pose2(x=3.0, y=-2.0, theta=0.5),
                state=STATE_LOCALIZED if self.claims else STATE_LOST,
                confidence=0.97,
                track_id=1,
                protection_radius=0.3,
            )
            self.bus.publish(Envelope(POSE, {"site": self.site, "robot": "r1"}, reported))

    def close(self) -> None:
        self._stop.set()
        self._thread.join(PATIENCE_S)


@dataclass
class Scene:
    """A broker, a bridge, a tracker and a fleet manager."""

    broker: Broker
    manager: Manager
    tracker: Tracker
    inbox: Inbox
    start: Callable[[], subprocess.Popen[bytes]]
    bridge: subprocess.Popen[bytes]


@pytest.fixture(params=VERSIONS)
def scene(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Scene]:
    site, endpoint = f"test-{uuid.uuid4().hex[:12]}", f"tcp/127.0.0.1:{free_port()}"
    alone = {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"link": {"tx": {"queue": PATIENT_QUEUE}}},
    }
    (tmp_path / "hub.json5").write_text(json.dumps(alone | {"listen": {"endpoints": [endpoint]}}))
    leaf = alone | {"listen": {"endpoints": ["tcp/127.0.0.1:0"]}, "connect": {"endpoints": [endpoint]}}
    (tmp_path / "leaf.json5").write_text(json.dumps(leaf))
    broker = Broker(tmp_path, free_port())
    broker.start()
    flags = ["--site", site, "--robot", "r1", "--zenoh", str(tmp_path / "leaf.json5")]
    flags += ["--broker", f"mqtt://127.0.0.1:{broker.port}", "--version", request.param]

    def start() -> subprocess.Popen[bytes]:
        with (tmp_path / "bridge.log").open("ab") as log:
            return subprocess.Popen([sys.executable, "-m", "eigenscan.vda5050.node", *flags], stderr=log)

    with Bus(open_session(tmp_path / "hub.json5")) as bus:
        inbox = Inbox()
        bus.listen([RELOCATION], {"site": site, "robot": "r1"}, inbox)
        reported = Scene(
            broker, Manager(request.param, broker.port), Tracker(bus, site), inbox, start, start()
        )
        try:
            wait_for(lambda: reported.manager.localized(True), "localized")
            yield reported
        finally:
            reported.bridge.kill()
            reported.bridge.wait(PATIENCE_S)
            reported.tracker.close()
            reported.manager.close()
            broker.stop()
    assert reported.manager.wrong == []


def test_a_fleet_manager_reads_the_pose_and_sets_it(scene: Scene) -> None:
    manager = scene.manager
    assert manager.connection("ONLINE")
    wait_for(lambda: "factsheet" in manager.received, "a factsheet")
    wait_for(lambda: "visualization" in manager.received, "a visualization")
    scene.tracker.claims = False
    wait_for(lambda: manager.localized(False), "not localized")
    assert [one["errorType"] for one in manager.newest("state")["errors"]] == ["LOCALIZATION_ERROR"]
    manager.publish(set_position("a1", major=int(manager.version[0])))
    arrival = scene.inbox.take(PATIENCE_S)
    assert arrival is not None
    word = decode(RELOCATION, arrival.payload, arrival.encoding)
    assert isinstance(word, Relocation)
    assert from_message(word.pose) == pytest.approx([3.0, -2.0, 0.5])
    wait_for(lambda: manager.action("a1") == "RUNNING", "running")
    scene.tracker.claims = True
    wait_for(lambda: manager.action("a1") == "FINISHED", "finished")
    assert manager.localized(True)

    manager.publish_bytes(b"{")
    wait_for(lambda: manager.newest("state")["errors"], "an error about what is no JSON")
    assert manager.newest("state")["errors"][0]["errorType"] == "VALIDATION_FAILURE"
    assert manager.localized(True)


def test_who_comes_late_has_connection_and_factsheet(scene: Scene) -> None:
    late = Manager(scene.manager.version, scene.broker.port)
    try:
        wait_for(lambda: {"connection", "factsheet"} <= late.retained, "retained messages")
        assert late.connection("ONLINE")
    finally:
        late.close()


def test_a_broker_that_was_gone_receives_all_again(scene: Scene) -> None:
    scene.broker.stop()
    scene.tracker.claims = False
    time.sleep(1.0)
    scene.manager.received.clear()
    scene.broker.start()
    wait_for(lambda: scene.manager.connection("ONLINE"), "online again")
    wait_for(lambda: scene.manager.localized(False), "a state again")
    wait_for(lambda: "factsheet" in scene.manager.received, "a factsheet again")
    scene.manager.publish(set_position("b1", major=int(scene.manager.version[0])))
    assert scene.inbox.take(PATIENCE_S) is not None


def test_the_broker_publishes_the_last_will_of_a_bridge_that_was_killed(scene: Scene) -> None:
    scene.bridge.kill()
    wait_for(lambda: scene.manager.connection(BROKEN[scene.manager.version]), "the last will")
    scene.bridge.wait(PATIENCE_S)
    scene.bridge = scene.start()
    wait_for(lambda: scene.manager.connection("ONLINE"), "online")
    scene.bridge.send_signal(signal.SIGTERM)
    wait_for(lambda: scene.manager.connection("OFFLINE"), "offline in order")
    assert scene.bridge.wait(PATIENCE_S) == 0


def certificate(folder: Path, address: str) -> Path:
    """A certificate for an address, signed by itself, and its key in one file."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "broker")])
    now = datetime.now(UTC)
    made = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - timedelta(minutes=1))
        .not_valid_after(now + timedelta(hours=1))
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ip_address(address))]), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    pem = serialization.Encoding.PEM
    private = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    file = folder / f"{address}.pem"
    file.write_bytes(made.public_bytes(pem) + private)
    return file


@pytest.mark.parametrize(
    ("scheme", "issued_to", "trusted", "words"),
    [
        ("mqtts", "127.0.0.1", True, "no pose arrives"),
        ("mqtts", "127.0.0.1", False, "not trusted: self-signed certificate: set ca_file"),
        ("mqtts", "127.0.0.2", True, "not trusted: IP address mismatch"),
        ("mqtt", "127.0.0.1", False, "mqtts://, if the broker speaks TLS"),
        ("mqtt", "", False, "Connection refused"),
    ],
)
def test_health_names_why_a_broker_cannot_be_reached(
    tmp_path: Path, scheme: str, issued_to: str, trusted: bool, words: str
) -> None:
    broker = Broker(tmp_path, free_port())
    flags = ["--site", f"test-{uuid.uuid4().hex[:12]}", "--broker", f"{scheme}://127.0.0.1:{broker.port}"]
    if issued_to:
        file = certificate(tmp_path, issued_to)
        broker.start(f"certfile {file}\nkeyfile {file}\nuser root\n")  # else it may not read them
        flags += ["--ca-file", str(file)] if trusted else []
    command = [sys.executable, "-m", "eigenscan.vda5050.node", *flags]
    log = tmp_path / "bridge.log"
    with log.open("wb") as errors, subprocess.Popen(command, stderr=errors) as bridge:
        try:
            wait_for(lambda: words in log.read_text(), f"{words}: {log.read_text()}")
        finally:
            bridge.kill()
            broker.stop()


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--broker", "10.0.0.5"], "--broker = '10.0.0.5'"),
        (["--broker", "mqtt://localhost:99999"], "--broker = 'mqtt://localhost:99999': Port out of range"),
        (["--broker", "mqtt://acme:word@10.0.0.5"], "give username and password_file"),
        (["--robot", "*"], "one robot"),
        (["--robot", "halle/1"], "robot"),
        (["--robot", "läufer"], "serial_number"),
        (["--version", "1.1"], "--version"),
        (["--manufacturer", "a/b"], "--manufacturer"),
        (["--broker", "mqtts://127.0.0.1", "--ca-file", "/nowhere/ca.crt"], "ca_file: /nowhere/ca.crt"),
        (["--password-file", "/nowhere/password"], "password_file"),
        (["--password-file", __file__], "give username too"),
    ],
)
def test_wrong_settings_end_it_with_one_line(flags: list[str], words: str) -> None:
    command = [sys.executable, "-m", "eigenscan.vda5050.node", *flags]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert ended.returncode == 2
    assert words in ended.stderr
    assert ended.stderr.count("\n") == 1
