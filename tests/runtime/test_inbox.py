import itertools
import threading
import time
from collections import defaultdict
from types import SimpleNamespace

import pytest
import zenoh
from eigenscan.runtime.inbox import MOST_UNSORTED, Inbox
from eigenscan.runtime.intake import Intake
from eigenscan.schemas.channels import CHANNELS, MODEL, ODOMETRY, POSE, SCAN, SCAN_RAW, Channel
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.workbench.simtest.session import Timestamp
from hypothesis import given
from hypothesis import strategies as st

DEPTH = SCAN.qos.depth
STEPS = st.lists(st.one_of(st.tuples(st.just("put"), st.integers(0, 3)), st.just(("take", 0))), max_size=400)


@given(STEPS)
def test_it_is_a_queue_that_forgets_the_oldest_of_a_full_key(steps: list[tuple[str, int]]) -> None:
    inbox, plain, dropped = Inbox(), list[tuple[str, bytes]](), 0
    for number, (what, which) in enumerate(steps):
        if what == "put":
            key, payload = f"s/robot/r/scan/{which}", str(number).encode()
            inbox.put(SCAN, key, payload, "")
            of_key = [entry for entry in plain if entry[0] == key]
            if len(of_key) == DEPTH:
                plain.remove(of_key[0])
                dropped += 1
            plain.append((key, payload))
        else:
            arrival = inbox.take(0.0)
            expected = plain.pop(0) if plain else None
            assert (arrival and (arrival.key, arrival.payload)) == expected
        assert len(inbox) == len(plain)
    assert inbox.dropped.get("scan", 0) == dropped


def test_a_key_that_nobody_takes_costs_the_others_nothing() -> None:
    inbox = Inbox()
    for number in range(DEPTH):
        inbox.put(POSE, "s/robot/r/pose", str(number).encode(), "")
    for number in range(1000 * DEPTH):
        inbox.put(SCAN, "s/robot/r/scan/l", str(number).encode(), "")
    found = defaultdict(list)
    while (arrival := inbox.take(0.0)) is not None:
        found[arrival.channel.name].append(int(arrival.payload))
    assert found["pose"] == list(range(DEPTH))
    assert found["scan"] == list(range(999 * DEPTH, 1000 * DEPTH))
    assert inbox.dropped == {"scan": 999 * DEPTH}


def test_models_are_never_dropped() -> None:
    inbox = Inbox()
    for number in range(1000):
        inbox.put(MODEL, "s/model/hall", str(number).encode(), "")
    assert [int(inbox.take(0.0).payload) for _ in range(1000)] == list(range(1000))  # type: ignore[union-attr]


def test_made_up_keys_do_not_fill_the_memory() -> None:
    inbox = Inbox(most_bytes=1_000_000)
    inbox.put(MODEL, "s/model/hall", b"model", "")
    for number in range(5000):
        inbox.put(SCAN_RAW, f"s/robot/r/scan/raw/{number}", b"x" * 9000, "")
    assert len(inbox) <= 1 + 1_000_000 // 9000
    assert inbox.dropped == {"scan_raw": 5001 - len(inbox)}
    first = inbox.take(0.0)
    assert first is not None
    assert first.payload == b"model"
    *_, last = iter(lambda: inbox.take(0.0), None)
    assert last.key == "s/robot/r/scan/raw/4999"


def _turn_s(keys: int) -> float:
    """Processor seconds for 20,000 samples put and taken while `keys` others wait."""
    inbox = Inbox()
    for number in range(keys):
        inbox.put(SCAN, f"s/robot/{number}/scan/l", b"", "")
    began = time.thread_time()
    for number in range(20_000):
        inbox.put(SCAN, f"s/robot/{number % keys}/scan/l", b"", "")
        inbox.take(0.0)
    return time.thread_time() - began


def test_its_cost_does_not_grow_with_the_fleet() -> None:
    # 1,000 times the keys; the least of several, for a busy machine has cold caches
    many, few = (min(_turn_s(keys) for _ in range(3)) for keys in (20_000, 20))
    assert many < 50 * few


def test_nothing_is_lost_or_doubled_between_threads() -> None:
    inbox, per_thread = Inbox(), 5000

    def fill(name: int) -> None:
        for number in range(per_thread):
            inbox.put(MODEL, f"s/model/{name}", str(number).encode(), "")

    threads = [threading.Thread(target=fill, args=(name,)) for name in range(4)]
    for thread in threads:
        thread.start()
    found = defaultdict(list)
    for _ in range(4 * per_thread):
        arrival = inbox.take(120.0)
        assert arrival is not None
        found[arrival.key].append(int(arrival.payload))
    for thread in threads:
        thread.join()
    assert all(numbers == list(range(per_thread)) for numbers in found.values())
    assert len(found) == 4


