"""The order of observations by their stamps."""

from __future__ import annotations

from collections import Counter

import numpy as np
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.timeline import Outcome, Timeline


def seen(seconds: float, source: str = "front/0") -> Observation:
    nothing = np.zeros(0)
    return Observation(
        round(seconds * 1e9),
        source,
        "front",
        "map",
        nothing.reshape(0, 3),
        nothing.reshape(0, 3, 3),
        nothing,
        0.0,
        1.0,
        usable=True,
    )


def test_a_clock_that_was_set_back_catches_up_unseen() -> None:
    """Found by simtest: 2.2 s back, and two scans later a claim 1.5 m off."""
    timeline = Timeline(patience=0.2, late=0.5, counts=Counter())
    received = [timeline.receive(seen(stamp)) for stamp in (37.0, 38.0, 36.76, 37.76, 38.76)]
    assert received == [Outcome.TAKEN, Outcome.TAKEN, Outcome.TOO_LATE, Outcome.TOO_LATE, Outcome.RESTARTED]


def test_lists_that_were_overtaken_are_set_aside_and_restart_nothing() -> None:
    counts = Counter[str]()
    timeline = Timeline(patience=0.2, late=0.5, counts=counts)
    received = [timeline.receive(seen(stamp)) for stamp in (10.0, 10.8, 10.2, 10.4, 11.0, 11.2)]
    assert [each is Outcome.TOO_LATE for each in received] == [False, False, True, True, False, False]
    assert counts == {"hypotheses_too_late": 2}
    # two came early
    received = [timeline.receive(seen(stamp)) for stamp in (12.0, 12.2, 11.4, 11.6, 11.8, 12.4)]
    assert Outcome.RESTARTED not in received
    assert counts == {"hypotheses_too_late": 5}


def test_a_clock_that_was_set_back_for_good_restarts_once() -> None:
    counts = Counter[str]()
    timeline = Timeline(patience=0.2, late=0.5, counts=counts)
    stamps = [10.0, 10.2, 10.4, *(2.0 + 0.2 * tick for tick in range(20))]
    received = [timeline.receive(seen(stamp)) for stamp in stamps]
    assert received.count(Outcome.RESTARTED) == counts["clock_set_back"] == 1
    assert received[-1] is Outcome.TAKEN


def test_a_list_older_than_the_last_of_its_source_is_not_taken() -> None:
    """Seed 4154: the clock was set back by less than two scans, and a pose of now counted as of before."""
    timeline = Timeline(patience=0.2, late=0.5, counts=Counter())
    received = [timeline.receive(seen(stamp)) for stamp in (6.44, 7.44, 6.99, 7.99)]
    assert received == [Outcome.TAKEN, Outcome.TAKEN, Outcome.TOO_LATE, Outcome.TAKEN]


def test_a_slow_projector_is_taken_after_one_list_that_came_too_late() -> None:
    timeline = Timeline(patience=0.2, late=0.5, counts=Counter())
    timeline.receive(seen(10.0, "front/slow"))
    timeline.receive(seen(11.0))
    assert timeline.receive(seen(10.1, "front/slow")) is Outcome.TOO_LATE
    assert timeline.receive(seen(10.6, "front/slow")) is Outcome.TAKEN


def test_a_projector_that_is_always_too_late_restarts_nothing() -> None:
    """Where the other one's lists come in time, no clock was set back."""
    timeline = Timeline(patience=0.2, late=0.5, counts=Counter())
    timeline.receive(seen(9.0, "front/slow"))
    for tick in range(10, 30):
        assert timeline.receive(seen(float(tick))) is Outcome.TAKEN
        assert timeline.receive(seen(tick - 0.9, "front/slow")) is Outcome.TOO_LATE


def test_a_clock_that_was_set_back_restarts_although_two_projectors_answer() -> None:
    timeline = Timeline(patience=0.2, late=0.5, counts=Counter())
    sources = ("front/0", "front/1")
    assert all(timeline.receive(seen(100.0 + tick, s)) is Outcome.TAKEN for tick in range(3) for s in sources)
    received = [timeline.receive(seen(20.0 + tick, s)) for tick in range(6) for s in sources]
    assert received.count(Outcome.RESTARTED) == 1
    assert received[-1] is Outcome.TAKEN


def test_a_list_that_one_of_another_source_overtook_is_taken() -> None:
    timeline = Timeline(patience=0.2, late=0.5, counts=Counter())
    received = [timeline.receive(each) for each in (seen(1.0), seen(1.4), seen(1.2, "rear/0"))]
    assert received == [Outcome.TAKEN] * 3
