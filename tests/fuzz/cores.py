"""Cores, and those who watch a site, given a stranger's messages, or those of a robot that was taken over.

An input is a row of messages: of each the number of its kind, its length, and its bytes.
"""

from __future__ import annotations

import io
import json
import struct
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import rerun as rr
from eigenscan.fleet.collector import SiteCollector
from eigenscan.fleet.diagnosis import diagnose
from eigenscan.fleet.view import FleetView
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.keeping.change_detector import ChangeDetector
from eigenscan.mapbuilder.keeping.evidence import Evidence
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.recorder.core import RecorderCore
from eigenscan.recorder.mcap_sink import McapSink
from eigenscan.recorder.options import RecorderOptions
from eigenscan.recorder.picture.drawing import Picture
from eigenscan.ros_bridge.channels import ROS_ASKED, ROS_RECEIVED
from eigenscan.ros_bridge.core import RosBridgeCore
from eigenscan.ros_bridge.options import RosBridgeOptions
from eigenscan.runtime.inbox import Arrival
from eigenscan.schemas.channels import (
    CHANNELS,
    HEALTH,
    LIDAR_KIND,
    MODEL_SET,
    POSE,
    SCAN,
    SEARCH,
    Channel,
    ContractError,
    is_chunk,
)
from eigenscan.schemas.envelope import Core, Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import LidarKind
from eigenscan.schemas.wire import decode, encode, encoding
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.vda5050.channels import INSTANT_ACTIONS, MQTT_RECEIVED, ORDER
from eigenscan.vda5050.core import Vda5050Core
from eigenscan.vda5050.settings import Vda5050Settings
from eigenscan.workbench.conformance.values import faults
from google.protobuf.wrappers_pb2 import BytesValue

from tests.fuzz.mutation import damaged, forged
from tests.fuzz.reader import Opened, Reader
from tests.services.projector.office import office, ready, site
from tests.services.recorder.traffic import Site
from tests.services.ros_bridge.test_core import MOUNT
from tests.services.ros_bridge.test_core import odometry as ros_odometry
from tests.services.ros_bridge.test_core import scan as ros_scan

SERVICES = sorted(RosBridgeCore(RosBridgeOptions(), "s", "r")._answerers)
SECONDS = 1.5
MOST_MESSAGES = 40
ADDRESS = {
    "site": "s",
    "robot": "r",
    "lidar": "front",
    "projector": "0",
    "region": "r01",
    "kind": "k",
    "service": "tracker",
    "instance": "r",
    "endpoint": "%scan",
    "topic": INSTANT_ACTIONS,
    "number": "1",
}


@cache
def _sound() -> tuple[tuple[str, bytes], ...]:
    """A site's messages, by the names of their channels."""
    output = [
        (envelope.channel.name, encode(envelope.message)) for envelope in Site("s", "r", SECONDS).messages()
    ]
    settings = json.dumps({"robot": "r", "part": "1/1"})
    health = Health(service="projector", instance="r", status=Health.STATUS_OK, settings=settings)
    health.counters.update(dropped_scan=3, heard_scan=7)
    return (*output, (HEALTH.name, encode(health)))


def _packed(messages: Iterable[tuple[int, bytes]]) -> bytes:
    return b"".join(struct.pack("<BI", number, len(data)) + data for number, data in messages)


