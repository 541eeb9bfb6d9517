"""A real tiny service in a process of its own, over loopback TCP."""

import json
import re
import signal
import threading
import time
import urllib.error
import urllib.request
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zenoh
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Arrival, Inbox
from eigenscan.runtime.latched_cache import LatchedCache
from eigenscan.schemas.channels import CONTRACT_VERSION, HEALTH, MODEL, SCAN, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import RegionModel
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.schemas.wire import decode, encode, encoding

from tests.runtime.conftest import PATIENCE_S

IMPATIENT = ("--stop-s", 6)
"""For services that have something to wait for at their end: half of it for the core."""


def _end(service: Any, sign: signal.Signals) -> int:
    """Exit code of the process after a signal."""
    service.process.send_signal(sign)
    return int(service.process.wait(PATIENCE_S))


def _next(inbox: Inbox) -> Arrival:
    arrival = inbox.take(PATIENCE_S)
    assert arrival is not None
    return arrival


def _ask(bus: Bus, net: Any, frame: str) -> None:
    address = {"site": net.site, "robot": "robot", "lidar": "front"}
    assert bus.wait_for_listener(SCAN_RAW.key(address), PATIENCE_S)
    bus.publish(Envelope(SCAN_RAW, address, RawScan(frame_id=frame)))


def _healths(inbox: Inbox) -> Any:
    while True:
        arrival = _next(inbox)
        if arrival.channel is HEALTH:
            health = decode(HEALTH, arrival.payload, arrival.encoding)
            assert isinstance(health, Health)
            yield health