def test_closing_wakes_who_waits() -> None:
    inbox = Inbox()
    taken: list[object] = []
    thread = threading.Thread(target=lambda: taken.append(inbox.take(60.0)))
    thread.start()
    inbox.close()
    thread.join(50.0)
    assert taken == [None]


BEHIND_AFTER_S = 1.0


class Overload:
    """An inbox whose core takes `work_s` for a sample; keys have samples at their own rates, on one clock."""

    def __init__(self, periods_s: dict[str, float], work_s: float, seconds: float) -> None:
        self.now, self.taken = 0.0, list[tuple[str, float, float]]()
        self.inbox = Inbox(behind_after_s=BEHIND_AFTER_S, clock=lambda: self.now)
        dues = sorted(
            (number * period, key)
            for key, period in periods_s.items()
            for number in range(1, round(seconds / period))
        )
        self.put, busy_until = len(dues), 0.0
        while dues:
            while dues and dues[0][0] <= busy_until:
                at, key = dues.pop(0)
                self.now = at
                self.inbox.put(SCAN, key, repr(at).encode(), "")
            self.now = max(self.now, busy_until)
            arrival = self.inbox.take(0.0)
            if arrival:
                self.taken.append((arrival.key, self.now, float(arrival.payload)))
            busy_until = self.now + work_s if arrival else dues[0][0] if dues else self.now


def longest_wait(drive: Overload, keys: int) -> float:
    """Between two turns of a key, s: at most a round, and the time to its next scan before and after."""
    turns = defaultdict(list)
    for key, at, _ in drive.taken:
        if at > 3 * BEHIND_AFTER_S:
            turns[key].append(at)
    assert len(turns) == keys
    return max(after - before for each in turns.values() for before, after in itertools.pairwise(each))


@pytest.mark.parametrize("overload", [1.5, 2.0, 5.0])
def test_who_is_behind_gets_the_newest_scan_of_each_robot_in_turn(overload: float) -> None:
    period_s, robots = 0.1, 20
    work_s = overload * period_s / robots
    drive = Overload({f"s/robot/{n}/scan/l": period_s * (1 + n * 1e-3) for n in range(robots)}, work_s, 20.0)
    late = [(key, at, output) for key, at, output in drive.taken if at > 3 * BEHIND_AFTER_S]
    # the newest, so never older than the time to the next one
    assert max(at - output for _, at, output in late) <= period_s * (1 + robots * 1e-3)
    assert longest_wait(drive, robots) <= robots * work_s + 2 * period_s
    left = 0
    while drive.inbox.take(0.0):
        left += 1
    assert drive.put == len(drive.taken) + left + drive.inbox.dropped["scan"]  # each is counted
    assert drive.inbox.too_late == drive.inbox.dropped["scan"]


def test_a_quick_lidar_takes_no_turns_from_slow_ones() -> None:
    periods = {f"s/robot/{n}/scan/l": 0.1 for n in range(10)} | {"s/robot/q/scan/l": 0.025}
    drive = Overload(periods, 0.02, 20.0)  # a round takes longer than any period
    assert longest_wait(drive, 11) <= 11 * 0.02 + 2 * 0.1


def test_a_pause_that_is_caught_up_in_time_costs_no_scan() -> None:
    now = 0.0
    inbox = Inbox(behind_after_s=BEHIND_AFTER_S, clock=lambda: now)
    for number in range(10):
        now = number * 0.1
        inbox.put(SCAN, "s/robot/r/scan/l", str(number).encode(), "")
    assert [int(inbox.take(0.0).payload) for _ in range(10)] == list(range(10))  # type: ignore[union-attr]
    assert not inbox.dropped
    # what was worked off does not count against what comes later
    now = 100.0
    inbox.put(SCAN, "s/robot/r/scan/l", b"10", "")
    inbox.put(SCAN, "s/robot/r/scan/l", b"11", "")
    assert inbox.take(0.0).payload == b"10"  # type: ignore[union-attr]


@pytest.mark.parametrize("channel", CHANNELS, ids=lambda channel: channel.name)
def test_only_sweeps_give_way_before_the_inbox_is_full(channel: Channel) -> None:
    now = 0.0
    inbox = Inbox(behind_after_s=BEHIND_AFTER_S, clock=lambda: now)
    for number in range(50):
        inbox.put(channel, "k", str(number).encode(), "")
    now = 2 * BEHIND_AFTER_S
    found = []
    while arrival := inbox.take(0.0):
        found.append(int(arrival.payload))
    assert found == ([49] if channel in (SCAN, SCAN_RAW) else list(range(50)))
    assert inbox.dropped.get(channel.name, 0) == 50 - len(found)


