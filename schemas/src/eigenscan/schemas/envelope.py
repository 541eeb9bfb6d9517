"""A message with its channel and address: input and output of cores."""

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

    @property
    def key(self) -> str:
        """The full key."""
        return self.channel.key(self.address)

    @property
    def stamp(self) -> int:
        """The message's own, ns since the epoch. Raises AttributeError where its kind has none."""
        return nanoseconds(self.message.timestamp)  # type: ignore[attr-defined]

    def open(self, kind: type[M]) -> M:
        """The message as `kind`. Raises ContractError where it is of another."""
        if not isinstance(self.message, kind):
            raise ContractError(
                f"{self.key}: expected {kind.DESCRIPTOR.full_name}, got {self.message.DESCRIPTOR.full_name}"
            )
        return self.message


@dataclass(frozen=True)
class Condition:
    """How a core is. `counters` holds what was taken, published and set aside, by reason."""

    status: Health.Status = Health.STATUS_OK
    detail: str = ""
    counters: Mapping[str, int] = field(default_factory=dict)


class Core(Protocol):
    """A service without its shell: no Zenoh, no files, no clock, no unseeded randomness.

    `handle` must give the same answer for the same sequence of messages, and must not raise on
    bad input: it counts it and sets it aside.
    """

    hears: tuple[Channel, ...]
    says: tuple[Channel, ...]

    def start(self) -> Iterable[Envelope]:
        """Messages to publish before any is received."""
        ...

    def handle(self, heard: Envelope) -> Iterable[Envelope]:
        """What follows from one message."""
        ...

    def finish(self) -> Iterable[Envelope]:
        """What was held back, when no more messages come."""
        ...

    def condition(self) -> Condition:
        """Status and counters, now."""
        ...


def stamp(nanoseconds: int) -> Timestamp:
    """Protobuf timestamp of `nanoseconds` since the epoch."""
    return Timestamp(seconds=nanoseconds // 1_000_000_000, nanos=nanoseconds % 1_000_000_000)


LATEST_NS = 2**62
"""ns before and after the epoch, the year 2116: sums of two fit into 64 bits. Later ones are taken for it."""


def nanoseconds(timestamp: Timestamp) -> int:
    """Nanoseconds since the epoch, LATEST_NS before or after it at most."""
    return min(max(timestamp.seconds * 1_000_000_000 + timestamp.nanos, -LATEST_NS), LATEST_NS)
