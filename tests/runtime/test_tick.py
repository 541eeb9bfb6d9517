"""A core that receives ticks receives the time once a second; no other core does."""

import threading
import time
from collections.abc import Iterable

import pytest
from eigenscan.runtime import work
from eigenscan.runtime.counters import Counters
from eigenscan.runtime.health import Monitor
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.logs import logger
from eigenscan.runtime.stop_event import StopEvent
from eigenscan.runtime.work import Work
from eigenscan.schemas.channels import CHANNELS, SCAN, Channel
from eigenscan.schemas.envelope import Condition, Envelope, nanoseconds
from eigenscan.schemas.tick import TICK
from eigenscan.workbench.replay.services import PARTS
from google.protobuf.timestamp_pb2 import Timestamp

ENOUGH = 3
PATIENCE_S = 30.0


class Clockwork:
    """Notes what it receives, and fails on the first of it."""

    outputs: tuple[Channel, ...] = ()

    def __init__(self, receives: tuple[Channel, ...], enough: threading.Event) -> None:
        self.inputs, self._enough = receives, enough
        self.received: list[Envelope] = []

    def start(self) -> Iterable[Envelope]:
        return ()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        self.received.append(received)
        if len(self.received) == 1:
            raise RuntimeError("not yet wound up")
        if len(self.received) >= ENOUGH:
            self._enough.set()
        return ()

    def finish(self) -> Iterable[Envelope]:
        return ()

    def condition(self) -> Condition:
        return Condition()


@pytest.mark.parametrize("prompt", [False, True])
def test_a_core_that_receives_ticks_receives_the_time(monkeypatch: pytest.MonkeyPatch, prompt: bool) -> None:
    monkeypatch.setattr(work, "TICK_S", 0.01)
    enough, stop, inbox, counters = threading.Event(), StopEvent(), Inbox(), Counters(logger())
    clockwork, idle = Clockwork((TICK,), enough), Clockwork((SCAN,), threading.Event())
    threads = [
        threading.Thread(
            target=Work(core, inbox, print, print, Monitor("m", "0", "1"), counters, stop, prompt=prompt).run
        )
        for core in (clockwork, idle)
    ]
    before = time.time_ns()
    for thread in threads:
        thread.start()
    assert enough.wait(PATIENCE_S)
    stop.stop()
    for thread in threads:
        thread.join(PATIENCE_S)
    stop.close()
    times = [nanoseconds(received.open(Timestamp)) for received in clockwork.received]
    assert before <= times[0] <= times[-1] <= time.time_ns()
    assert times == sorted(times)
    assert counters.counts["core_failed"] == 1
    assert counters.counts["heard_tick"] == len(times)
    assert idle.received == []


def test_ticks_leave_no_process_and_move_no_core_that_is_replayed() -> None:
    assert TICK not in CHANNELS
    assert all(TICK not in part.inputs for part in PARTS)
