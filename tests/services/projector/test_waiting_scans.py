"""Scans wait for the tracker's request: answers follow from messages, not from which one came first."""

import math
from collections import Counter, deque

import numpy as np
import pytest
from eigenscan.geometry.pose import compose, inverse
from eigenscan.projector.local import KEPT, LONGEST_NS
from eigenscan.projector.waiting_scans import MOST_WAITING, WaitingScans
from eigenscan.schemas.channels import SCAN, SEARCH
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.hypotheses_pb2 import SEARCH_LOCAL, SEARCH_WHOLE, Hypotheses
from eigenscan.schemas.scan_pb2 import Scan
from hypothesis import given
from hypothesis import strategies as st

from tests.services.projector.office import ADDRESS, envelopes, free_poses, ready, receive, site
from tests.services.projector.test_local import MOUNT, START, STEP, ask, request, scan

LIDAR = ("r17", "front")
WITHIN_S = 0.3
PLACE = compose(free_poses(1, 171)[0], inverse(np.array(MOUNT)))


def seen(at: int) -> Envelope:
    address = {"site": "site", "robot": LIDAR[0], "lidar": LIDAR[1]}
    return Envelope(SCAN, address, Scan(timestamp=stamp(at)))


def stamps(scans: list[Envelope]) -> list[int]:
    return [one.stamp for one in scans]


def in_time(waiting: WaitingScans, at: int) -> None:
    """A scan, and its request at once."""
    assert stamps(waiting.receive(LIDAR, seen(at))) == [at]
    assert waiting.requested(LIDAR, at) == []


@given(lags=st.lists(st.integers(0, 2), min_size=1, max_size=60))
def test_each_scan_has_the_request_of_the_one_before_whatever_comes_first(lags: list[int]) -> None:
    """Each request comes after `lag` more scans: 2 of 100 ms are less than WITHIN_S."""
    counts, asked = Counter[str](), deque[int]()
    waiting = WaitingScans(counts, WITHIN_S)
    in_time(waiting, START)
    passed, requested = [START], START

    def answer(scans: list[Envelope]) -> None:
        for at in stamps(scans):
            assert requested == passed[-1]  # the request of the scan before
            passed.append(at)
            asked.append(at)

    coming = [START + i * STEP for i in range(1, len(lags) + 1)]
    for at, lag in zip(coming, lags, strict=True):
        answer(waiting.receive(LIDAR, seen(at)))
        while len(asked) > 0 and at - asked[0] >= lag * STEP:
            requested = asked.popleft()
            answer(waiting.requested(LIDAR, requested))
    while asked:
        requested = asked.popleft()
        answer(waiting.requested(LIDAR, requested))
    assert passed == [START, *coming]
    assert counts["request_missing"] == 0


def test_without_requests_none_waits() -> None:
    waiting = WaitingScans(Counter(), WITHIN_S)
    for at in range(START, START + 20 * STEP, STEP):
        assert stamps(waiting.receive(LIDAR, seen(at))) == [at]


def test_who_stops_requesting_is_waited_for_once() -> None:
    counts = Counter[str]()
    waiting = WaitingScans(counts, WITHIN_S)
    in_time(waiting, START)
    passed, coming = [], range(START + STEP, START + 20 * STEP, STEP)
    for at in coming:
        due = stamps(waiting.receive(LIDAR, seen(at)))
        assert all(at - one <= WITHIN_S * 1e9 for one in due)
        passed += due
    assert passed == list(coming)
    assert counts["request_missing"] == 1


def test_who_waits_for_any_time_waits_from_the_first_scan_on_and_keeps_few() -> None:
    """A tracker that lags from the start: its first scans, too, wait for what it asks for."""
    counts = Counter[str]()
    waiting = WaitingScans(counts, math.inf)
    assert stamps(waiting.receive(LIDAR, seen(START))) == [START]
    for i in range(1, MOST_WAITING):
        assert waiting.receive(LIDAR, seen(START + i * STEP)) == []
    assert stamps(waiting.receive(LIDAR, seen(START + MOST_WAITING * STEP))) == [
        START + i * STEP for i in range(1, MOST_WAITING + 1)
    ]
    assert counts["request_missing"] == 1


