"""Connects cores in one process without Zenoh, for evaluation, replay and notebooks.

Messages travel as over Zenoh, but in a fixed order: breadth first, in the given order of the cores. They are
encoded and decoded, so each core sees the same bytes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence

from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Core, Envelope
from eigenscan.schemas.wire import decode, encode


class Loopback:
    """Delivers each message to every core that subscribes to its channel."""

    def __init__(self, cores: Sequence[Core]) -> None:
        self._cores = list(cores)
        self._receivers: dict[str, list[Core]] = {}

    def start(self) -> list[Envelope]:
        """Starts the cores; returns all published messages."""
        return [published for core in self._cores for published in self._spread(core.start())]

    def receive(self, envelope: Envelope) -> list[Envelope]:
        """Gives `envelope` to the cores; returns all messages that they publish in answer, in order."""
        return list(self._spread([envelope]))[1:]

    def finish(self) -> list[Envelope]:
        """Ends the cores, nearest to the sensor first; returns the messages that they held back."""
        return [published for core in self._cores for published in self._spread(core.finish())]

    def _spread(self, envelopes: Iterable[Envelope]) -> Iterator[Envelope]:
        waiting = deque(envelopes)
        while waiting:
            envelope = waiting.popleft()
            yield envelope
            receivers = self._receivers_of(envelope.channel)
            payload = encode(envelope.message) if receivers else b""
            for core in receivers:
                message = decode(envelope.channel, payload)
                waiting.extend(core.handle(Envelope(envelope.channel, envelope.address, message)))

    def _receivers_of(self, channel: Channel) -> list[Core]:
        known = self._receivers.get(channel.name)
        if known is None:
            known = self._receivers[channel.name] = [core for core in self._cores if channel in core.inputs]
        return known
