"""Live to Foxglove: read by a client of its WebSocket protocol, with the schemas that the server sends."""

from __future__ import annotations

import base64
import json
import struct
import sys
from collections.abc import Callable, Iterator
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.gridmap import GridMap
from eigenscan.geometry.gridmap import to_message as to_grid
from eigenscan.geometry.pose import to_message
from eigenscan.recorder.foxglove_sink import DRAWN, FoxgloveSink
from eigenscan.recorder.node import make_core
from eigenscan.recorder.options import RecorderOptions
from eigenscan.runtime.settings import SettingsError
from eigenscan.schemas.channels import DEFAULT_ROBOT, DEFAULT_SITE, MAP, POSE, SCAN, Channel, find
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, PoseEstimate
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass
from websockets.sync.client import ClientConnection, connect

from tests.environment import ROOT
from tests.network import free_port

TIME = 1_700_000_000_250_000_000
ADDRESS = {"site": "s", "robot": "r", "lidar": "front"}
PATIENCE_S = 60.0
MESSAGE_DATA = struct.Struct("<BIQ")  # opcode, subscription, log time in ns


class Client:
    """Foxglove's side: what is advertised, and the messages of what it subscribes to."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self.channels: dict[str, dict[str, Any]] = {}

    def _receive(self) -> bytes:
        """The next message's bytes; notes what is advertised before it."""
        while isinstance(received := self._connection.recv(PATIENCE_S), str):
            output = json.loads(received)
            for channel in output.get("channels", ()) if output["op"] == "advertise" else ():
                self.channels[channel["topic"]] = channel
        return received

    def topics(self, wanted: set[str]) -> None:
        """Waits until these are advertised."""
        while not wanted <= self.channels.keys():
            output = json.loads(self._connection.recv(PATIENCE_S))
            for channel in output.get("channels", ()):
                self.channels[channel["topic"]] = channel

    def subscribe(self, *topics: str) -> None:
        wanted = [
            {"id": self.channels[topic]["id"], "channelId": self.channels[topic]["id"]} for topic in topics
        ]
        self._connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def message(self) -> tuple[str, int, Message]:
        """Topic, log time and content of the next one, by the schema that was sent with its topic."""
        data = self._receive()
        opcode, number, time = MESSAGE_DATA.unpack_from(data)
        assert opcode == 1
        (channel,) = [each for each in self.channels.values() if each["id"] == number]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
        pool = DescriptorPool()
        for file in FileDescriptorSet.FromString(base64.b64decode(channel["schema"])).file:
            pool.Add(file)
        kind = GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))
        return channel["topic"], time, kind.FromString(data[MESSAGE_DATA.size :])


@pytest.fixture
def sink() -> Iterator[FoxgloveSink]:
    sink = FoxgloveSink("127.0.0.1", 0, "s")
    yield sink
    sink.close()


@pytest.fixture
def client(sink: FoxgloveSink) -> Iterator[Client]:
    with connect(sink.url, subprotocols=["foxglove.sdk.v1"]) as connection:  # type: ignore[list-item]
        yield Client(connection)


def write(sink: FoxgloveSink, channel: Channel, message: Message) -> None:
    sink.write(Envelope(channel, ADDRESS, message))


def pose(state: Any = STATE_LOCALIZED) -> PoseEstimate:
    estimate = PoseEstimate(timestamp=stamp(TIME), frame_id="map", state=state, confidence=0.75)
    estimate.pose.CopyFrom(to_message((1.0, 2.0, 0.5)))
    return estimate


def scan() -> Scan:
    ranges = [1.0, float("nan"), 3.0]
    body = Scan(timestamp=stamp(TIME), frame_id="base", angle_min=-0.5, angle_increment=0.5, ranges=ranges)
    body.mount.CopyFrom(to_message((0.2, 0.1, 0.0)))
    return body


def test_topics_are_the_keys_and_messages_the_contracts(sink: FoxgloveSink, client: Client) -> None:
    write(sink, POSE, pose())
    client.topics({"s/robot/r/pose"})
    client.subscribe("s/robot/r/pose")
    received = published(client, lambda: write(sink, POSE, pose()))
    assert received == ("s/robot/r/pose", TIME, received[2])
    assert received[2].DESCRIPTOR.full_name == "eigenscan.PoseEstimate"
    assert received[2].SerializeToString() == pose().SerializeToString()


def published(client: Client, write: Callable[[], None]) -> tuple[str, int, Message]:
    """The first message after the subscription, which takes a moment; what comes before is not kept."""
    got = Event()

    def go_on() -> None:
        while not got.wait(0.05):
            write()

    writing = Thread(target=go_on)
    writing.start()
    try:
        return client.message()
    finally:
        got.set()
        writing.join()


