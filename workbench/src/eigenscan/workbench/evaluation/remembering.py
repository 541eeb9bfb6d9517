"""A projector that computes the answer to each scan only once, because windows overlap.

Its answers follow from models and scan alone. The process time of the first answer is charged again each
time, so the figures are those of the real work.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass

from eigenscan.schemas.channels import HYPOTHESES, MAP, MODEL, MODEL_SET, SCAN, SEARCH, SPACE
from eigenscan.schemas.envelope import Condition, Core, Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.wire import encode

KEPT = 5000
"""Answers kept, some kB each: the scans of a few minutes."""


@dataclass(frozen=True)
class _Answer:
    """Hypotheses as (address, bytes), and the process time, ns, that they took."""

    published: tuple[tuple[dict[str, str], bytes], ...]
    cpu_ns: int


class Remembering:
    """Replaces a projector for the other cores; `owed_ns`: the process time that it saved so far."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self.inputs, self.outputs = core.inputs, core.outputs
        # with other inputs an answer may depend on more than the scan
        self._pure = set(core.inputs) <= {MAP, MODEL, MODEL_SET, SPACE, SEARCH, SCAN}
        self._known: OrderedDict[tuple[str, bytes], _Answer] = OrderedDict()
        self.owed_ns = 0

    def forget(self) -> None:
        """Forgets all answers."""
        self._known.clear()

    def start(self) -> Iterable[Envelope]:
        """The core's own."""
        return self._core.start()

    def finish(self) -> Iterable[Envelope]:
        """The core's own."""
        return self._core.finish()

    def condition(self) -> Condition:
        """The core's own."""
        return self._core.condition()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        """The core's answer; of a scan that was answered before, its hypotheses alone."""
        if received.channel == SEARCH:
            self._pure = False
        if received.channel != SCAN or not self._pure:
            return self._core.handle(received)
        scan = received.open(Scan)
        key = (received.key, _without_time(scan))
        known = self._known.get(key)
        if known is not None:
            self._known.move_to_end(key)
            self.owed_ns += known.cpu_ns
            return [_at_the_time_of(scan, *one) for one in known.published]
        before = time.process_time_ns()
        published = list(self._core.handle(received))
        took = time.process_time_ns() - before
        hypotheses = tuple((dict(e.address), encode(e.message)) for e in published if e.channel == HYPOTHESES)
        self._known[key] = _Answer(hypotheses, took)
        if len(self._known) > KEPT:
            self._known.popitem(last=False)
        return published


def _without_time(scan: Scan) -> bytes:
    timeless = Scan()
    timeless.CopyFrom(scan)
    timeless.ClearField("timestamp")
    timeless.ClearField("sequence")
    timeless.ClearField("motion")
    return encode(timeless)


def _at_the_time_of(scan: Scan, address: dict[str, str], payload: bytes) -> Envelope:
    message = Hypotheses.FromString(payload)
    message.timestamp.CopyFrom(scan.timestamp)
    message.ClearField("motion")
    if scan.HasField("motion"):
        message.motion.CopyFrom(scan.motion)
    return Envelope(HYPOTHESES, address, message)
