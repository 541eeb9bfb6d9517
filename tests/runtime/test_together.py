"""Services in one process: they hand each other what they publish, others get it too, all end together."""

import json
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.exchange import Exchange
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.intake import Intake
from eigenscan.runtime.node import Service
from eigenscan.runtime.settings import ServiceSettings, SettingsError
from eigenscan.runtime.together import read
from eigenscan.schemas.channels import HEALTH, HYPOTHESES, OBSTACLES, SCAN, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.scan_pb2 import RawScan, Scan

from tests.network import free_port
from tests.runtime.conftest import PATIENCE_S

TINY = Path(__file__).with_name("tiny_together.py")


def _ask(service: Any, bus: Bus, net: Any, *frames: str) -> None:
    for _ in range(3):  # the keeper may receive before those who answer do
        service.log("ready")
    address = {"site": net.site, "robot": "robot", "lidar": "front"}
    assert bus.wait_for_listener(SCAN_RAW.key(address), PATIENCE_S)
    for frame in frames:
        bus.publish(Envelope(SCAN_RAW, address, RawScan(frame_id=frame)))


def test_messages_go_hand_to_hand_in_one_thread_and_to_others_as_well(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    bus, inbox = buses(), Inbox()
    bus.listen([HYPOTHESES], {"site": net.site}, inbox)
    service = start(program=TINY, config=net.leaf)
    _ask(service, bus, net, "a", "b")
    for name in ("a", "b"):
        arrival = inbox.take(PATIENCE_S)
        assert arrival
        assert Hypotheses.FromString(arrival.payload).frame_id == f"{name} same core"


def test_an_answer_is_handled_before_the_next_one_is_made(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus], capfd: pytest.CaptureFixture[str]
) -> None:
    bus, inbox = buses(), Inbox()
    bus.listen([OBSTACLES], {"site": net.site}, inbox)
    service = start(program=TINY, config=net.leaf)
    _ask(service, bus, net, "and more")
    assert inbox.take(PATIENCE_S)
    service.process.send_signal(signal.SIGTERM)
    assert service.process.wait(PATIENCE_S) == 0
    kept = re.findall(r"kept (\w+) and more", capfd.readouterr().out)
    assert kept == ["scan", "hypotheses", "obstacles"]


def test_each_has_its_own_health(net: Any, start: Callable[..., Any], buses: Callable[[], Bus]) -> None:
    bus, inbox = buses(), Inbox()
    bus.listen([HEALTH], {"site": net.site}, inbox)
    start(program=TINY, config=net.leaf)
    received: set[str] = set()
    while received != {"first", "second", "keeper"}:
        arrival = inbox.take(PATIENCE_S)
        assert arrival
        received.add(arrival.key.split("/")[2])


def test_who_keeps_all_ends_last_and_has_each_message_once(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus], capfd: pytest.CaptureFixture[str]
) -> None:
    bus, inbox = buses(), Inbox()
    bus.listen([HYPOTHESES], {"site": net.site}, inbox)
    service = start(program=TINY, config=net.leaf)
    _ask(service, bus, net, "a", "b")
    assert inbox.take(PATIENCE_S)
    assert inbox.take(PATIENCE_S)
    service.process.send_signal(signal.SIGTERM)
    assert service.process.wait(PATIENCE_S) == 0
    kept = re.findall(r"kept (\w+) (.+)", capfd.readouterr().out)
    assert kept == [
        ("scan", "a"), ("hypotheses", "a same core"), ("scan", "b"), ("hypotheses", "b same core"),
        ("hypotheses", "last"),
    ]  # fmt: skip


def test_a_fault_in_one_ends_all_with_its_code(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    bus = buses()
    service = start(program=TINY, config=net.leaf)
    _ask(service, bus, net, "leave")
    assert service.process.wait(PATIENCE_S) == 1


def test_it_ends_in_good_order_where_its_session_never_opened(
    tmp_path: Path, start: Callable[..., Any]
) -> None:
    nobody = {"mode": "client", "connect": {"endpoints": [f"tcp/127.0.0.1:{free_port()}"], "timeout_ms": -1}}
    config = tmp_path / "nobody.json5"
    config.write_text(json.dumps(nobody | {"scouting": {"multicast": {"enabled": False}}}))
    service = start("--metrics-port", 0, "--stop-s", 6, program=TINY, config=config)
    service.log("metrics")
    service.process.send_signal(signal.SIGTERM)
    assert service.log("stopped")["unfinished"] is True
    assert service.process.wait(PATIENCE_S) == 0


def test_a_configuration_that_cannot_be_read_is_one_line(tmp_path: Path, start: Callable[..., Any]) -> None:
    folder = tmp_path / "x.json5"
    folder.mkdir()
    process = start(program=TINY, config=folder).process
    assert process.communicate(timeout=PATIENCE_S)[1].count("\n") == 1
    assert process.returncode == 2


def test_settings_that_do_not_hold_end_it_before_it_starts(start: Callable[..., Any]) -> None:
    assert start("--site", "a/b", program=TINY).process.wait(PATIENCE_S) == 2


def test_one_session_has_one_configuration_and_each_service_a_port_of_its_own(tmp_path: Path) -> None:
    def find(name: str) -> Service[Any]:
        return Service(name, ServiceSettings, lambda _: None)  # type: ignore[arg-type, return-value]

    reported = read([(["a", "b"], ["--metrics-port", "9100"]), (["c"], [])], find)
    assert [settings.metrics_port for _, settings in reported] == [9100, 9101, None]
    with pytest.raises(SettingsError, match=r"metrics_port = 65535: .*choose a lower one"):
        read([(["a", "b"], ["--metrics-port", "65535"])], find)
    with pytest.raises(SettingsError, match="zenoh"):
        read([(["a"], []), (["b"], ["--zenoh", str(tmp_path / "z.json5")])], find)
    with pytest.raises(SettingsError, match="twice"):
        read([(["a", "a"], [])], find)


def test_an_exchange_hands_the_message_itself_to_those_who_receive_its_key() -> None:
    exchange, inbox, other = Exchange(), Inbox(), Inbox()
    exchange.listen("s/robot/r/scan/*", Intake([SCAN], inbox))
    exchange.listen("s/robot/q/scan/*", Intake([SCAN], other))
    scan = Scan(frame_id="base")
    exchange.hand(SCAN, "s/robot/r/scan/front", scan, scan.SerializeToString(), None)
    late = Inbox()
    exchange.listen("s/**", Intake([SCAN], late))
    exchange.hand(SCAN, "s/robot/r/scan/front", scan, scan.SerializeToString(), None)
    assert (len(inbox), len(other), len(late)) == (2, 0, 1)
    arrival = inbox.take(0.0)
    assert arrival
    assert arrival.message is scan
    assert arrival.payload == scan.SerializeToString()
