"""A picture that is slow or fails holds up nobody."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping

import pytest
from eigenscan.recorder.background_sink import WAITING, BackgroundSink
from eigenscan.recorder.core import RecorderCore, Sink
from eigenscan.schemas.channels import MAP, POSE
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from foxglove_schemas_protobuf.Grid_pb2 import Grid

ADDRESS = {"site": "s", "robot": "r"}


class Slow(Sink):
    """A sink that writes only when it is let, and fails on request."""

    def __init__(self, fails_on: Callable[[Envelope], bool] = lambda received: False) -> None:
        self.may_write, self.writes = threading.Event(), threading.Event()
        self.written: list[Envelope] = []
        self.closed = False
        self._fails_on = fails_on

    remark = "drawn late"
    counters: Mapping[str, int] = {"drawn": 7}

    def write(self, received: Envelope) -> None:
        self.writes.set()
        self.may_write.wait(120)
        if self._fails_on(received):
            raise ValueError("undrawable")
        self.written.append(received)

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """What waits may take its time at the end."""
    monkeypatch.setattr("eigenscan.recorder.background_sink.DRAIN_S", 60.0)


def pose(number: int) -> Envelope:
    return Envelope(POSE, ADDRESS, PoseEstimate(timestamp=stamp(number)))


def await_that(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def numbers(sink: Slow) -> list[int]:
    return [received.message.timestamp.nanos for received in sink.written if received.channel == POSE]  # type: ignore[attr-defined]


def test_in_order_and_whole_where_there_is_time(patient: None) -> None:
    sink = Slow()
    sink.may_write.set()
    background = BackgroundSink(sink)
    for number in range(200):
        background.write(pose(number))
    await_that(lambda: len(sink.written) == 200)
    background.close()
    assert sink.closed
    assert numbers(sink) == list(range(200))
    assert background.counters == {"drawn": 7, "undrawn": 0, "undrawable": 0}


def test_a_slow_sink_loses_the_oldest_but_never_the_map(patient: None) -> None:
    sink = Slow()
    background = BackgroundSink(sink)
    background.write(pose(0))
    assert sink.writes.wait(120)
    background.write(Envelope(MAP, ADDRESS, Grid()))
    for number in range(1, WAITING + 101):
        background.write(pose(number))
    assert background.counters["undrawn"] == 100
    sink.may_write.set()
    await_that(lambda: len(sink.written) == WAITING + 2)
    background.close()
    assert [received.channel for received in sink.written[:2]] == [POSE, MAP]
    assert numbers(sink) == [0, *range(101, WAITING + 101)]


def test_of_a_map_that_changes_while_nothing_is_drawn_the_newest_alone_waits(patient: None) -> None:
    """Each edition of a site's map and models stayed in memory for as long as drawing stood still."""
    sink = Slow()
    background = BackgroundSink(sink)
    background.write(pose(0))
    assert sink.writes.wait(120)
    for number in range(100):
        background.write(Envelope(MAP, ADDRESS, Grid(column_count=number)))
    assert background.counters["undrawn"] == 99
    sink.may_write.set()
    await_that(lambda: len(sink.written) == 2)
    background.close()
    assert sink.written[1].open(Grid).column_count == 99


def test_a_sink_that_hangs_does_not_keep_the_recorder_from_ending() -> None:
    sink = Slow()
    background = BackgroundSink(sink)
    for number in range(10):
        background.write(pose(number))
    assert sink.writes.wait(120)
    background.close()
    assert not sink.closed
    assert background.counters["undrawn"] == 9
    sink.may_write.set()


def test_what_fails_is_counted_and_logged_once(caplog: pytest.LogCaptureFixture, patient: None) -> None:
    sink = Slow(fails_on=lambda received: received.message.timestamp.nanos % 2 == 1)  # type: ignore[attr-defined]
    sink.may_write.set()
    background = BackgroundSink(sink)
    for number in range(10):
        background.write(pose(number))
    await_that(lambda: background.counters["undrawable"] == 5 and len(sink.written) == 5)
    background.close()
    assert numbers(sink) == [0, 2, 4, 6, 8]
    assert background.counters["undrawable"] == 5
    assert caplog.text.count("ValueError: undrawable") == 1


class Panic(BaseException):
    """As one in Rerun's Rust is to Python."""


def test_a_panic_does_not_end_the_drawing(patient: None) -> None:
    def fails(received: Envelope) -> bool:
        if received.message.timestamp.nanos == 0:  # type: ignore[attr-defined]
            raise Panic
        return False

    sink = Slow(fails_on=fails)
    sink.may_write.set()
    background = BackgroundSink(sink)
    for number in range(3):
        background.write(pose(number))
    await_that(lambda: numbers(sink) == [1, 2])
    background.close()
    assert background.counters["undrawable"] == 1


def test_what_two_sinks_lose_adds_up(patient: None) -> None:
    failing, good = Slow(fails_on=lambda received: True), Slow()
    sinks = [BackgroundSink(failing), BackgroundSink(good)]
    failing.may_write.set()
    good.may_write.set()
    core = RecorderCore(sinks)
    for number in range(3):
        list(core.handle(pose(number)))
    await_that(lambda: sinks[0].counters["undrawable"] == 3 and len(good.written) == 3)
    list(core.finish())
    assert core.condition().counters == {"drawn": 14, "undrawn": 0, "undrawable": 3}


def test_health_has_each_sinks_own_remark() -> None:
    """The core once knew the counter of one sink."""
    one, other = Slow(), BackgroundSink(Slow())
    assert RecorderCore([one, other]).condition().detail == "drawn late; drawn late"
    other.close()
