"""Messages with their channel and address, and the interface of a core."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from eigenscan.schemas.channels import Channel, ContractError
from eigenscan.schemas.health_pb2 import Health
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

M = TypeVar("M", bound=Message)


@dataclass(frozen=True)
class Envelope:
    """One message on one key."""

    channel: Channel
    address: Mapping[str, str]
    message: Message
    arrived: int = field(default=0, compare=False)
    """ns since the epoch by the receiver's clock; 0: not known."""
    payload: bytes = field(default=b"", compare=False, repr=False)
    """The message's bytes as they arrived; empty: not known."""

    @property
    def key(self) -> str:
        """The full key."""
        return self.channel.key(self.address)

    @property
    def stamp(self) -> int:
        """The message's own stamp, ns since the epoch. Raises AttributeError if its type has none."""
        return nanoseconds(self.message.timestamp)  # type: ignore[attr-defined]

    def open(self, kind: type[M]) -> M:
        """The message, checked to be a `kind`. Raises ContractError if it is not."""
        if not isinstance(self.message, kind):
            raise ContractError(
                f"{self.key}: expected {kind.DESCRIPTOR.full_name}, got {self.message.DESCRIPTOR.full_name}"
            )
        return self.message


@dataclass(frozen=True)
class Condition:
    """Status of a core. `counters`: numbers of messages received, published and rejected, by name."""

    status: Health.Status = Health.STATUS_OK
    detail: str = ""
    counters: Mapping[str, int] = field(default_factory=dict)


class Core(Protocol):
    """A service's algorithm: no Zenoh, no files, no clock, no unseeded randomness.

    `handle` must give the same answers to the same sequence of messages. It counts and ignores bad input, and
    must not raise for it.
    """

    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]

    def start(self) -> Iterable[Envelope]:
        """Messages to publish before any is received."""
        ...

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        """Handles one message; returns the messages to publish."""
        ...

    def finish(self) -> Iterable[Envelope]:
        """Returns the messages that were held back; no more messages follow."""
        ...

    def condition(self) -> Condition:
        """Present status and counters."""
        ...


def stamp(nanoseconds: int) -> Timestamp:
    """Protobuf timestamp of `nanoseconds` since the epoch."""
    return Timestamp(seconds=nanoseconds // 1_000_000_000, nanos=nanoseconds % 1_000_000_000)


LATEST_S = 4_000_000_000
"""Times that a file or a program states, before and after the epoch, s, at most: the year 2096."""
LATEST_NS = 2**62
"""Largest time before or after the epoch, ns: the year 2116. The sum of two fits into 64 bits."""


def nanoseconds(timestamp: Timestamp) -> int:
    """Nanoseconds since the epoch, limited to LATEST_NS."""
    at = timestamp.seconds * 1_000_000_000 + timestamp.nanos
    return at if -LATEST_NS <= at <= LATEST_NS else LATEST_NS if at > 0 else -LATEST_NS
