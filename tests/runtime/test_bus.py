"""Buses on real Zenoh sessions over loopback TCP."""

import hashlib
import itertools
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
import zenoh
from eigenscan.runtime.bus import Bus, stagger
from eigenscan.runtime.inbox import Arrival, Inbox
from eigenscan.schemas import recently_used
from eigenscan.schemas.channels import CHANNELS, MODEL, POSE, SCAN, SCAN_RAW, Channel
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.model_pb2 import RegionModel
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.schemas.wire import decode, encode, encoding

from tests.runtime.conftest import PATIENCE_S

# written out, not taken from what is tested: a change there must show here
STAGGER_S = 5.0

Opener = Callable[[], Bus]


def _next(inbox: Inbox) -> Arrival:
    arrival = inbox.take(PATIENCE_S)
    assert arrival is not None
    return arrival


def _model(net: Any, version: str, size: int = 10, region: str = "hall") -> Envelope:
    message = RegionModel(region=region, version=version, panoramas=bytes(size))
    return Envelope(MODEL, {"site": net.site, "region": region}, message)


def _version(arrival: Arrival) -> str:
    message = decode(MODEL, arrival.payload, arrival.encoding)
    assert isinstance(message, RegionModel)
    return message.version


def _until(inbox: Inbox, version: str) -> list[str]:
    """Versions that arrive up to that one."""
    versions = [_version(_next(inbox))]
    while versions[-1] != version:
        versions.append(_version(_next(inbox)))
    return versions


def _settled(bus: Bus, inbox: Inbox, net: Any) -> list[str]:
    """Versions that arrive before a scan does which is published after them."""
    address = {"site": net.site, "robot": "r", "lidar": "mark"}
    versions = []
    stop = threading.Event()

    def mark() -> None:
        while not stop.wait(0.05):
            bus.publish(Envelope(SCAN, address, Scan()))

    thread = threading.Thread(target=mark)
    thread.start()
    end = time.monotonic() + 1.0
    while (arrival := _next(inbox)).channel is MODEL or time.monotonic() < end:
        if arrival.channel is MODEL:
            versions.append(_version(arrival))
    stop.set()
    thread.join()
    return versions


def test_a_late_joiner_gets_10_mb_whole_and_once(net: Any, buses: Opener) -> None:
    output = _model(net, "1", 10_000_000)
    early = buses()
    early.offer([MODEL], {"site": net.site})
    early.publish(output)
    late, inbox = buses(), Inbox()
    late.listen([MODEL, SCAN], {"site": net.site}, inbox)
    arrival = _next(inbox)
    assert arrival.key == f"{net.site}/model/hall"
    assert arrival.encoding == encoding(MODEL)
    assert hashlib.sha256(arrival.payload).digest() == hashlib.sha256(encode(output.message)).digest()
    assert _settled(early, inbox, net) == []


def test_who_holds_some_regions_gets_only_the_others(net: Any, buses: Opener) -> None:
    holder = buses()
    holder.offer([MODEL], {"site": net.site})
    output = [_model(net, "1", region=region) for region in ("a", "b", "c")]
    for one in output:
        holder.publish(one)
    known = [Arrival(MODEL, one.key, encode(one.message), encoding(MODEL)) for one in output[:2]]
    changed = _model(net, "0", region="b")
    known[1] = Arrival(MODEL, changed.key, encode(changed.message), encoding(MODEL))
    subscriber, inbox = buses(), Inbox()
    subscriber.listen([MODEL, SCAN], {"site": net.site}, inbox, known)
    assert sorted(_next(inbox).key[-1] for _ in range(2)) == ["b", "c"]
    assert _settled(holder, inbox, net) == []