@pytest.mark.parametrize("later", [-STEP, -(10**12), 0, 1])
def test_scans_do_not_gather_where_the_clock_is_set_back_or_stands(later: int) -> None:
    waiting, passed = WaitingScans(Counter(), WITHIN_S), 0
    in_time(waiting, START)
    assert waiting.receive(LIDAR, seen(START + STEP))
    for number in range(100):
        passed += len(waiting.receive(LIDAR, seen(START + 2 * STEP + (later if number else 0))))
        assert number + 1 - passed < KEPT
    assert passed > 0


def test_requests_that_come_in_time_again_are_waited_for_again() -> None:
    waiting = WaitingScans(Counter(), WITHIN_S)
    in_time(waiting, START)
    for i in range(1, 20):
        waiting.receive(LIDAR, seen(START + i * STEP))
    in_time(waiting, START + 20 * STEP)
    waiting.receive(LIDAR, seen(START + 21 * STEP))
    assert waiting.receive(LIDAR, seen(START + 22 * STEP)) == []


@pytest.mark.parametrize("apart", [0, -STEP, LONGEST_NS + 1])
def test_a_scan_that_no_request_can_be_for_does_not_wait(apart: int) -> None:
    waiting = WaitingScans(Counter(), WITHIN_S)
    in_time(waiting, START)
    assert waiting.receive(LIDAR, seen(START + STEP))
    assert stamps(waiting.receive(LIDAR, seen(START + STEP + apart))) == [START + STEP + apart]


def test_after_a_scan_without_a_list_none_waits() -> None:
    waiting = WaitingScans(Counter(), WITHIN_S)
    in_time(waiting, START)
    assert waiting.receive(LIDAR, seen(START + STEP))
    waiting.has_no_list(LIDAR)
    assert stamps(waiting.receive(LIDAR, seen(START + 2 * STEP))) == [START + 2 * STEP]


def test_each_lidar_waits_for_its_own_and_the_rest_is_not_lost() -> None:
    waiting = WaitingScans(Counter(), WITHIN_S)
    in_time(waiting, START)
    assert waiting.receive(LIDAR, seen(START + STEP))
    assert waiting.receive(LIDAR, seen(START + 2 * STEP)) == []
    assert waiting.receive(("r17", "rear"), seen(START + 2 * STEP))
    assert waiting.requested(("r18", "front"), START + STEP) == []
    assert stamps(waiting.rest()) == [START + 2 * STEP]
    assert waiting.rest() == []


def test_the_projector_gives_the_same_answers_whichever_comes_first() -> None:
    places = [PLACE + 0.02 * i for i in range(4)]
    scans = [Envelope(SCAN, ADDRESS, scan(places[i], START + i * STEP)) for i in range(4)]
    asked = [Envelope(SEARCH, ADDRESS, request(places[i], START + i * STEP)) for i in range(4)]
    orders = (
        [scans[0], asked[0], scans[1], asked[1], scans[2], asked[2], scans[3]],
        [scans[0], asked[0], scans[1], scans[2], asked[1], asked[2], scans[3]],
        [scans[0], asked[0], scans[1], scans[2], scans[3], asked[1], asked[2]],
    )
    answers = []
    for order in orders:
        core = ready()
        published = [one for message in order for one in core.handle(message)]
        answers.append([one.message for one in published if isinstance(one.message, Hypotheses)])
        assert list(core.finish()) == []
    assert [one.search for one in answers[0]] == [SEARCH_WHOLE, *[SEARCH_LOCAL] * 3]
    assert answers[0] == answers[1] == answers[2]


@pytest.mark.parametrize("ends", [True, False])
def test_at_the_end_and_on_a_new_map_no_scan_is_lost(ends: bool) -> None:
    core, place = ready(), PLACE
    receive(core, scan(place, START))
    ask(core, request(place, START))
    receive(core, scan(place, START + STEP))
    assert list(core.handle(Envelope(SCAN, ADDRESS, scan(place, START + 2 * STEP)))) == []
    if ends:
        published = list(core.finish())
    else:
        for envelope in envelopes(site(spacing=1.0, components=4)):
            assert list(core.handle(envelope)) == []
        published = list(core.handle(Envelope(SEARCH, ADDRESS, request(place, START + STEP))))
    listed = [one.message for one in published if isinstance(one.message, Hypotheses)]
    assert [one.search for one in listed] == [SEARCH_WHOLE]
