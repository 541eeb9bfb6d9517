"""A Zenoh router with the shell of every other service: health, metrics, liveliness, clean shutdown."""

from __future__ import annotations

from collections.abc import Iterable

from eigenscan.runtime import node
from eigenscan.runtime.settings import ServiceSettings
from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Condition, Envelope


class RouterSettings(ServiceSettings):
    """Routes a site's traffic. Without a Zenoh configuration it listens on TCP port 7447."""


class RouterCore:
    """Hears and says nothing: what a router does it does by being there."""

    hears: tuple[Channel, ...] = ()
    says: tuple[Channel, ...] = ()

    def start(self) -> Iterable[Envelope]:
        """Nothing."""
        return ()

    def handle(self, _heard: Envelope) -> Iterable[Envelope]:
        """Nothing."""
        return ()

    def finish(self) -> Iterable[Envelope]:
        """Nothing."""
        return ()

    def condition(self) -> Condition:
        """Always well."""
        return Condition(detail="routing")


def main() -> None:
    """Entry point of `eigenscan-router`."""
    node.main("router", RouterSettings, lambda _settings: RouterCore(), mode="router")