def test_a_fleet_asks_again_one_after_another() -> None:
    names = [f"r{number}" for number in range(200)]
    waits = sorted(stagger({"site": "s", "robot": name}) for name in names)
    assert waits == sorted(stagger({"robot": name}) for name in reversed(names))
    assert waits[0] >= 0.0
    assert waits[-1] <= STAGGER_S
    # evenly enough: no half second has more than twice its share
    counts = [sum(begin <= wait < begin + 0.5 for wait in waits) for begin in (0.5 * k for k in range(10))]
    assert max(counts) <= 2 * len(names) / len(counts)
    assert stagger({"site": "s"}) == 0.0


def test_who_holds_a_model_may_come_last(net: Any, buses: Opener) -> None:
    subscriber, inbox = buses(), Inbox()
    subscriber.listen([MODEL, SCAN], {"site": net.site}, inbox)
    for region in ("hall", "lab"):  # each published at once, while its session still meets the others
        holder = buses()
        holder.offer([MODEL], {"site": net.site})
        holder.publish(_model(net, region, region=region))
        assert _version(_next(inbox)) == region


def test_the_newest_is_what_a_late_joiner_gets(net: Any, buses: Opener) -> None:
    holder = buses()
    holder.offer([MODEL], {"site": net.site})
    for version in ("1", "2", "3"):
        holder.publish(_model(net, version))
    late, inbox = buses(), Inbox()
    late.listen([MODEL, SCAN], {"site": net.site}, inbox)
    assert _version(_next(inbox)) == "3"


def test_of_two_holders_the_newest_wins(net: Any, buses: Opener) -> None:
    first, second = buses(), buses()
    first.offer([MODEL], {"site": net.site})
    first.publish(_model(net, "old"))
    second.offer([MODEL], {"site": net.site})
    second.publish(_model(net, "new"))
    late, inbox = buses(), Inbox()
    late.listen([MODEL, SCAN], {"site": net.site}, inbox)
    versions = _until(inbox, "new")
    assert len(versions) == len(set(versions))
    assert _settled(first, inbox, net) == []  # the old one does not win in the end


def test_who_asks_while_models_are_published_ends_with_the_newest(net: Any, buses: Opener) -> None:
    holder = buses()
    holder.offer([MODEL], {"site": net.site})
    stop, output = threading.Event(), [0]

    def publish() -> None:
        while not stop.is_set():
            output[0] += 1
            holder.publish(_model(net, str(output[0]), 200_000))

    thread = threading.Thread(target=publish)
    thread.start()
    joiners = []
    for _ in range(4):
        inbox = Inbox()
        buses().listen([MODEL, SCAN], {"site": net.site}, inbox)
        joiners.append((inbox, [int(_version(_next(inbox)))]))
    stop.set()
    thread.join()
    for inbox, versions in joiners:
        if versions[-1] != output[0]:
            versions += [int(version) for version in _until(inbox, str(output[0]))]
    for inbox, versions in joiners:  # once all have the newest: the marks of one reach the others too
        assert _settled(holder, inbox, net) == []
        assert all(earlier < later for earlier, later in itertools.pairwise(versions))


def test_a_holder_that_starts_again_is_received_again(net: Any, buses: Opener) -> None:
    holder, inbox = buses(), Inbox()
    holder.offer([MODEL], {"site": net.site})
    subscriber = Bus(net.open())
    subscriber.listen([MODEL], {"site": net.site}, inbox)
    holder.close()
    again = Bus(net.open(net.hub))
    again.offer([MODEL], {"site": net.site})
    again.publish(_model(net, "2"))  # before the subscriber has found it again
    assert _version(_next(inbox)) == "2"
    subscriber.close()
    again.close()


def test_who_receives_all_keys_gets_the_held_ones_too(net: Any, buses: Opener) -> None:
    holder = buses()
    holder.offer([MODEL], {"site": net.site})
    holder.publish(_model(net, "1"))
    recorder, inbox = buses(), Inbox()
    recorder.listen_all(CHANNELS, f"{net.site}/**", inbox)
    assert _version(_next(inbox)) == "1"
    holder._session.put(f"{net.site}/not/ours", b"x")
    holder.publish(_model(net, "2"))
    assert _version(_next(inbox)) == "2"
    assert inbox.dropped == {"foreign_key": 1}