def test_samples_that_are_taken_together_wake_nobody() -> None:
    class Ready(threading.Condition):
        woken = 0

        def notify(self, n: int = 1) -> None:
            self.woken += 1
            super().notify(n)

    for batch_s, woken in ((0.0, 3), (0.05, 0)):
        ready = Ready()
        inbox = Inbox(ready=ready, batch_s=batch_s)
        for number in range(3):
            inbox.put(MODEL, "s/model/hall", str(number).encode(), "")
        assert ready.woken == woken
        assert [int(inbox.take(9.0).payload) for _ in range(3)] == [0, 1, 2]  # type: ignore[union-attr]


def test_a_sample_shows_when_it_arrived() -> None:
    inbox = Inbox(batch_s=0.05)
    before = time.time_ns()
    inbox.put(MODEL, "s/model/hall", b"", "")
    after = time.time_ns()
    arrival = inbox.take(9.0)
    assert arrival is not None
    assert before <= arrival.time <= after


def test_samples_wait_as_they_came_and_keep_order_and_time() -> None:
    now = iter(range(10, 1000))
    inbox = Inbox(batch_s=0.05, time_of_day=lambda: next(now))
    sorted_in: list[str] = []

    def sort(sample: str, time: int) -> None:
        sorted_in.append(sample)
        inbox.put(MODEL, "s/model/hall", sample.encode(), "", time=time)

    for name in ("a", "b"):
        inbox.put_unsorted(sort, name)
    assert (len(inbox), sorted_in) == (2, [])
    taken = [inbox.take(0.0), inbox.take(0.0)]
    assert [(one.payload, one.time) for one in taken if one] == [(b"a", 10), (b"b", 11)]
    for number in range(2 * MOST_UNSORTED):
        inbox.put_unsorted(sort, str(number))
    assert len(sorted_in) > MOST_UNSORTED  # a sender sorts before too many wait


def test_samples_of_sources_wake_nobody_and_come_before_a_later_one_that_does() -> None:
    class Ready(threading.Condition):
        def wait(self, timeout: float | None = None) -> bool:
            elsewhere.append(b"odometry")  # in the meantime
            Intake([SCAN], inbox).on_message(SCAN, "s/robot/r/scan/l", Scan(), b"scan", None)
            return super().wait(0.0)

    inbox, elsewhere = Inbox(ready=Ready(), batch_s=60.0, wakes=True), list[bytes]()

    def source() -> None:
        while elsewhere:
            inbox.put(ODOMETRY, "s/robot/r/odom", elsewhere.pop(), "")

    inbox.sources.append(source)
    assert [inbox.take(60.0).payload for _ in range(2)] == [b"odometry", b"scan"]  # type: ignore[union-attr]
    assert inbox.take(0.0) is None


def test_sources_are_looked_into_only_when_nothing_else_waits() -> None:
    inbox, looks = Inbox(batch_s=60.0, wakes=True), list[int]()
    inbox.sources.append(lambda: looks.append(len(inbox)))
    for payload in (b"1", b"2", b"3"):
        inbox.put(ODOMETRY, "s/robot/r/odom", payload, "")
    assert inbox.is_waiting
    assert [inbox.take(0.0).payload for _ in range(3)] == [b"1", b"2", b"3"]  # type: ignore[union-attr]
    assert not looks
    assert inbox.take(0.0) is None
    assert looks == [0]
    assert not inbox.is_waiting


def test_an_answer_is_put_after_what_came_before_it() -> None:
    """Seed 7025: an answer overtook the previous publisher's model, which then counted as the newest."""
    inbox = Inbox(batch_s=1.0)
    intake = Intake([MODEL], inbox)

    def sample(publisher: str, payload: bytes) -> SimpleNamespace:
        stamp = Timestamp(len(payload), publisher)
        return SimpleNamespace(
            key_expr="s/model/a",
            payload=zenoh.ZBytes(payload),
            encoding="",
            kind=zenoh.SampleKind.PUT,
            timestamp=stamp,
        )

    intake.on_sample(sample("old", b"1"))
    intake.on_reply(SimpleNamespace(ok=sample("new", b"22"), err=None))
    payloads = []
    while arrival := inbox.take(0.0):
        payloads.append(arrival.payload)
    assert payloads == [b"1", b"22"]
