import time
from collections.abc import Iterable

from eigenscan.schemas.channels import HYPOTHESES, POSE, SCAN, Channel
from eigenscan.schemas.envelope import Condition, Envelope, nanoseconds, stamp
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.workbench.evaluation.remembering import Remembering


class Echo:
    """Publishes how many scans it has received, and takes its time."""

    inputs: tuple[Channel, ...] = (SCAN,)
    outputs: tuple[Channel, ...] = (HYPOTHESES,)

    def __init__(self) -> None:
        self.received = 0

    def start(self) -> Iterable[Envelope]:
        return ()

    def finish(self) -> Iterable[Envelope]:
        return ()

    def condition(self) -> Condition:
        return Condition()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        self.received += 1
        end = time.process_time_ns() + 5_000_000
        while time.process_time_ns() < end:
            pass
        scan = received.open(Scan)
        answer = Hypotheses(timestamp=scan.timestamp, used_beams=round(sum(scan.ranges)))
        return [Envelope(HYPOTHESES, {**received.address, "projector": "0"}, answer)]


def scan(time_ns: int, ranges: list[float], lidar: str = "a", sequence: int = 0) -> Envelope:
    message = Scan(timestamp=stamp(time_ns), ranges=ranges, sequence=sequence)
    return Envelope(SCAN, {"site": "s", "robot": "r", "lidar": lidar}, message)


def test_the_same_scan_at_another_time_has_the_same_answer_at_that_time_and_the_same_cost() -> None:
    core = Echo()
    remembering = Remembering(core)
    (first,) = remembering.handle(scan(10, [1.0, 2.0]))
    assert remembering.owed_ns == 0
    (again,) = remembering.handle(scan(999, [1.0, 2.0], sequence=7))
    assert core.received == 1
    assert remembering.owed_ns >= 5_000_000
    assert nanoseconds(again.open(Hypotheses).timestamp) == 999
    assert again.open(Hypotheses).used_beams == first.open(Hypotheses).used_beams == 3
    assert again.key == first.key


def test_another_scan_or_another_lidar_is_asked_again() -> None:
    core = Echo()
    remembering = Remembering(core)
    for received in (scan(1, [1.0]), scan(1, [2.0]), scan(1, [1.0], lidar="b")):
        list(remembering.handle(received))
    assert core.received == 3


def test_a_core_that_receives_more_than_scans_is_always_asked() -> None:
    core = Echo()
    core.inputs = (SCAN, POSE)
    remembering = Remembering(core)
    for _ in range(2):
        list(remembering.handle(scan(1, [1.0])))
    assert core.received == 2