def _get(url: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(url, timeout=PATIENCE_S) as reply:
            return reply.status, reply.read().decode()
    except urllib.error.HTTPError as refusal:
        with refusal:
            return refusal.code, refusal.read().decode()


def _probe_until(url: str, code: int) -> dict[str, Any]:
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        found, body = _get(url)
        if found == code:
            return dict(json.loads(body))
        time.sleep(0.05)
    raise AssertionError(f"{url} never answered {code}; last {found}: {body}")


@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_in_time_with_its_last_words(
    sign: signal.Signals, net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    bus, inbox = buses(), Inbox()
    bus.listen([SCAN], {"site": net.site}, inbox)
    service = start(config=net.leaf)
    service.log("ready")
    assert _end(service, sign) == 0
    assert _next(inbox).key == f"{net.site}/robot/robot/scan/last"
    assert service.log("stopped")["unfinished"] is False


@pytest.mark.parametrize("phase", ["make", "start", "handle"])
def test_a_signal_ends_it_in_time_while_its_core_is_at_work(
    phase: str, net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    bus = buses()
    service = start(f"--{phase}-s", 600, *IMPATIENT, config=net.leaf)
    if phase == "handle":
        service.log("ready")
        _ask(bus, net, "front")
    service.log(f"{phase} takes long")
    assert _end(service, signal.SIGTERM) == 0
    assert service.log("stopped")["unfinished"] is True


def test_it_answers_for_its_model_and_ends_in_time_meanwhile(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    service = start("--model-bytes", 50_000_000, *IMPATIENT)
    service.log("ready")
    bus, inbox = Bus(net.open()), Inbox()
    bus.listen([MODEL], {"site": net.site}, inbox)
    assert _end(service, signal.SIGTERM) == 0
    bus.close()


def test_a_prompt_core_takes_one_message_at_a_time_from_many_speakers(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    """It works in the threads that bring the messages: each counts once, in its speaker's order."""
    listener, inbox = buses(), Inbox(100)
    listener.listen([SCAN], {"site": net.site}, inbox)
    start("--prompt", "true", config=net.leaf).log("ready")
    speakers, bursts, burst = 3, 10, 20
    names = [f"lidar{number}" for number in range(speakers)]
    voices = {name: buses() for name in names}
    for name, voice in voices.items():
        address = {"site": net.site, "robot": "robot", "lidar": name}
        assert voice.wait_for_listener(SCAN_RAW.key(address), PATIENCE_S)
    warm_up = {"site": net.site, "robot": "robot", "lidar": "warm_up"}
    while inbox.take(0.2) is None:  # until the service sees who listens to it
        listener.publish(Envelope(SCAN_RAW, warm_up, RawScan(frame_id="0")))
    received: dict[str, list[str]] = {name: [] for name in names}
    sequences: list[int] = []
    for number in range(bursts):

        def send(name: str, number: int = number) -> None:
            address = {"site": net.site, "robot": "robot", "lidar": name}
            for frame in range(number * burst, (number + 1) * burst):
                voices[name].publish(Envelope(SCAN_RAW, address, RawScan(frame_id=f"{frame:04}")))

        threads = [threading.Thread(target=send, args=(name,)) for name in names]
        for thread in threads:
            thread.start()
        while len(sequences) < (number + 1) * speakers * burst:
            arrival = _next(inbox)
            lidar = arrival.key.rpartition("/")[2]
            if lidar in received:
                scan = decode(SCAN, arrival.payload, arrival.encoding)
                assert isinstance(scan, Scan)
                received[lidar].append(scan.frame_id)
                sequences.append(scan.sequence)
        for thread in threads:
            thread.join()
    assert len(set(sequences)) == len(sequences)  # two at a time would count the same number twice
    expected = [f"{frame:04}" for frame in range(bursts * burst)]
    assert received == dict.fromkeys(names, expected)


@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGINT])
def test_a_prompt_core_ends_in_time_with_its_last_words(
    sign: signal.Signals, net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    bus, inbox = buses(), Inbox()
    bus.listen([SCAN], {"site": net.site}, inbox)
    service = start("--prompt", "true", config=net.leaf)
    service.log("ready")
    _ask(bus, net, "poison")  # what it fails on is not the end of it
    _ask(bus, net, "front")
    assert _next(inbox).key == f"{net.site}/robot/robot/scan/front"
    assert _end(service, sign) == 0
    assert _next(inbox).key == f"{net.site}/robot/robot/scan/last"
    assert service.log("stopped")["core_failed"] == 1


@pytest.mark.slow
def test_none_of_many_dies_of_its_end_amid_traffic(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    bus, over = buses(), threading.Event()

    def flood() -> None:
        address = {"site": net.site, "robot": "robot", "lidar": "front"}
        while not over.wait(0.0005):
            bus.publish(Envelope(SCAN_RAW, address, RawScan(frame_id="front")))

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        for _ in range(3):
            services = [start("--instance", name, "--model-bytes", 10**6, config=net.leaf) for name in "abc"]
            for service in services:
                service.log("ready")
            for service in services:
                service.process.send_signal(signal.SIGTERM)
            for service in services:
                _, errors = service.process.communicate(timeout=PATIENCE_S)
                assert service.process.returncode == 0, errors
                assert all(line.startswith("{") for line in errors.splitlines()), errors
    finally:
        over.set()
        thread.join()


def test_it_reports_how_it_is_and_outlives_all_that_it_receives(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    bus, scans, others = buses(), Inbox(), Inbox()
    bus.listen([SCAN], {"site": net.site}, scans)
    bus.listen([HEALTH], {"site": net.site}, others)
    service = start("--instance", "one", config=net.leaf)
    service.log("ready")
    first = next(_healths(others))
    assert (first.service, first.instance) == ("tiny", "one")

    key = f"{net.site}/robot/robot/scan/raw/front"
    _ask(bus, net, "before")
    assert decode(SCAN, _next(scans).payload) == Scan(frame_id="before", sequence=0)
    session = bus._session
    session.put(key, b"\xff\xff\xff", encoding="application/protobuf;eigenscan.RawScan/1")
    session.put(key, b"", encoding="application/protobuf;eigenscan.RawScan/2")
    session.put(key, b"", encoding="application/json")
    session.put(f"{net.site}/robot/robot/scan/raw/fr#nt".replace("#", "@"), b"")
    session.delete(key)
    _ask(bus, net, "poison")
    _ask(bus, net, "after")
    assert decode(SCAN, _next(scans).payload) == Scan(frame_id="after", sequence=1)

    wanted = {"heard_scan_raw": 3, "said_scan": 2, "undecodable": 3, "core_failed": 1, "handled": 2,
              "dropped_deletion": 1, "dropped_foreign_key": 1}  # fmt: skip
    for health in _healths(others):
        if dict(health.counters).items() >= wanted.items():
            break
    assert health.status == Health.STATUS_OK
    fault = service.log("core_failed")
    assert fault["key"] == key
    assert "poisoned" in str(fault["exception"])


def test_a_core_that_falls_behind_answers_the_newest_scan_of_each_robot_and_reports_it(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    """Each scan takes it 20 ms at least, and two robots publish more until it reports dropped ones."""
    bus, scans, others = buses(), Inbox(), Inbox()
    bus.listen([SCAN], {"site": net.site}, scans)
    bus.listen([HEALTH], {"site": net.site}, others)
    service = start("--robot", "*", "--handle-s", 0.02, "--behind-after", 0.1, config=net.leaf)
    service.log("ready")
    _ask(bus, net, "0")
    _next(scans)
    output, dropped, answers = 0, 0, defaultdict[str, list[int]](list)
    end = time.monotonic() + PATIENCE_S
    while not dropped:
        assert time.monotonic() < end
        for robot in ("a", "b"):
            address = {"site": net.site, "robot": robot, "lidar": "front"}
            bus.publish(Envelope(SCAN_RAW, address, RawScan(frame_id=str(output))))
        output += 1
        while arrival := scans.take(0.005):
            answers[arrival.key].append(int(decode(SCAN, arrival.payload).frame_id))  # type: ignore[attr-defined]
        while arrival := others.take(0.0):
            dropped = decode(HEALTH, arrival.payload).counters["dropped_scan_raw"]  # type: ignore[attr-defined]
    while len(answers) < 2 or any(each[-1] != output - 1 for each in answers.values()):  # the newest, always
        arrival = _next(scans)
        answers[arrival.key].append(int(decode(SCAN, arrival.payload).frame_id))  # type: ignore[attr-defined]
    assert all(each == sorted(set(each)) for each in answers.values())
    unanswered = 2 * output - sum(map(len, answers.values()))
    for health in _healths(others):  # nothing is lost silently
        if health.counters["dropped_scan_raw"] >= unanswered and health.counters["waiting"] == 0:
            break
    assert health.counters["dropped_scan_raw"] == unanswered
    assert "--robot" in str(service.log("too_slow")["hint"])


def test_a_core_that_leaves_is_not_taken_for_a_clean_end(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    bus = buses()
    service = start(config=net.leaf)
    service.log("ready")
    _ask(bus, net, "leave")
    assert service.process.wait(PATIENCE_S) == 1


def test_metrics_and_probe(net: Any, start: Callable[..., Any], buses: Callable[[], Bus]) -> None:
    bus, inbox = buses(), Inbox()
    bus.listen([SCAN], {"site": net.site}, inbox)
    service = start("--metrics-port", 0, config=net.leaf)
    url = str(service.log("metrics")["url"])
    service.log("ready")
    _ask(bus, net, "x")
    _next(inbox)
    probe = _probe_until(url.replace("/metrics", "/healthz"), 200)
    assert probe["stalled"] is False
    end = time.monotonic() + PATIENCE_S
    while 'eigenscan_messages_total{what="said_scan"} 1.0' not in (text := _get(url)[1]):
        assert time.monotonic() < end, text
        time.sleep(0.05)
    assert 'eigenscan_handling_seconds_count{channel="scan_raw"} 1.0' in text
    assert re.search(rf'eigenscan_info{{contract="{CONTRACT_VERSION}",instance="robot",service="tiny",', text)
    assert re.search(r"^process_resident_memory_bytes \d", text, re.MULTILINE)
    assert _get(url + "x")[0] == 404
    assert _get(url.replace("/metrics", "/"))[0] == 404


def test_the_probe_fails_until_it_is_ready(net: Any, start: Callable[..., Any], tmp_path: Path) -> None:
    service = start("--start-until", tmp_path / "go", "--metrics-port", 0)
    url = str(service.log("metrics")["url"]).replace("/metrics", "/healthz")
    service.log("start takes long")
    code, body = _get(url)
    assert code == 503
    assert json.loads(body)["starting"] is True
    (tmp_path / "go").touch()
    service.log("ready")
    assert _probe_until(url, 200)["starting"] is False


def test_its_presence_is_seen_and_so_is_its_death(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus]
) -> None:
    session = buses()._session
    tokens = session.liveliness().declare_subscriber(f"{net.site}/alive/**", history=True)
    service = start("--instance", "one", config=net.leaf)
    service.log("ready")
    born = tokens.recv()
    assert (str(born.key_expr), born.kind) == (
        f"{net.site}/alive/tiny/one/{CONTRACT_VERSION}",
        zenoh.SampleKind.PUT,
    )
    service.process.kill()
    dead = tokens.recv()
    assert (dead.key_expr, dead.kind) == (born.key_expr, zenoh.SampleKind.DELETE)


def test_a_second_instance_of_the_same_name_is_noticed(net: Any, start: Callable[..., Any]) -> None:
    first = start()
    first.log("ready")
    second = start(config=net.leaf)
    assert "--instance" in str(first.log("duplicate_instance")["hint"])
    assert "--instance" in str(second.log("duplicate_instance")["hint"])
    for service in (first, second):
        status = service.log("status")
        while "--instance" not in str(status["detail"]):
            status = service.log("status")
        assert status["status"] == "STATUS_DEGRADED"
    second.process.kill()
    while first.log("status")["status"] == "STATUS_DEGRADED":
        pass


def test_a_fault_of_the_user_is_one_line_and_code_2(
    net: Any, start: Callable[..., Any], tmp_path: Any
) -> None:
    broken = tmp_path / "broken.json5"
    broken.write_text("{mode: 'peer'")
    taken = net.open(net.hub)  # its port
    try:
        cases: list[tuple[list[object], Any, str]] = [
            (["--broken"], net.hub, "eigenscan-tiny: maps/office.yaml: resolution: must be given"),
            ([], broken, f"eigenscan-tiny: {broken}: is no Zenoh configuration (JSON5): "),
            (
                [],
                tmp_path / "none.json5",
                f"eigenscan-tiny: {tmp_path / 'none.json5'}: no such Zenoh configuration: ",
            ),
            ([], net.hub, f"eigenscan-tiny: {net.hub}: no Zenoh session: "),
            (["--start-s", "soon"], net.hub, "eigenscan-tiny: --start-s = 'soon': "),
        ]
        started = [start(*arguments, config=config) for arguments, config, _ in cases]
        for service, (_, _, line) in zip(started, cases, strict=True):
            _, errors = service.process.communicate(timeout=PATIENCE_S)
            assert service.process.returncode == 2, errors
            output = [one for one in errors.splitlines() if not one.startswith("{")]
            assert len(output) == 1, errors
            assert output[0].startswith(line)
            assert ".rs:" not in output[0]
    finally:
        taken.close()


def test_after_two_crashes_on_a_cached_model_it_starts_without_and_reports_it(
    net: Any, start: Callable[..., Any], buses: Callable[[], Bus], tmp_path: Path
) -> None:
    bus, inbox = buses(), Inbox()
    bus.listen([HEALTH], {"site": net.site}, inbox)
    kept = tmp_path / "kept"
    model = RegionModel(region="hall", version="kills")
    key = MODEL.key({"site": net.site, "region": "hall"})
    LatchedCache(kept).put(Arrival(MODEL, key, encode(model), encoding(MODEL)))
    flags = ("--keep", kept, "--takes-models", "true")
    for _ in range(2):
        assert start(*flags, config=net.leaf).process.wait(PATIENCE_S) == -signal.SIGSEGV
    service = start(*flags, config=net.leaf)
    words = f"set aside after 2 failed starts, see {kept / 'aside'}"
    assert words in str(service.log("cache_set_aside")["hint"])
    health = next(each for each in _healths(inbox) if each.counters.get("cache_set_aside"))
    assert health.detail.startswith("no scan; ")
    assert health.detail.endswith(words)
    assert _end(service, signal.SIGTERM) == 0
    assert [path.name for path in kept.iterdir()] == ["aside"]


def test_a_stop_in_good_order_is_no_failed_start(net: Any, start: Callable[..., Any], tmp_path: Path) -> None:
    model = RegionModel(region="hall", version="1")
    key = MODEL.key({"site": net.site, "region": "hall"})
    LatchedCache(tmp_path).put(Arrival(MODEL, key, encode(model), encoding(MODEL)))
    for _ in range(3):
        service = start("--keep", tmp_path, "--takes-models", "true")
        service.log("ready")
        assert [path.read_bytes() for path in tmp_path.glob("starts-*")] == [b"1"]
        assert _end(service, signal.SIGTERM) == 0
    assert not (tmp_path / "aside").exists()