def _unpacked(data: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at + 5 <= len(data):
        number, size = struct.unpack_from("<BI", data, at)
        yield number, data[at + 5 : at + 5 + size]
        at += 5 + size


def _row(
    name: str,
    channels: Sequence[Channel],
    take: Callable[[Path], Callable[[Iterator[Envelope]], None]],
    weight: float = 1.0,
    more: Iterable[tuple[str, bytes]] = (),
    attacks: Callable[[], dict[str, bytes]] = dict,
) -> Reader:
    """A reader of rows of messages of these channels."""

    def open_(folder: Path) -> Opened:
        begun = take(folder)
        names = [channel.name for channel in channels]
        sound = [(names.index(own), data) for own, data in (*_sound(), *more) if own in names]
        by_kind: dict[int, list[bytes]] = defaultdict(list)
        for number, data in sound:
            by_kind[number].append(data)

        def mutate(random: Random, _name: str) -> bytes:
            begin = random.randrange(max(1, len(sound) - 5))
            row = sound[begin : begin + random.randrange(2, MOST_MESSAGES)]
            for _ in range(random.choice((1, 2, 5))):
                number = random.choice(sorted(by_kind))
                kind = channels[number].message
                bad = forged(random, kind, by_kind[number])
                if kind is BytesValue:
                    bad = encode(
                        BytesValue(
                            value=damaged(
                                random, BytesValue.FromString(random.choice(by_kind[number])).value, []
                            )
                        )
                    )
                row.insert(random.randrange(len(row) + 1), (number, bad))
            return _packed(row)

        def read(data: bytes) -> None:
            begun(_envelopes(channels, data))

        return Opened(read, {"sound": _packed(sound[:MOST_MESSAGES])}, mutate, attacks)

    return Reader(name, open_, weight)


def _envelopes(channels: Sequence[Channel], data: bytes) -> Iterator[Envelope]:
    for number, payload in _unpacked(data):
        channel = channels[number % len(channels)]
        try:
            message = decode(channel, payload)
        except ContractError:
            continue
        address = {field: ADDRESS[field] for field in channel.fields}
        if isinstance(message, Health):
            address["service"] = message.service if is_chunk(message.service) else "tracker"
        if channel is MQTT_RECEIVED:
            address["topic"] = (ORDER, INSTANT_ACTIONS)[len(payload) % 2]
        if channel is ROS_ASKED:
            address["endpoint"] = SERVICES[len(payload) % len(SERVICES)]
        if channel is ROS_RECEIVED:
            address["endpoint"] = ("%scan", "%odom", "%tf", "%tf_static", "%initialpose")[len(payload) % 5]
        yield Envelope(channel, address, message)


def _reported(core: Core, row: Iterable[Envelope]) -> None:
    """What the core publishes can be sent, and holds to the contract's numbers."""
    for received in row:
        _check(core.handle(received))
    _check(core.finish())
    condition = core.condition()
    Health(status=condition.status, detail=condition.detail, counters=condition.counters).SerializeToString()


def _check(output: Iterable[Envelope]) -> None:
    for each in output:
        encode(each.message)
        for fault in faults(each.message):
            raise AssertionError(f"{each.channel.name}: {fault}")


def _fresh(make: Callable[[], Core]) -> Callable[[Path], Callable[[Iterator[Envelope]], None]]:
    return lambda _folder: lambda row: _reported(make(), row)


def _projector(_folder: Path) -> Callable[[Iterator[Envelope]], None]:
    core = ready(site(spacing=1.0, components=4))
    return lambda row: _reported(core, row)


def _recorder(folder: Path) -> Callable[[Iterator[Envelope]], None]:
    def take(row: Iterator[Envelope]) -> None:
        for path in folder.glob("*.mcap"):
            path.unlink()
        sink = McapSink(folder / "a.mcap", "s", lambda: 1_700_000_000_000_000_000, 1.0, {})
        core = RecorderCore([sink])
        _reported(core, row)
        if sink.counters["mcap_lost"]:
            raise AssertionError(f"lost: {sink.counters['mcap_lost']}, {sink.problem}")

    return take


def _picture(_folder: Path) -> Callable[[Iterator[Envelope]], None]:
    stream = rr.RecordingStream("fuzz")
    stream.set_sinks(rr.FileSink("/dev/null"))
    # rerun leaves two threads for each blueprint; a service sends three, all inputs together thousands
    stream.send_blueprint = lambda *_, **__: None  # type: ignore[method-assign]
    options = RecorderOptions(viewer_port=0)

    def take(row: Iterator[Envelope]) -> None:
        picture = Picture(
            stream, options.picture_hz, options.layout, options.plot_window_s, live=True, draw_all=True
        )
        for received in row:
            picture.draw(received)
        picture.flush()

    return take


def _keeping(_folder: Path) -> Callable[[Iterator[Envelope]], None]:
    def take(row: Iterator[Envelope]) -> None:
        detector = ChangeDetector(office(), Evidence.of(office(), 60.0), 3)
        for received in row:
            detector.receive(received)

    return take


def _view(_folder: Path) -> Callable[[Iterator[Envelope]], None]:
    """What `fleet status`, `fleet metrics` and `doctor` make of what a site publishes."""

    def take(row: Iterator[Envelope]) -> None:
        from eigenscan.cli.fleet.status import rows, table
        from prometheus_client.exposition import generate_latest
        from rich.console import Console

        view: Any = FleetView.__new__(FleetView)
        view.listed = view.expected = frozenset()
        view.site, view.robots, view.services, view.model_versions = "s", {}, {}, deque(maxlen=2)
        for number, received in enumerate(row):
            arrival = Arrival(
                received.channel, received.key, encode(received.message), encoding(received.channel)
            )
            view._receive(arrival, float(number), 1_700_000_000_000_000_000)
        for service in view.services.values():
            service.contracts.add("1")
        for finding in diagnose(view):
            assert "\x1b" not in finding.where
        json.dumps(rows(view), allow_nan=False)
        Console(file=io.StringIO()).print(table(view))
        collector = SiteCollector(view)
        generate_latest(collector)

    return take


def _bridge() -> Core:
    options = RosBridgeOptions(site="s", robot="r")
    return RosBridgeCore(options, options.site, options.robot)


def _ros_messages() -> Iterator[tuple[str, bytes]]:
    for data in (MOUNT, ros_odometry(1, 2, 0.5), ros_scan(), ros_odometry(1.1, 2, 0.5), ros_scan()):
        yield ROS_RECEIVED.name, encode(BytesValue(value=data))
    yield ROS_ASKED.name, encode(BytesValue(value=bytes([0, 1, 0, 0, 0])))


def _mqtt_messages() -> Iterator[tuple[str, bytes]]:
    position = {"x": 1.0, "y": 2.0, "theta": 0.5, "mapId": "map", "lastNodeId": "n"}
    parameters = [{"key": key, "value": value} for key, value in position.items()]
    kinds = ("initPosition", "stateRequest", "factsheetRequest", "cancelOrder")
    for number, kind in enumerate(kinds):
        action = {"actionId": str(number), "actionType": kind, "blockingType": "NONE"}
        reported = {
            "headerId": number,
            "timestamp": "2026-11-22T12:00:00Z",
            "version": "2.1.0",
            "manufacturer": "eigenscan",
            "serialNumber": "r",
            "actions": [{**action, "actionParameters": parameters}],
        }
        for padding in ("", " "):  # by its length it goes to one topic or the other
            yield MQTT_RECEIVED.name, encode(BytesValue(value=(json.dumps(reported) + padding).encode()))


def _builder() -> Core:
    core = MapbuilderCore(MapbuilderSettings(), site(spacing=1.0, components=4), "s")
    for _ in core.start():
        pass
    return core


def _kinds() -> dict[str, bytes]:
    return {"many": _packed((0, encode(LidarKind(beams=b, cap=8.0))) for b in range(1, 200))}


def _healths() -> dict[str, bytes]:
    """What `doctor` and `fleet status` must bear."""

    def of(**fields: Any) -> bytes:
        return _packed([(0, encode(Health(service="projector", **fields)))])

    return {
        "settings: no JSON": of(settings="{"),
        "settings: a list": of(settings="[1]"),
        "settings: nested": of(settings="[" * 100_000),
        "settings: parts": of(settings=json.dumps({"part": "1/1000000000000"})),
        "settings: no parts": of(settings=json.dumps({"part": "x"})),
        "settings: robots": of(settings=json.dumps({"robot": ",".join(f"r{k}" for k in range(5000))})),
        "status": of(status=99),
        "counters": of(counters={"dropped_scan": 2**63, **{f"c{k}": k for k in range(20_000)}}),
        "detail": of(status=3, detail="\x1b[2J" * 1000),
    }


_ALL = tuple(CHANNELS)
CORES: tuple[Reader, ...] = (
    _row("core.tracker", TrackerCore.inputs, _fresh(lambda: TrackerCore(TrackerSettings())), 2.0),
    _row(
        "core.scan_ingest", ScanIngestCore.inputs, _fresh(lambda: ScanIngestCore(ScanIngestSettings())), 2.0
    ),
    _row("core.projector", (SCAN, SEARCH), _projector, 0.1),
    _row("core.mapbuilder", (LIDAR_KIND,), _fresh(_builder), 0.02, attacks=_kinds),
    _row("core.recorder", _ALL, _recorder, 0.3),
    _row("core.picture", _ALL, _picture, 0.05),
    _row("core.keeping", (SCAN, POSE), _keeping, 0.3),
    _row("core.ros_bridge", (*RosBridgeCore.inputs,), _fresh(_bridge), 1.0, more=tuple(_ros_messages())),
    _row(
        "core.vda5050",
        (MQTT_RECEIVED, POSE, MODEL_SET, HEALTH),
        _fresh(lambda: Vda5050Core(Vda5050Settings(), "s", "r")),
        more=tuple(_mqtt_messages()),
    ),
    _row("fleet.view", (HEALTH, POSE, MODEL_SET), _view, 1.0, attacks=_healths),
)