def test_queries_are_answered_for_the_keys_asked_only(net: Any, buses: Opener) -> None:
    holder, stranger = buses(), buses()
    holder.offer([MODEL], {"site": net.site})
    for region in ("hall", "lab"):
        holder.publish(_model(net, region, region=region))
    end = time.monotonic() + PATIENCE_S
    while not (replies := list(stranger._session.get(f"{net.site}/model/lab", timeout=5))):
        assert time.monotonic() < end
    assert [(str(reply.ok.key_expr), str(reply.ok.encoding)) for reply in replies if reply.ok] == [
        (f"{net.site}/model/lab", "application/protobuf;eigenscan.RegionModel/1")
    ]


@pytest.mark.parametrize("channel", CHANNELS, ids=lambda channel: channel.name)
def test_samples_travel_as_the_contract_states(channel: Channel, net: Any, buses: Opener) -> None:
    speaker, subscriber = buses(), buses()
    address = dict.fromkeys(channel.fields, "x") | {"site": net.site}
    samples = subscriber._session.declare_subscriber(f"{net.site}/**")
    envelope = Envelope(channel, address, channel.message())
    sample = None
    end = time.monotonic() + PATIENCE_S
    while sample is None and time.monotonic() < end:
        speaker.publish(envelope)
        sample = samples.try_recv()
        time.sleep(0.01)
    assert sample is not None
    assert str(sample.key_expr) == envelope.key
    assert str(sample.encoding) == encoding(channel)
    assert sample.priority == getattr(zenoh.Priority, channel.qos.priority.name)
    assert sample.express is channel.qos.express
    block, drop = zenoh.CongestionControl.BLOCK, zenoh.CongestionControl.DROP
    assert sample.congestion_control == (block if channel.qos.block else drop)
    assert (sample.timestamp is not None) or not channel.qos.latched


def test_a_slow_consumer_loses_its_own_oldest_only(net: Any, buses: Opener) -> None:
    speaker, subscriber = buses(), buses()
    slow, quick = Inbox(), Inbox()
    subscriber.listen([SCAN], {"site": net.site}, slow)
    subscriber.listen([POSE, SCAN_RAW], {"site": net.site}, quick)
    scan_address = {"site": net.site, "robot": "r", "lidar": "l"}
    speaker_inbox = Inbox()
    speaker.listen([SCAN_RAW], {"site": net.site}, speaker_inbox)
    end = time.monotonic() + PATIENCE_S
    while not len(quick):  # until the two have met
        assert time.monotonic() < end
        speaker.publish(Envelope(SCAN_RAW, scan_address, RawScan(frame_id="mark")))
        time.sleep(0.01)
    end = time.monotonic() + PATIENCE_S
    count = 20 * SCAN.qos.depth
    for number in range(count):
        speaker.publish(Envelope(SCAN, scan_address, Scan(sequence=number)))
        speaker.publish(Envelope(SCAN_RAW, scan_address, RawScan(frame_id=str(number))))
        while (arrival := quick.take(PATIENCE_S)) is not None:  # the quick one keeps up
            if decode(SCAN_RAW, arrival.payload).frame_id == str(number):  # type: ignore[attr-defined]
                break
    while sum(slow.dropped.values()) < count - SCAN.qos.depth:  # between keys there is no order
        assert time.monotonic() < end
        time.sleep(0.01)
    kept = [decode(SCAN, _next(slow).payload).sequence for _ in range(SCAN.qos.depth)]  # type: ignore[attr-defined]
    assert kept == list(range(count - SCAN.qos.depth, count))
    assert len(slow) == 0
    assert slow.dropped == {"scan": count - SCAN.qos.depth}
    assert quick.dropped == {}


