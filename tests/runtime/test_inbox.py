import threading
import time
from collections import defaultdict

from eigenscan.runtime.inbox import Inbox
from eigenscan.schemas.channels import MODEL, POSE, SCAN
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
    assert _turn_s(20_000) < 10 * _turn_s(20)  # 1,000 times the keys


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
        arrival = inbox.take(10.0)
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
    thread.join(5.0)
    assert taken == [None]