def test_a_scan_and_a_claimed_pose_are_drawn_too(sink: FoxgloveSink, client: Client) -> None:
    write(sink, SCAN, scan())
    drawn = "s/robot/r/scan/front/drawn"
    client.topics({drawn})
    client.subscribe(drawn)
    _, time, message = published(client, lambda: write(sink, SCAN, scan()))
    body: Any = message
    assert (time, body.DESCRIPTOR.full_name) == (TIME, "foxglove.LaserScan")
    assert (body.start_angle, body.end_angle, body.frame_id) == (-0.5, 0.5, "base")
    assert (body.pose.position.x, body.ranges[0], body.ranges[2]) == (0.2, 1.0, 3.0)
    write(sink, POSE, pose(STATE_AMBIGUOUS))
    client.topics({"s/robot/r/pose"})
    assert "s/robot/r/pose/drawn" not in client.channels
    write(sink, POSE, pose())
    client.topics({"s/robot/r/pose/drawn"})


def test_who_comes_late_gets_the_map(sink: FoxgloveSink) -> None:
    grid = GridMap(np.zeros((2, 3), np.uint8), 0.05, np.array([-1.0, 2.0, 0.0]))
    write(sink, MAP, to_grid(grid, "map"))
    with connect(sink.url, subprotocols=["foxglove.sdk.v1"]) as connection:  # type: ignore[list-item]
        late = Client(connection)
        late.topics({"s/map"})
        late.subscribe("s/map")
        topic, _, message = late.message()
    body: Any = message
    assert (topic, body.DESCRIPTOR.full_name) == ("s/map", "foxglove.Grid")
    assert (body.column_count, body.pose.position.x) == (3, -1.0)


@pytest.mark.parametrize(
    "sent",
    [
        "not JSON",
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 4711}]}',
        '{"op": "subscribe", "subscriptions": 7}',
        '{"op": "advertise", "channels": [{"id": 1, "topic": "s/map", "encoding": "json"}]}',
        b"",
        b"\xff" * 1000,
        struct.pack("<BI", 1, 1) + b"{}",
    ],
    ids=["no JSON", "no channel", "no list", "a publisher", "empty", "no opcode", "a message"],
)
def test_a_client_that_sends_nonsense_disturbs_nobody(
    sink: FoxgloveSink, client: Client, sent: str | bytes
) -> None:
    with connect(sink.url, subprotocols=["foxglove.sdk.v1"]) as other:  # type: ignore[list-item]
        other.send(sent)
        write(sink, POSE, pose())
        client.topics({"s/robot/r/pose"})
        client.subscribe("s/robot/r/pose")
        assert published(client, lambda: write(sink, POSE, pose()))[0] == "s/robot/r/pose"
    assert set(client.channels) == {"s/robot/r/pose", "s/robot/r/pose/drawn"}


def test_a_taken_port_is_named(sink: FoxgloveSink) -> None:
    port = int(sink.url.rpartition(":")[2])
    with pytest.raises(SettingsError, match=f"foxglove_port = {port}: cannot serve"):
        FoxgloveSink("127.0.0.1", port, "s")


def test_without_the_sdk_its_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "eigenscan.recorder.foxglove_sink")
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(SettingsError, match=r"pip install 'eigenscan-recorder\[foxglove\]'"):
        make_core(RecorderOptions(foxglove_port=0))


def test_the_recorder_serves_it(capsys: pytest.CaptureFixture[str]) -> None:
    port = free_port()
    core = make_core(RecorderOptions(foxglove_port=port))
    assert f"foxglove: ws://127.0.0.1:{port}" in capsys.readouterr().out
    with connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"]) as connection:  # type: ignore[list-item]
        list(core.handle(Envelope(POSE, ADDRESS, pose())))
        Client(connection).topics({"s/robot/r/pose", "s/robot/r/pose/drawn"})
    list(core.finish())
    assert core.condition().counters["foxglove_served"] == 1


LAYOUT = json.loads((ROOT / "deploy/foxglove/eigenscan.json").read_text())


def panels(tree: Any) -> list[str]:
    return [tree] if isinstance(tree, str) else [*panels(tree["first"]), *panels(tree["second"])]


def test_the_layouts_panels_are_set_up() -> None:
    assert sorted(panels(LAYOUT["layout"])) == sorted(LAYOUT["configById"])


def test_the_layout_shows_topics_and_fields_that_there_are() -> None:
    panel = LAYOUT["configById"]
    topics = panel["3D!map"]["topics"]
    for topic in topics:
        found = find(topic.removesuffix(DRAWN))
        assert found is not None, topic
        channel, address = found
        assert (address["site"], address.get("robot", DEFAULT_ROBOT)) == (DEFAULT_SITE, DEFAULT_ROBOT)
        assert topic.endswith(DRAWN) == (channel in (SCAN, POSE))
    grid = to_grid(GridMap(np.zeros((1, 1), np.uint8), 0.05, np.zeros(3)), "map")
    assert topics["site/map"]["colorField"] in [field.name for field in grid.fields]
    paths = [path["value"] for name in panel for path in panel[name].get("paths", ())]
    for topic, _, field in (path.partition(".") for path in [*paths, panel["RawMessages!pose"]["topicPath"]]):
        channel, _address = find(topic) or pytest.fail(topic)
        assert not field or field in channel.message.DESCRIPTOR.fields_by_name


def test_on_every_address_the_link_is_one_that_opens() -> None:
    sink = FoxgloveSink("0.0.0.0", 0, "s")
    sink.close()
    assert sink.url.startswith("ws://127.0.0.1:")
