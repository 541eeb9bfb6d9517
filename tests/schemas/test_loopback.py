from collections.abc import Iterable

from eigenscan.schemas.channels import HYPOTHESES, POSE, SCAN, SCAN_RAW, TRACKS, Channel
from eigenscan.schemas.envelope import Condition, Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.scan_pb2 import RawScan, Scan

ADDRESS = {"site": "s", "robot": "r", "lidar": "l", "projector": "p"}


class Chain:
    """Answers whatever it receives on one channel with an empty message on each of others."""

    def __init__(self, receives: Channel, *stated: Channel) -> None:
        self.inputs: tuple[Channel, ...] = (receives,)
        self.outputs = stated
        self.received: list[Envelope] = []

    def _all(self) -> Iterable[Envelope]:
        for channel in self.outputs:
            yield Envelope(channel, ADDRESS, channel.message())

    def start(self) -> Iterable[Envelope]:
        return ()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        self.received.append(received)
        return self._all()

    def finish(self) -> Iterable[Envelope]:
        return self._all()

    def condition(self) -> Condition:
        return Condition()


def _names(output: list[Envelope]) -> list[str]:
    return [envelope.channel.name for envelope in output]


def test_what_is_published_goes_on_to_who_receives_it_breadth_first() -> None:
    ingest, projector, tracker = (
        Chain(SCAN_RAW, SCAN),
        Chain(SCAN, HYPOTHESES, TRACKS),
        Chain(HYPOTHESES, POSE),
    )
    loop = Loopback([ingest, projector, tracker])
    assert loop.start() == []
    raw = Envelope(SCAN_RAW, ADDRESS, RawScan(frame_id="x"))
    assert _names(loop.receive(raw)) == ["scan", "hypotheses", "tracks", "pose"]
    assert ingest.received[0].message == raw.message
    assert tracker.received[0].open(Hypotheses) == Hypotheses()
    assert len(tracker.received) == 1


def test_the_end_goes_through_the_cores_in_order() -> None:
    ingest, projector, tracker = Chain(SCAN_RAW, SCAN), Chain(SCAN, HYPOTHESES), Chain(HYPOTHESES, POSE)
    output = Loopback([ingest, projector, tracker]).finish()
    assert _names(output) == ["scan", "hypotheses", "pose", "hypotheses", "pose", "pose"]


def test_a_core_cannot_change_what_others_receive() -> None:
    class Meddler(Chain):
        def handle(self, received: Envelope) -> Iterable[Envelope]:
            received.open(Scan).sequence = 99
            return super().handle(received)

    meddler, observer = Meddler(SCAN), Chain(SCAN)
    scan = Scan(sequence=1)
    Loopback([meddler, observer]).receive(Envelope(SCAN, ADDRESS, scan))
    assert scan.sequence == 1
    assert observer.received[0].open(Scan).sequence == 1


def test_what_nobody_receives_is_still_reported() -> None:
    assert Loopback([]).receive(Envelope(POSE, ADDRESS, POSE.message())) == []
    assert _names(Loopback([Chain(SCAN, POSE)]).receive(Envelope(SCAN, ADDRESS, Scan()))) == ["pose"]
