"""The recorder without its shell: hands all it receives to its sinks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from eigenscan.schemas.channels import CHANNELS, Channel
from eigenscan.schemas.envelope import Condition, Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tick import TICK


class Sink(ABC):
    """Takes every message. It reports a fault as `problem`, and raises no exception."""

    @property
    def problem(self) -> str:
        """Why it cannot do its work now; empty while it can."""
        return ""

    @property
    def remark(self) -> str:
        """What went wrong before; empty: nothing."""
        return ""

    @property
    @abstractmethod
    def counters(self) -> Mapping[str, int]:
        """Numbers of messages written and lost."""

    @abstractmethod
    def write(self, received: Envelope) -> None:
        """Takes one message."""

    def tick(self) -> None:
        """Does work that is due by the clock, about once a second, also without messages."""
        return

    @abstractmethod
    def close(self) -> None:
        """Completes the output. Nothing may be written after it."""


class RecorderCore:
    """Receives every channel and publishes nothing. Files, sockets and the clock belong to the sinks."""

    inputs: tuple[Channel, ...] = (*CHANNELS, TICK)
    outputs: tuple[Channel, ...] = ()

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self._sinks = tuple(sinks)

    def start(self) -> Iterable[Envelope]:
        """Nothing to publish."""
        return ()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        """Gives the message to every sink."""
        for sink in self._sinks:
            if received.channel is TICK:
                sink.tick()
            else:
                sink.write(received)
        return ()

    def finish(self) -> Iterable[Envelope]:
        """Closes the sinks."""
        for sink in self._sinks:
            sink.close()
        return ()

    def condition(self) -> Condition:
        """Degraded as soon as one sink has a problem; what was lost before stays in the detail."""
        problems = "; ".join(sink.problem for sink in self._sinks if sink.problem)
        counters = Counter[str]()
        for sink in self._sinks:  # some count under the same names
            counters.update(sink.counters)
        if problems:
            return Condition(Health.STATUS_DEGRADED, problems, counters)
        remarks = "; ".join(sink.remark for sink in self._sinks if sink.remark)
        return Condition(Health.STATUS_OK, remarks, counters)
