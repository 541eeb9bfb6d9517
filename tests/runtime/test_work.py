"""What a stopped core does with the messages that still wait."""

from collections.abc import Iterable

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


class Stopped:
    """The end was asked for before the work began."""

    stopping = True

    def set(self) -> None:
        """Nobody waits."""


@pytest.mark.parametrize(("drain_s", "handled"), [(60.0, [0, 1, 2]), (0.0, [])])
def test_a_stopped_core_handles_what_waits_only_if_it_has_time_for_it(
    drain_s: float, handled: list[int]
) -> None:
    core, inbox = Noting(), Inbox()
    for sequence in range(3):
        payload = encode(Scan(frame_id="lidar", sequence=sequence))
        inbox.put(SCAN, "site/robot/r1/scan/front", payload, encoding(SCAN))
    work = Work(
        core,
        inbox,
        lambda envelope: None,
        lambda arrival: None,
        Monitor("noting", "r1", "0"),
        Counters(logger()),
        Stopped(),
        drain_s=drain_s,
    )
    inbox.close(discard=not drain_s)
    work.run()
    assert core.handled == handled
    assert core.finished_after == len(handled)
