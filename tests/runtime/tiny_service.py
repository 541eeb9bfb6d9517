"""A service as small as one can be: answers raw scans with scans, and misbehaves on request."""

import os
import signal
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from eigenscan.runtime import node
from eigenscan.runtime.settings import ServiceSettings
from eigenscan.schemas.channels import MODEL, SCAN, SCAN_RAW, Channel
from eigenscan.schemas.envelope import Condition, Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import RegionModel
from eigenscan.schemas.scan_pb2 import RawScan, Scan


class TinySettings(ServiceSettings):
    make_s: float = 0.0
    start_s: float = 0.0
    handle_s: float = 0.0
    start_until: Path | None = None
    model_bytes: int = 0
    broken: bool = False
    prompt: bool = False
    takes_models: bool = False


class TinyCore:
    inputs: tuple[Channel, ...] = (SCAN_RAW,)
    outputs: tuple[Channel, ...] = (SCAN, MODEL)

    def __init__(self, settings: TinySettings) -> None:
        if settings.broken:
            raise ValueError("maps/office.yaml: resolution: must be given")
        self._settings = settings
        if settings.takes_models:
            self.inputs, self.outputs = (SCAN_RAW, MODEL), (SCAN,)
        self._handled = 0
        print_waiting("make", settings.make_s)

    def start(self) -> Iterable[Envelope]:
        print_waiting("start", self._settings.start_s)
        if self._settings.start_until:
            print_waiting("start", 0.001)
            while not self._settings.start_until.exists():
                time.sleep(0.01)
        if self._settings.model_bytes:
            model = RegionModel(region="hall", version="1", panoramas=bytes(self._settings.model_bytes))
            yield Envelope(MODEL, {"site": self._settings.site, "region": "hall"}, model)

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        if received.channel is MODEL:
            if received.open(RegionModel).version == "kills":
                os.kill(os.getpid(), signal.SIGSEGV)  # as compiled code does
            return
        raw = received.open(RawScan)
        print_waiting("handle", self._settings.handle_s)
        if raw.frame_id == "poison":
            raise RuntimeError("poisoned")
        if raw.frame_id == "leave":
            sys.exit(0)
        self._handled += 1
        yield Envelope(SCAN, received.address, Scan(frame_id=raw.frame_id, sequence=self._handled - 1))

    def finish(self) -> Iterable[Envelope]:
        yield Envelope(
            SCAN, {"site": self._settings.site, "robot": "robot", "lidar": "last"}, Scan(frame_id="last")
        )

    def condition(self) -> Condition:
        status = Health.STATUS_OK if self._handled else Health.STATUS_WAITING
        return Condition(status, "" if self._handled else "no scan", {"handled": self._handled})


def print_waiting(what: str, seconds: float) -> None:
    """Sleeps where seconds are given, and reports it first."""
    if seconds:
        sys.stderr.write(f"{what} takes long\n")
        time.sleep(seconds)


if __name__ == "__main__":
    node.main(node.Service("tiny", TinySettings, TinyCore, prompt="--prompt" in sys.argv))
