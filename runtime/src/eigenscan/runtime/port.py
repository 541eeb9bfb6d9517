"""Channels of a service outside the contract, carried by another protocol such as ROS 2's."""

from __future__ import annotations

from typing import Protocol

from eigenscan.runtime.inbox import Inbox
from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Envelope


class Port(Protocol):
    """Carries `channels` of a core. The core sees no difference; they never appear on the site's keys."""

    channels: tuple[Channel, ...]

    def open(self, inbox: Inbox) -> None:
        """Connects, and puts received messages into `inbox` from now on, as samples of `channels`."""
        ...

    def publish(self, envelope: Envelope) -> None:
        """Publishes one message of `channels`."""
        ...

    def close(self) -> None:
        """Disconnects; safe if it was never opened."""
        ...


class NoPort:
    """The port of a service that has channels of the contract only."""

    channels: tuple[Channel, ...] = ()

    def open(self, inbox: Inbox) -> None:
        """Nothing to connect."""

    def publish(self, envelope: Envelope) -> None:
        """Never called: there are no channels."""

    def close(self) -> None:
        """Nothing to disconnect."""
