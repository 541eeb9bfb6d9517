"""What a service speaks besides the contract: channels that travel by another protocol, such as ROS 2's."""

from __future__ import annotations

from typing import Protocol

from eigenscan.runtime.inbox import Inbox
from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Envelope


class Port(Protocol):
    """Carries `channels` of a core, which sees no difference; they are never published on the site's keys."""

    channels: tuple[Channel, ...]

    def open(self, inbox: Inbox) -> None:
        """Connects; from now on puts received messages into `inbox`, as samples of `channels`."""
        ...

    def say(self, envelope: Envelope) -> None:
        """Says one message of `channels`."""
        ...

    def close(self) -> None:
        """Disconnects, also where it was never opened."""
        ...


class NoPort:
    """A service that speaks the contract only."""

    channels: tuple[Channel, ...] = ()

    def open(self, inbox: Inbox) -> None:
        """Nothing to connect."""

    def say(self, envelope: Envelope) -> None:
        """Never asked: it has no channels."""

    def close(self) -> None:
        """Nothing to disconnect."""