def test_subscribers_have_no_threads_of_their_own(net: Any, buses: Opener) -> None:
    def taken_on(bus: Bus, *more: Channel) -> set[str]:
        """Threads that Python starts for the bus's subscribers."""
        before = {thread.name for thread in threading.enumerate()}
        bus.listen([SCAN, SCAN_RAW, POSE, *more], {"site": net.site}, Inbox())
        return {thread.name for thread in threading.enumerate()} - before

    bus = buses()
    inside = Bus(zenoh.open(zenoh.Config.from_file(str(net.leaf))), publishes_inside=True)
    with inside:
        assert not taken_on(bus)
        assert taken_on(bus, MODEL)  # a model takes long to copy
        assert len(taken_on(inside)) == 3  # else Zenoh's thread would publish, and wait for itself


def test_a_thread_of_zenoh_keeps_its_state_of_python_between_two_samples(net: Any, buses: Opener) -> None:
    first, other = buses(), buses()
    state, received = threading.local(), []

    class Recording(Inbox):
        def put(self, *_: Any, **__: Any) -> None:
            state.count = getattr(state, "count", 0) + 1
            received.append((threading.get_native_id(), state.count))

    first.listen([SCAN], {"site": net.site}, Recording())
    scan = Envelope(SCAN, {"site": net.site, "robot": "r", "lidar": "front"}, Scan())
    assert other.wait_for_listener(scan.key, PATIENCE_S)
    deadline = time.monotonic() + PATIENCE_S
    while len(received) < 10 and time.monotonic() < deadline:
        other.publish(scan)
        time.sleep(0.01)
    threads = {thread for thread, _ in received}
    assert len(received) >= 10
    # numbered on through all samples of a thread, not begun anew with each
    assert sum(max(count for thread, count in received if thread == each) for each in threads) == len(
        received
    )


def test_deleting_a_key_is_no_empty_message(net: Any, buses: Opener) -> None:
    speaker, subscriber = buses(), buses()
    inbox = Inbox()
    subscriber.listen([MODEL], {"site": net.site}, inbox)
    speaker.offer([MODEL], {"site": net.site})
    speaker.publish(_model(net, "1"))
    assert _version(_next(inbox)) == "1"
    speaker._session.delete(f"{net.site}/model/hall")
    speaker.publish(_model(net, "2"))
    assert _version(_next(inbox)) == "2"
    # the answer to a query may bring the second model before the deletion comes
    deadline = time.monotonic() + PATIENCE_S
    while not inbox.dropped and time.monotonic() < deadline:
        time.sleep(0.01)
    assert inbox.dropped == {"deletion": 1}


def test_what_is_published_after_the_end_is_refused(net: Any) -> None:
    bus = Bus(net.open(net.hub))
    bus.publish(_model(net, "1"))
    bus.close()
    with pytest.raises(zenoh.ZError):
        bus.publish(_model(net, "2"))


def test_robots_without_end_leave_no_publishers_and_who_comes_back_is_received(
    buses: Callable[[], Bus], net: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recently_used, "AMONG", 20)
    hub, leaf, inbox = buses(), buses(), Inbox()
    hub.listen([SCAN], {"site": net.site}, inbox)
    robots = [f"r{number}" for number in range(200)]
    assert leaf.wait_for_listener(SCAN.key({"site": net.site, "robot": "r0", "lidar": "front"}), PATIENCE_S)
    received = set()
    for round_ in range(2):
        for robot in robots:
            leaf.publish(
                Envelope(SCAN, {"site": net.site, "robot": robot, "lidar": "front"}, Scan(sequence=round_))
            )
            assert len(leaf._publishers) <= 20
        for _ in robots:
            arrival = inbox.take(PATIENCE_S)
            assert arrival is not None
            received.add((arrival.key, arrival.payload))
    assert len(received) == 2 * len(robots)
