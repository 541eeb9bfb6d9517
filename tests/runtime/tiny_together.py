"""Three tiny services in one process: one answers raw scans, one receives that, one keeps all."""

import sys
import threading
from collections.abc import Iterable
from typing import Any

from eigenscan.runtime.node import Service
from eigenscan.runtime.settings import ServiceSettings
from eigenscan.runtime.together import main
from eigenscan.schemas.channels import CHANNELS, HYPOTHESES, OBSTACLES, SCAN, SCAN_RAW, Channel
from eigenscan.schemas.envelope import Condition, Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Obstacles
from eigenscan.schemas.scan_pb2 import RawScan, Scan

PUBLISHED: list[int] = []


class Silent:
    inputs: tuple[Channel, ...] = ()
    outputs: tuple[Channel, ...] = ()

    def __init__(self, settings: ServiceSettings) -> None:
        self._settings = settings

    def start(self) -> Iterable[Envelope]:
        return ()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        return ()

    def finish(self) -> Iterable[Envelope]:
        return ()

    def condition(self) -> Condition:
        return Condition()


class First(Silent):
    inputs: tuple[Channel, ...] = (SCAN_RAW,)
    outputs: tuple[Channel, ...] = (SCAN, OBSTACLES)

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        name = received.open(RawScan).frame_id
        if name == "leave":
            sys.exit(0)
        scan = Scan(frame_id=name)
        PUBLISHED.append(id(scan))
        yield Envelope(SCAN, received.address, scan)
        if name == "and more":
            yield Envelope(OBSTACLES, {**received.address, "projector": "p"}, Obstacles(frame_id=name))


class Second(Silent):
    """States of each scan whether it is the very object that was published, and in the same thread."""

    inputs: tuple[Channel, ...] = (SCAN,)
    outputs: tuple[Channel, ...] = (HYPOTHESES,)

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        same = id(received.message) in PUBLISHED
        name = (
            f"{received.open(Scan).frame_id} {'same' if same else 'copy'} {threading.current_thread().name}"
        )
        yield Envelope(HYPOTHESES, {**received.address, "projector": "p"}, Hypotheses(frame_id=name))

    def finish(self) -> Iterable[Envelope]:
        address = {"site": self._settings.site, "robot": "robot", "lidar": "l", "projector": "p"}
        return (Envelope(HYPOTHESES, address, Hypotheses(frame_id="last")),)


class Detector(Silent):
    """Prints what it receives the two."""

    inputs = CHANNELS

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        if received.channel in (SCAN, HYPOTHESES, OBSTACLES):
            print(f"kept {received.channel.name} {received.message.frame_id}", flush=True)  # type: ignore[attr-defined]
        return ()


SERVICES: dict[str, Service[Any]] = {
    "first": Service("first", ServiceSettings, First, quick=True),
    "second": Service("second", ServiceSettings, Second, quick=True),
    "keeper": Service("keeper", ServiceSettings, Detector, whole_site=True),
}


if __name__ == "__main__":
    main(lambda: [([*SERVICES], sys.argv[1:])], SERVICES.__getitem__)
