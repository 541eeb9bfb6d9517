"""What a stopped core does with the messages that still wait."""

import threading
from collections.abc import Iterable
from typing import Any

import pytest
from eigenscan.runtime.counters import Counters
from eigenscan.runtime.health import Monitor
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.logs import logger
from eigenscan.runtime.work import Work
from eigenscan.schemas.channels import SCAN, Channel
from eigenscan.schemas.envelope import Condition, Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.wire import encode, encoding


class Noting:
    """Notes the sequence numbers of the scans that it handles."""

    inputs: tuple[Channel, ...] = (SCAN,)
    outputs: tuple[Channel, ...] = ()

    def __init__(self) -> None:
        self.handled: list[int] = []
        self.finished_after = -1

    def start(self) -> Iterable[Envelope]:
        return ()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        self.handled.append(received.open(Scan).sequence)
        return ()

    def finish(self) -> Iterable[Envelope]:
        self.finished_after = len(self.handled)
        return ()

    def condition(self) -> Condition:
        return Condition(Health.STATUS_OK, "", {})


class Stop:
    """Whether the end was asked for; by default before the work began."""

    def __init__(self, stopping: bool = True) -> None:
        self.stopping = stopping

    def set(self) -> None:
        """Nobody waits."""


def put(inbox: Inbox, sequence: int) -> None:
    payload = encode(Scan(frame_id="lidar", sequence=sequence))
    inbox.put(SCAN, "site/robot/r1/scan/front", payload, encoding(SCAN))


def work_of(core: Noting, inbox: Inbox, stop: Stop, **how: Any) -> Work:
    monitor, counters = Monitor("noting", "r1", "0"), Counters(logger())
    return Work(core, inbox, lambda envelope: None, lambda arrival: None, monitor, counters, stop, **how)


@pytest.mark.parametrize(("drain_s", "handled"), [(60.0, [0, 1, 2]), (0.0, [])])
def test_a_stopped_core_handles_what_waits_only_if_it_has_time_for_it(
    drain_s: float, handled: list[int]
) -> None:
    core, inbox = Noting(), Inbox()
    for sequence in range(3):
        put(inbox, sequence)
    work = work_of(core, inbox, Stop(), drain_s=drain_s)
    inbox.close(discard=not drain_s)
    work.run()
    assert core.handled == handled
    assert core.finished_after == len(handled)


def test_health_names_what_the_core_fails_at_until_it_succeeds() -> None:
    inbox, stop = Inbox(), Stop(stopping=False)

    class Poisoned(Noting):
        def handle(self, received: Envelope) -> Iterable[Envelope]:
            if received.open(Scan).sequence < 2:
                raise ValueError("no beams")
            return super().handle(received)

    work = work_of(Poisoned(), inbox, stop)
    monitor, found = work._monitor, []
    for sequence in range(3):
        put(inbox, sequence)
        work.step()
        work._due = 0.0
        work.keep_time()
        found.append((monitor.condition().status, monitor.condition().detail))
    failing = Health.STATUS_DEGRADED, "the core fails at scan: no beams: see core_failed in its log"
    assert found == [failing, failing, (Health.STATUS_OK, "")]


def test_a_prompt_core_that_is_stopped_while_samples_wait_ends() -> None:
    inbox, stop = Inbox(), Stop(stopping=False)

    class StoppedAtOnce(Noting):
        def handle(self, received: Envelope) -> Iterable[Envelope]:
            stop.stopping = True
            inbox.close()
            return super().handle(received)

    core = StoppedAtOnce()
    for sequence in range(3):
        put(inbox, sequence)
    thread = threading.Thread(target=work_of(core, inbox, stop, prompt=True).run, daemon=True)
    thread.start()
    thread.join(20.0)
    assert not thread.is_alive()
    assert core.handled == [0]
    assert core.finished_after == 1


def test_who_sends_to_a_prompt_core_that_has_ended_is_not_held() -> None:
    core, inbox = Noting(), Inbox()
    work = work_of(core, inbox, Stop(), prompt=True)
    inbox.close()
    work.run()
    sender = threading.Thread(target=put, args=(inbox, 0), daemon=True)
    sender.start()
    sender.join(20.0)
    assert not sender.is_alive()
    assert core.handled == []
    assert len(inbox) == 0
