"""A service that no longer gets what it lives on reports it."""

from __future__ import annotations

from collections.abc import Iterable

from eigenscan.runtime.counters import Counters
from eigenscan.runtime.health import Monitor
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.logs import logger
from eigenscan.runtime.work import SILENT_S, Work
from eigenscan.schemas.channels import ODOMETRY, SCAN, Channel
from eigenscan.schemas.envelope import Condition, Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.wire import encoding
from eigenscan.workbench.simtest.agenda import Agenda, MachineClock


class Content:
    """A core that is always well."""

    inputs: tuple[Channel, ...] = (SCAN, ODOMETRY)
    outputs: tuple[Channel, ...] = ()

    def start(self) -> Iterable[Envelope]:
        return ()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        return ()

    def finish(self) -> Iterable[Envelope]:
        return ()

    def condition(self) -> Condition:
        return Condition(Health.STATUS_OK, "well")


class NeverEnds:
    stopping = False

    def set(self) -> None:
        pass


def test_without_its_input_a_service_is_waiting_whatever_else_comes() -> None:
    agenda = Agenda()
    clock, inbox = MachineClock(agenda), Inbox()
    monitor = Monitor("m", "0", "1", clock=clock)
    work = Work(
        Content(), inbox, print, print, monitor, Counters(logger()), NeverEnds(), clock=clock, lives_on=SCAN
    )

    def receive(channel: Channel, key: str) -> Condition:
        inbox.put(channel, key, b"", encoding(channel))
        assert work.step()
        agenda.run(agenda.now + 1.0)
        work.keep_time()
        return monitor.condition()

    assert receive(ODOMETRY, "s/robot/r/odom").detail == "no scan yet"
    assert receive(SCAN, "s/robot/r/scan/front") == Condition(
        Health.STATUS_OK, "well", monitor.condition().counters
    )
    agenda.run(agenda.now + SILENT_S)
    starved = receive(ODOMETRY, "s/robot/r/odom")
    assert starved.status == Health.STATUS_WAITING
    assert "scan" in starved.detail
    assert receive(SCAN, "s/robot/r/scan/front").status == Health.STATUS_OK
